"""A study of an attitude: errors, NEES and verdicts are those of its three deviations."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.reports.comparison import write
from sigmax.spaces import conjugate, exponential, multiply, rotate


def attitude(**options):
    axes = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    model = sigmax.Model(
        motion=lambda x, dt, u: multiply(x, exponential(u * dt)),
        sensor=lambda x: jnp.concatenate([rotate(conjugate(x), axis) for axis in axes]),
        state=[sigmax.rotation("attitude")],
        Q=np.full(3, 1e-4),
        R=np.full(6, 0.01),
    )
    prior = sigmax.Gaussian([1.0, 0, 0, 0], np.full(3, 0.25))
    return sigmax.studies.Study(
        name="attitude", model=model, prior=prior, steps=4, inputs=np.tile([0.1, 0.0, 0.05], (4, 1)), **options
    )


@pytest.mark.slow
def test_a_study_of_an_attitude_judges_by_its_deviations(tmp_path):
    filters = {"EKF": sigmax.get("EKF"), "once": sigmax.get("EKF", update="once")}
    found = sigmax.compare(attitude(), filters, runs=400)
    itself, once = (found.measures[name] for name in filters)
    assert itself.rmse.value.shape == (4, 3)
    # A line about the prediction alone is sure of what is not so.
    assert 0.8 < itself.nees.value[0] / 3 < 1.25 < once.nees.value[0] / 3
    assert np.isclose(itself.rmse.value[-1], 0.05, atol=0.03).all()
    write(tmp_path, [found])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["rmse"]["EKF"]) == {"attitude.roll", "attitude.pitch", "attitude.yaw"}
    assert found.no_bound


def test_an_optimum_by_particles_is_refused():
    with pytest.raises(sigmax.InputError, match="the optimum"):
        attitude(particles=100)
    with pytest.raises(sigmax.InputError, match="the optimum"):
        sigmax.compare(attitude(), ["EKF"], runs=20, particles=100)
