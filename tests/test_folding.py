"""Sigma points that fold over the circle are said before a run, and only where a function bends in that angle."""

import warnings
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import FoldingWarning
from sigmax.preparation.folding import folding
from sigmax.studies import load_studies


def model(bends=True, inputs=False):
    def motion(x, dt, *u):
        turned = jnp.cos(x[1]) if bends else 0.0
        return jnp.stack([x[0] + dt * turned + (u[0][0] if u else 0.0), x[1]])

    return sigmax.Model(
        motion=(lambda x, dt, u: motion(x, dt, u)) if inputs else (lambda x, dt: motion(x, dt)),
        sensor=lambda x: x[:1],
        Q=[0.1, 0.01],
        R=[1.0],
        state=("x", sigmax.angle("course")),
        measurement=("x",),
    )


def prior(sigma):
    return sigmax.Gaussian([0.0, 0.0], [1.0, sigma**2])


def said(run):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run()
    return [str(w.message) for w in caught if issubclass(w.category, FoldingWarning)]


@pytest.mark.parametrize("inputs", [False, True])
def test_a_run_warns_from_one_radian_on(inputs):
    # Two components: the points of CKF lie √2 deviations off, those of UKF with alpha √2 alpha.
    u = np.zeros((3, 1)) if inputs else None
    for name, sigma, wanted in (
        ("SRCKF", 0.70, 0),
        ("SRCKF", 0.72, 1),
        (sigmax.get("UKF", alpha=0.5), 1.40, 0),
        (sigmax.get("UKF", alpha=0.5), 1.43, 1),
        ("ECKF", 7.0, 0),
        ("EKF", 7.0, 0),
    ):
        given = name, model(inputs=inputs), prior(sigma), np.zeros((3, 1))
        assert len(said(partial(sigmax.run, *given, inputs=u))) == wanted, (name, sigma)


def test_an_angle_in_which_nothing_bends_folds_nowhere():
    assert said(lambda: sigmax.run("SRCKF", model(bends=False), prior(7.0), np.zeros((3, 1)))) == []


def test_live_warns_and_says_what_to_take():
    (text,) = said(lambda: sigmax.Live("SRCKF", model(), prior(2.0)))
    assert "course" in text
    assert "SRECKFB or EKF" in text
    assert "at most 41°" in text


def test_the_prior_of_sobolev_as_printed_folds_and_the_sane_reading_does_not():
    for reading, wanted in (("variance", 0), ("literal", 1)):
        (study,) = load_studies("sobolev-spread", {"p0": reading})
        found = list(folding(study.filters["SRUKFB α 0.25"], study.model, study.prior, None))
        assert len(found) == wanted


def test_a_study_says_it_in_its_notes_once_for_each_filter():
    (study,) = load_studies("sobolev-spread", {"p0": "literal"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        c = sigmax.compare(study, {"EKF": sigmax.get("EKF"), "wide": study.filters["SRUKFB α 0.25"]}, runs=8)
    assert [note.split(":")[0] for note in c.notes] == ["wide"]


def test_points_at_half_a_turn_lose_the_course_and_those_at_a_whole_turn_do_not():
    """Losses follow γσ / 2π with the period of a turn: SRUKFB with the course known to so many turns of its points."""
    (study,) = load_studies("sobolev-spread", {"p0": "literal"})
    lost = {}
    for turns in (0.25, 0.5, 0.75):
        P = np.diag(np.diag(study.prior.cov).copy())
        gamma = 0.25 * np.sqrt(3.0)
        P[3, 3] = (2 * np.pi * turns / gamma) ** 2
        wide = replace(study, prior=sigmax.Gaussian(study.prior.mean, P))
        c = sigmax.compare(wide, {"SRUKFB": study.filters["SRUKFB α 0.25"]}, runs=128)
        lost[turns] = float(c.measures["SRUKFB"].lost["all"].value)
    assert lost[0.5] > 0.4
    assert max(lost[0.25], lost[0.75]) < 0.1
