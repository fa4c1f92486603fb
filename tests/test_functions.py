"""What a user's function may get wrong is told before anything runs, of a record and step by step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.tracking import Modes

PRIOR = sigmax.Gaussian([0.0, 1.0], [1.0, 1.0])
TABLE = np.arange(3.0)


def model(**changes):
    given = dict(
        motion=lambda x, dt: jnp.stack([x[0] + dt * x[1], x[1]]),
        state=("place", "speed"),
        Q=[0.1, 0.1],
        sensor=lambda x: x[:1],
        measurement=("place",),
        R=[1.0],
    )
    return sigmax.Model(**given | changes)


def recorded(made, u):
    inputs = None if u is None else np.tile(u, (3, 1))
    return sigmax.run("CKF", made, PRIOR, np.zeros((3, 1)), dt=1.0, inputs=inputs)


def stepped(made, u):
    live = sigmax.Live("CKF", made, PRIOR)
    live.step([0.0], 1.0, u=u)
    return live


BEYOND = {
    "a component": dict(motion=lambda x, dt: jnp.stack([x[0] + dt * x[2], x[1]])),
    "from the end": dict(motion=lambda x, dt: jnp.stack([x[-3], x[1]])),
    "several": dict(motion=lambda x, dt: x[jnp.array([0, 2])]),
    "in a function of its own": dict(sensor=lambda x: jax.jit(lambda y: y[2] * jnp.ones(1))(x)),
    "an input": dict(sensor=lambda x, u: x[:1] + u[1]),
    "an input of the motion": dict(motion=lambda x, dt, u: x + u[1]),
    "a table": dict(sensor=lambda x: x[:1] + jnp.asarray(TABLE)[3]),
    "in R": dict(R=lambda x: jnp.stack([x[2] ** 2 + 1])),
    "in Q": dict(Q=lambda x, dt: jnp.stack([x[2] ** 2, x[0] ** 2])),
    "in F": dict(bias=sigmax.Bias(sensor=lambda x: x[2] * jnp.ones((1, 1)), prior=sigmax.Gaussian([0.0], [1.0]))),
}


@pytest.mark.parametrize("ran", [recorded, stepped])
@pytest.mark.parametrize("case", BEYOND)
def test_reading_beyond_an_array_is_refused(case, ran):
    """JAX takes the nearest element instead, and nobody notices."""
    with pytest.raises(sigmax.InputError, match=r"element .* of an array that has [123] is read \(test_functions"):
        ran(model(**BEYOND[case]), [0.5])


WITHIN = {
    "from the end": dict(motion=lambda x, dt: jnp.stack([x[-2] + dt * x[-1], x[-1]])),
    "several": dict(sensor=lambda x: x[jnp.array([0])]),
    "computed": dict(sensor=lambda x: x[:1] + 0 * jnp.asarray(TABLE)[x[0].astype(int) + 7]),
    "told to be clipped": dict(sensor=lambda x: x[:1] + 0 * jnp.take(jnp.asarray(TABLE), 7, mode="clip")),
    "behind a mask": dict(
        sensor=lambda x: x[:1] + 0 * jax.lax.fori_loop(0, 3, lambda i, s: s + jnp.where(i < 2, x[i], 0), 0.0)
    ),
}


@pytest.mark.parametrize("case", WITHIN)
def test_indices_that_are_meant_run(case):
    want = recorded(model(), None).mean
    np.testing.assert_allclose(recorded(model(**WITHIN[case]), None).mean, want, atol=1e-12)


@pytest.mark.parametrize("ran", [recorded, stepped])
@pytest.mark.parametrize(
    "changes",
    [
        dict(motion=lambda x, dt: jnp.stack([x[0] if x[0] > 3 else x[1], x[1]])),
        dict(motion=lambda x, dt: np.array([x[0], x[1]])),
        dict(sensor=lambda x: jnp.stack([float(x[0])])),
        dict(R=lambda x: np.abs(np.asarray(x[:1])) + 1),
    ],
    ids=["if", "numpy", "float", "R"],
)
def test_a_function_that_cannot_be_compiled_is_told_in_words(changes, ran):
    with pytest.raises(sigmax.InputError, match=r"\(test_functions.py, line \d+.*write it with jax.numpy"):
        ran(model(**changes), None)


def test_a_live_filter_finds_wrong_shapes_when_it_is_made_or_inputs_first_come():
    with pytest.raises(sigmax.InputError, match="motion must return the 2 components"):
        sigmax.Live("EKF", model(motion=lambda x, dt: x[:1]), PRIOR)
    with pytest.raises(sigmax.InputError, match="shape"):
        sigmax.Live("EKF", model(Q=lambda dt: jnp.eye(3)), PRIOR)
    live = sigmax.Live("EKF", model(motion=lambda x, dt, u: jnp.concatenate([x, u])[: len(u)]), PRIOR)
    live.predict(1.0, [0.1, 0.2])
    with pytest.raises(sigmax.InputError, match="motion must return the 2 components"):
        live.predict(1.0, [0.1, 0.2, 0.3])


def test_the_kalman_filter_refuses_a_bias_that_depends_on_the_state():
    prior = sigmax.Gaussian([0.0], [1.0])
    for bias, named in (
        (sigmax.Bias(sensor=lambda x: x[:1, None], prior=prior), "F"),
        (sigmax.Bias(motion=lambda x, dt: dt * x[:, None], prior=prior), "B"),
    ):
        with pytest.raises(sigmax.InputError, match=f"KF is for linear models, and {named} of the bias"):
            sigmax.run("KF", model(bias=bias), PRIOR, np.zeros((3, 1)), dt=1.0)
    by_time = sigmax.Bias(motion=lambda dt: dt * jnp.ones((2, 1)), prior=prior)
    assert sigmax.run("KF", model(bias=by_time), PRIOR, np.zeros((3, 1)), dt=1.0).ok.all()


def test_modes_of_a_tracker_are_checked_when_they_are_made():
    with pytest.raises(sigmax.InputError, match="element 2 of an array that has 2"):
        Modes([("EKF", model()), ("EKF", model(**BEYOND["a component"]))])
    with pytest.raises(sigmax.InputError, match="sensor must return the 1 components"):
        Modes([("EKF", model(sensor=lambda x: x))])
