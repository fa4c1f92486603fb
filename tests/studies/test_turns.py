"""Studies of targets whose models take turns."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.studies import Study
from sigmax.studies.simulate import draw

CHANGE = np.array([[0.9, 0.1], [0.3, 0.7]])


def mode(size, q, noise=1.0):
    def motion(x, dt):
        speed = x[1] + dt * x[2] if size == 3 else x[1]
        return jnp.stack([x[0] + dt * speed, speed, *([0.9 * x[2]] if size == 3 else [])])

    return sigmax.Model(
        motion=motion,
        sensor=lambda x: x[:1],
        Q=[q] * size,
        R=[noise],
        state=("p", "v", "a")[:size],
        measurement=("p",),
    )


MODEL = sigmax.imm(
    {"coast": mode(2, 0.01), "push": mode(3, 0.1, 4.0)},
    transition=CHANGE,
    initial=[0.5, 0.5],
    entry={"a": (0.3, 4.0)},
)
STUDY = Study(
    name="turns",
    model=MODEL,
    prior=sigmax.Gaussian([0.0, 1.0, 0.3], [1.0, 1.0, 4.0]),
    steps=20,
    filters={"EKF": sigmax.get("EKF")},
)


def test_the_filter_of_all_modes_is_honest_and_that_of_one_is_not():
    found = sigmax.compare(STUDY, runs=4000).measures["EKF"]
    assert np.allclose(found.ratio.value, 1.0, atol=0.15)
    assert np.allclose(found.ratio.value.mean(), 1.0, atol=0.05)
    calm = mode(2, 0.01)
    alone = replace(
        STUDY, model=calm, nature=sigmax.imm({"coast": calm, "wild": mode(2, 3.0)}, transition=CHANGE),
        prior=sigmax.Gaussian([0.0, 1.0], [1.0, 1.0]),
    )  # fmt: skip
    assert sigmax.compare(alone, runs=500).measures["EKF"].ratio.value[-1].min() > 3


def test_truth_changes_its_mode_as_the_chain_says_and_forgets_what_a_mode_has_not():
    """Without noise one sees from the accelerations which mode it was: 0.3 exactly in one that has none."""
    quiet = {"coast": mode(2, 1e-12), "push": mode(3, 1e-12)}
    model = sigmax.imm(quiet, transition=CHANGE, initial=[0.2, 0.8], entry={"a": (0.3, 0.0)})
    study = replace(STUDY, model=model, prior=sigmax.Gaussian([0.0, 1.0, 2.0], [1e-9] * 3), steps=6)
    drawn = draw(study, 3, 0)
    pushed = np.abs(np.diff(drawn.truth[..., 1], axis=1)) > 1e-3
    # From the second step on: what coasts keeps its speed.
    share = pushed[:, -1].mean()
    p = np.array([0.2, 0.8]) @ np.linalg.matrix_power(CHANGE, 6)
    assert abs(share - p[1]) < 4 * np.sqrt(p[1] * (1 - p[1]) / len(pushed))
    stays = (pushed[:, 1:] & pushed[:, :-1]).sum() / pushed[:, :-1].sum()
    assert abs(stays - CHANGE[1, 1]) < 4 * np.sqrt(0.21 / pushed[:, :-1].sum())


def test_an_optimum_of_modes_is_refused():
    with pytest.raises(sigmax.InputError, match=r"model\.modes\[NAME\]"):
        replace(STUDY, particles=100)
    with pytest.raises(sigmax.InputError, match=r"model\.modes\[NAME\]"):
        sigmax.compare(STUDY, particles=100)
