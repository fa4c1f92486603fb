"""Studies on models with a random bias: it is drawn with the truth and judged with the state."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.rewriting.augment import augment
from sigmax.studies.named import NAMED, zhang
from sigmax.studies.simulate import draw
from tests.laws import test_bias as biased


def test_the_whole_model_is_the_one_put_together_by_hand():
    X, dt = jnp.array([0.3, 0.2, 5.0, 0.1, -0.2]), 0.7
    made, hand = augment(biased.BIASED), biased.BY_HAND
    assert made.state == hand.state
    assert np.allclose(made.motion(X, dt), hand.motion(X, dt))
    assert np.allclose(made.sensors[""](X), hand.sensors[""](X))
    assert np.allclose(made.Q(dt) if callable(made.Q) else made.Q * dt, hand.Q * dt)
    assert augment(hand) is hand
    again = augment(biased.BIASED)
    assert (again.motion, again.sensors[""]) == (made.motion, made.sensors[""])


def test_functions_of_the_model_go_with_it():
    def model(x, dt, u):
        return x + dt * u[:1]

    given = sigmax.Model(
        motion=model,
        sensor=lambda x: x,
        Q=lambda x, dt: jnp.ones(1) * (1 + x[0]) * dt,
        R=lambda x: jnp.ones(1) + x**2,
        state=("x",),
        measurement=("z",),
        bias=sigmax.Bias(
            motion=lambda x, dt, u: u[None, 1:] * dt,
            sensor=lambda x, u: u[None, 1:] * x[0],
            Q=lambda dt: jnp.ones(1) * 3 * dt,
            prior=sigmax.Gaussian([0.0], [1.0]),
        ),
    )
    made = augment(given)
    X, u = jnp.array([2.0, 5.0]), jnp.array([3.0, 7.0])
    assert np.allclose(made.motion(X, 0.5, u), [2 + 0.5 * 3 + 0.5 * 7 * 5, 5])
    assert np.allclose(made.sensors[""](X, u), [2 + 7 * 2 * 5])
    assert np.allclose(made.Q(X, 0.5), [1.5, 1.5])
    assert np.allclose(made.R[""](X), [5.0])


@pytest.mark.parametrize("name", ["zhang-bearings", "bearings-repaired", "radar-registration"])
def test_the_named_studies_draw_their_bias(name):
    study = NAMED[name].make()
    p = study.apart.biases
    assert study.model.state[-p:] == study.apart.bias.names
    assert study.prior.size == study.apart.size + p
    drawn = draw(study, 1, 0)
    first = drawn.start[:, -p:]
    spread = np.sqrt(np.diag(study.prior.cov))[-p:]
    assert np.abs(first.std(0) / spread - 1).max() < 0.2
    assert np.abs(first.mean(0) - study.prior.mean[-p:]).max() < 0.3 * spread.max()
    told, prior = study.model_and_prior(drawn.mean)
    assert prior.mean.shape == (len(first), study.apart.size)
    assert told.bias.prior.mean.shape == (len(first), p)


def test_filters_with_stages_are_compared_on_the_bias_too():
    study = zhang.repaired(100.0)
    done = sigmax.compare(study, ["TSEKF", "MTSCKF"], runs=128, particles=0)
    assert not done.failures
    for measures in done.measures.values():
        assert measures.rmse.value.shape == (200, 5)
        # About one run of a hundred is lost, which an RMSE of so few does not bear.
        assert measures.median.value[-1, 4] < 0.8 * 0.6745 * np.sqrt(study.prior.cov[4, 4])


def test_no_estimator_reaches_the_printed_velocity():
    """With whatever stations, the noise of the motion alone leaves √(qT / (2√3)) = 0.380 m/s."""
    from dataclasses import replace

    study = zhang.bearings(motion="none")
    sharp = sigmax.Model(
        motion=study.apart.motion,
        state=study.apart.state,
        Q=study.apart.Q,
        sensor=study.apart.sensors[""],
        R=study.apart.R[""] * 1e-12,
        bias=sigmax.Bias(sensor=np.zeros((2, 1)), Q=[0.5], prior=sigmax.Gaussian([0.1], [0.5])),
    )
    prior = sigmax.Gaussian([0.0, 10.0, 3.0, 10.0], np.eye(4))
    done = sigmax.compare(replace(study, model=sharp, prior=prior, steps=30, look=()), ["EKF"], runs=64, particles=0)
    assert done.bound[-1, [1, 3]] == pytest.approx(np.sqrt(0.5 / (2 * np.sqrt(3))), rel=2e-3)


@pytest.mark.parametrize(
    ("name", "option", "says"),
    [
        ("zhang-bearings", {"stations": 0}, "a station at least"),
        ("bearings-repaired", {"s0": -400.0}, "above 0 m"),
        ("radar-registration", {"biased": 4}, "can be biased"),
        ("radar-registration", {"radars": 5}, "places for 4 radars"),
    ],
)
def test_options_that_make_no_study_are_refused(name, option, says):
    with pytest.raises(sigmax.InputError, match=says):
        NAMED[name].make(**option)
