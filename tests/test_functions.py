"""What a user's function may get wrong is told before anything runs, of a record and step by step."""

import functools
import os
import re
import subprocess
import sys
import warnings

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


def taken(made, u):
    return u if made.motion_driven or made.sensor_driven("") else None


def recorded(made, u):
    u = taken(made, u)
    inputs = None if u is None else np.tile(u, (3, 1))
    return sigmax.run("CKF", made, PRIOR, np.zeros((3, 1)), dt=1.0, inputs=inputs)


def stepped(made, u):
    live = sigmax.Live("CKF", made, PRIOR)
    live.step([0.0], 1.0, u=taken(made, u))
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


WRITTEN = {
    "set": lambda x: x.at[2].set(1.0),
    "added to": lambda x: x.at[2].add(1.0),
    "multiplied": lambda x: x.at[7].multiply(2.0),
    "the smaller": lambda x: x.at[2].min(1.0),
    "from the end": lambda x: x.at[-3].set(1.0),
    "several": lambda x: x.at[jnp.array([0, 2])].add(1.0),
    "in a function of its own": lambda x: jax.jit(lambda y: y.at[2].set(0.0))(x),
    "a row": lambda x: jnp.outer(x, x).at[2].set(0.0)[0],
    "a column": lambda x: jnp.outer(x, x).at[:, 2].set(0.0)[0],
    "an entry": lambda x: jnp.outer(x, x).at[1, 2].add(1.0)[0],
    "a block": lambda x: jax.lax.dynamic_update_slice(x, jnp.ones(1), (2,)),
}


@pytest.mark.parametrize("ran", [recorded, stepped])
@pytest.mark.parametrize("case", WRITTEN)
def test_writing_beyond_an_array_is_refused(case, ran):
    """JAX leaves it out, and nobody notices."""
    with pytest.raises(sigmax.InputError, match=r"element .* of an array that has 2 is written \(test_functions"):
        ran(model(motion=lambda x, dt: WRITTEN[case](x)), None)


def assigned(x, dt):
    x[0] = 1.0
    return x


def added(x):
    x[0] += 1.0
    return x


@pytest.mark.parametrize("ran", [recorded, stepped])
@pytest.mark.parametrize(
    ("changes", "same"),
    [
        (dict(motion=assigned), dict(motion=lambda x, dt: x.at[0].set(1.0))),
        (dict(motion=lambda x, dt: added(x)), dict(motion=lambda x, dt: x.at[0].add(1.0))),
        (dict(domain=added), dict(domain=lambda x: x.at[0].add(1.0))),
    ],
)
def test_assigning_to_a_part_of_the_state_means_what_numpy_means(changes, same, ran):
    got, want = (np.asarray(ran(model(**c), None).mean) for c in (changes, same))
    np.testing.assert_allclose(got, want, rtol=1e-12)


WITHIN = {
    "written": dict(motion=lambda x, dt: x.at[-2].add(dt * x[1]).at[1:].add(0.0).at[0:9].add(0.0)),
    "written in a matrix": dict(
        sensor=lambda x: x[:1] + 0 * jnp.outer(x, x).at[:, 1].set(1.0).at[jnp.array([0, 1]), 0].add(x)[0, :1]
    ),
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
        dict(motion=lambda x, dt: np.array([x[0], np.sqrt(4)]) if x[0] > 3 and dt else x),
        dict(sensor=lambda x: np.array([TABLE[int(x[0])]])),
        dict(R=lambda x: x[x > 0]),
    ],
    ids=["if", "numpy", "int", "R"],
)
def test_a_function_that_cannot_be_compiled_is_told_in_words(changes, ran):
    with pytest.raises(sigmax.InputError, match=r"\(test_functions.py, line \d+.*write np.*opaque"):
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


BENT = {
    "by the interval": dict(motion=lambda x, dt: x + dt * 3 * jnp.sin(x)),
    "for long intervals only": dict(motion=lambda x, dt: jnp.where(dt > 5, x**2, x)),
    "by the input": dict(motion=lambda x, dt, u: jnp.stack([x[0] + u[0] * x[1] ** 2, x[1]])),
    "far away only": dict(sensor=lambda x: 1e8 * jnp.sin(x[:1] / 1e8)),
    "the sensor, by the input": dict(sensor=lambda x, u: x[:1] * (1 + u[0] * x[1])),
    "the domain": dict(domain=jnp.abs),
    "F": dict(bias=sigmax.Bias(sensor=lambda x, u: u[0] * x[:1, None], prior=sigmax.Gaussian([0.0], [1.0]))),
    "B": dict(bias=sigmax.Bias(motion=lambda x, dt: dt * x[:, None], prior=sigmax.Gaussian([0.0], [1.0]))),
}
STRAIGHT = {
    "as it was": {},
    "by the interval": dict(motion=lambda x, dt: jnp.stack([x[0] + jnp.sin(dt) * x[1], jnp.exp(-dt) * x[1]])),
    "by the input": dict(motion=lambda x, dt, u: jnp.stack([x[0] + u[0] ** 2 * x[1], x[1] + jnp.log(u[0])])),
    "an affine sensor": dict(sensor=lambda x, u: 3 * x[:1] - x[1:] + jnp.sqrt(u)),
    "an angle that is wrapped": dict(sensor=lambda x: (x[:1] + jnp.pi) % (2 * jnp.pi) - jnp.pi),
    "F of the input": dict(bias=sigmax.Bias(sensor=lambda x, u: u.reshape(1, 1), prior=sigmax.Gaussian([0.0], [1.0]))),
    "B of the input": dict(bias=sigmax.Bias(motion=lambda x, dt, u: dt * u * B, prior=sigmax.Gaussian([0.0], [1.0]))),
}
B = np.ones((2, 1))
INTERVALS = {"zero first": [0.0, 1.0, 1.0], "ones": [1.0] * 3, "zeros": [0.0] * 3, "short": [1e-9] * 3}


@pytest.mark.parametrize("dt", INTERVALS)
@pytest.mark.parametrize("u", [0.0, 1.0])
@pytest.mark.parametrize("case", BENT)
@pytest.mark.one_in(3)
def test_the_kalman_filter_refuses_what_is_not_linear_whatever_the_record(case, u, dt):
    made = model(**BENT[case])
    with pytest.raises(sigmax.InputError, match="KF is for linear models"):
        sigmax.run("KF", made, PRIOR, np.zeros((3, 1)), dt=INTERVALS[dt], inputs=taken(made, np.full((3, 1), u)))


@pytest.mark.parametrize("case", STRAIGHT)
def test_the_kalman_filter_runs_what_is_linear_and_asks_once(case):
    made = model(**STRAIGHT[case])
    inputs = taken(made, np.full((3, 1), 1.5))
    got = sigmax.run("KF", made, PRIOR, np.zeros((3, 1)), dt=[0.0, 1.0, 2.0], inputs=inputs)
    want = sigmax.run("EKF", made, PRIOR, np.zeros((3, 1)), dt=[0.0, 1.0, 2.0], inputs=inputs)
    assert np.array_equal(got.mean, want.mean)


def test_what_was_found_of_a_model_is_remembered():
    calls = []

    def motion(x, dt):
        calls.append(None)
        return jnp.stack([x[0] + dt * x[1], x[1]])

    counts = []
    sensor = model().sensors[""]  # one object: a new one would be a new model
    for k in range(3):
        made = model(motion=motion, sensor=sensor, Q=[0.1 + k, 0.1])
        sigmax.run("KF", made, PRIOR, np.zeros((3, 1)) + k, dt=1.0 + k)
        counts.append(len(calls))
    assert counts[0] == counts[2] > 0


IMPORTS = {
    "sigmax alone": ("import sigmax, sys; assert 'jax' not in sys.modules; import jax.numpy as jnp", None),
    "jax before": ("import jax.numpy as jnp; import sigmax", None),
    "against a variable": ("import sigmax; import jax.numpy as jnp", "0"),
}


@pytest.mark.parametrize("case", IMPORTS)
def test_the_import_alone_makes_jax_64_bit(case):
    code, variable = IMPORTS[case]
    env = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    env |= {"JAX_ENABLE_X64": variable} if variable else {}
    code += "; print(jnp.array([6378137.123])[0] == 6378137.123)"
    found = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert found.stdout == "True\n"


SITE = jnp.array([6378137.123], jnp.float32)


def told(made, **given):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sigmax.run("EKF", made, PRIOR, np.zeros((3, 1)), **given)
        sigmax.Live("EKF", made, PRIOR, **given)
    return [str(w.message) for w in caught]


def at_site(x, place):
    return x[:1] - place


def closed_over():
    near = np.array([0.1], np.float32)
    return lambda x: x[:1] - near


COARSE = {
    "a global": (dict(sensor=lambda x: x[:1] - SITE), "SITE"),
    "a default": (dict(sensor=lambda x, place=SITE: x[:1] - place), "place"),
    "closed over": (dict(sensor=closed_over()), "near"),
    "in a function that it calls": (dict(sensor=lambda x: jax.jit(lambda y: y[:1] - SITE)(x)), "SITE"),
    "in a partial": (dict(sensor=functools.partial(at_site, place=SITE)), "shape \\(1,\\)"),
    "a scalar": (dict(sensor=lambda x: np.float32(0.1) * x[:1]), "0.1000000014"),
    "in the motion": (dict(motion=lambda x, dt: x + dt * 0 * SITE), "motion SITE"),
    "in Q": (dict(Q=lambda dt: dt * jnp.ones(2) * SITE), "Q SITE"),
    "in R": (dict(R=lambda x: SITE), "R what it returns"),
    "what comes out": (dict(sensor=lambda x: x[:1].astype(jnp.float32)), "sensor what it returns"),
}


@pytest.mark.parametrize("case", COARSE)
def test_a_constant_of_float32_is_told_with_its_place(case):
    changes, name = COARSE[case]
    messages = told(model(**changes))
    assert messages
    for message in messages:
        assert "float32" in message
        assert re.search(f"in .*{name}", message)
        assert "test_functions.py, line" in message or case == "what comes out" or case == "in R"


FINE = {
    "halves": dict(sensor=lambda x: np.float32(0.5) * x[:1] - np.arange(1, dtype=np.float32)),
    "Python's own": dict(sensor=lambda x: 0.1 * x[:1] - 6378137.0),
    "64-bit": dict(sensor=lambda x: x[:1] - jnp.array([0.1])),
    "said to be all": dict(sensor=lambda x: x[:1] - np.asarray(SITE, float)),
}


@pytest.mark.parametrize("case", FINE)
def test_what_lost_no_digits_is_not_told(case):
    assert told(model(**FINE[case])) == []


def test_nothing_is_told_in_a_run_of_float32():
    assert told(model(sensor=lambda x: x[:1] - SITE), dtype="float32") == []
