"""What is given is taken for what it means, by its names and as it was when it was checked, or refused in words."""

import pickle
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax import motions, sensors

FLAT = motions.constant_velocity(("x", "y"))
PRIOR = sigmax.Gaussian([0.0, 0.0, 1.0, 1.0], np.eye(4))
RNG = np.random.default_rng(3)
Z = np.cumsum(RNG.normal(1.0, 0.3, (7, 2)), 0)
DT = np.array([1.0, 0.5, 2.0, 1.0, 0.3, 0.7, 1.0])
U = RNG.normal(size=(7, 2))


def model(**changes):
    given = dict(motion=FLAT, sensor=sensors.position(), Q=FLAT.noise(0.1), R=[0.25, 0.5])
    return sigmax.Model(**given | changes)


def pushed(x, dt, u):
    return x + dt * jnp.concatenate([x[2:], u])


PLAIN, DRIVEN = model(), model(motion=pushed, state=FLAT.state, Q=[0.1] * 4)
TRACKS = np.stack([Z, Z[::-1]])
BY_TRACK = np.stack([DT, DT[::-1]])
RUNS = {
    "one dt": (PLAIN, Z, dict(dt=0.5)),
    "dt by step": (PLAIN, Z, dict(dt=DT)),
    "an update first": (PLAIN, Z, dict(dt=DT[1:], update_first=True)),
    "inputs": (DRIVEN, Z, dict(dt=DT, inputs=U)),
    "tracks": (PLAIN, TRACKS, dict(dt=DT)),
    "tracks of their own dt": (PLAIN, TRACKS, dict(dt=BY_TRACK)),
    "tracks of their own inputs": (DRIVEN, TRACKS, dict(dt=DT, inputs=np.stack([U, -U]))),
    "in float32": (DRIVEN, Z, dict(dt=DT, inputs=U, dtype="float32")),
}


@pytest.mark.parametrize(("case", "backend"), list(product(RUNS, ["native", "xla"])))
@pytest.mark.one_in(2)
def test_a_record_is_smoothed_over_the_steps_it_was_run_with(case, backend):
    """With nothing but the result, pickled or not, as with dt and inputs given again; the caller's arrays change."""
    made, z, steps = RUNS[case]
    given = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in steps.items()}
    result = sigmax.run("SRCKF", made, PRIOR, z, **given, backend=backend)
    for value in given.values():
        if isinstance(value, np.ndarray):
            value[...] = 99.0
    again = {k: v for k, v in steps.items() if k in ("dt", "inputs")}
    want = sigmax.smooth("SRCKF", made, result, **again, backend=backend)
    for one in (result, pickle.loads(pickle.dumps(result))):
        got = sigmax.smooth("SRCKF", made, one, backend=backend)
        np.testing.assert_allclose(got.mean, want.mean, rtol=1e-6 if case == "in float32" else 1e-12)
        np.testing.assert_allclose(got.cov, want.cov, rtol=1e-5 if case == "in float32" else 1e-10, atol=1e-12)
    if z.ndim == 3:
        some = jax.tree.map(lambda a: a[1:], result)
        np.testing.assert_allclose(sigmax.smooth("SRCKF", made, some, backend=backend).mean, want.mean[1:], rtol=1e-9)


@pytest.mark.slow
def test_a_gradient_goes_through_a_smoothed_run():
    def spread(q):
        made = model(Q=jnp.ones(4) * q)
        return sigmax.smooth("SRCKF", made, sigmax.run("SRCKF", made, PRIOR, Z, dt=DT)).std.sum()

    h = 1e-5
    assert np.isclose(jax.grad(spread)(0.1), (spread(0.1 + h) - spread(0.1 - h)) / (2 * h), rtol=1e-5)


OTHER = motions.constant_velocity(("e", "n"))
RAN = sigmax.run("EKF", DRIVEN, PRIOR, Z, dt=DT, inputs=U)
NOT_OF_THE_RUN = {
    "one dt": (lambda: sigmax.smooth("EKF", DRIVEN, RAN, dt=1.0), "dt must be those of the run"),
    "another dt": (lambda: sigmax.smooth("EKF", DRIVEN, RAN, dt=DT + 0.1), "dt must be those of the run"),
    "dt of tracks": (lambda: sigmax.smooth("EKF", DRIVEN, RAN, dt=BY_TRACK), "dt must be those of the run"),
    "other inputs": (lambda: sigmax.smooth("EKF", DRIVEN, RAN, inputs=2 * U), "inputs must be those of the run"),
    "another number": (lambda: sigmax.smooth("EKF", DRIVEN, RAN, inputs=U[:, :1]), "inputs must be those of the run"),
    "a model of other names": (lambda: sigmax.smooth("EKF", model(motion=OTHER), RAN), "its state is .*'e'"),
    "a smaller model": (
        lambda: sigmax.smooth("EKF", model(motion=lambda x, dt: x, Q=[1.0] * 2, state=("x", "y")), RAN),
        "its state is",
    ),
    "angles": (
        lambda: sigmax.smooth("EKF", model(state=(*FLAT.state[:3], sigmax.angle(FLAT.state[3]))), RAN),
        "whose angles are",
    ),
    "no inputs taken": (lambda: sigmax.smooth("EKF", PLAIN, RAN), "nothing in this model takes inputs"),
    "nothing kept": (
        lambda: sigmax.smooth("EKF", PLAIN, sigmax.run("EKF", PLAIN, PRIOR, Z, keep={"mean"})),
        "was not kept",
    ),
}


@pytest.mark.parametrize("case", NOT_OF_THE_RUN)
def test_what_is_not_of_the_run_is_refused_by_its_smoother(case):
    call, says = NOT_OF_THE_RUN[case]
    with pytest.raises(sigmax.InputError, match=says):
        call()


def test_what_was_checked_stays_as_it_was():
    """Editing the caller's arrays changes nothing, and what a part shows cannot be edited."""
    q, dense, R, mean, cov, B, b = (
        np.ones(4) * 0.1,
        np.eye(4) * 0.1 + 0.01,
        np.array([0.25, 0.5]),
        np.zeros(4),
        np.eye(4),
        np.ones((4, 1)),
        np.ones(1),
    )

    def runs(filter, made):
        return sigmax.run(filter, made, sigmax.Gaussian(mean, cov), Z, dt=DT).mean

    def built():
        bias = sigmax.Bias(prior=sigmax.Gaussian(b, b), motion=B, Q=b)
        return [model(Q=q, R=R), model(Q=dense, R=np.diag(R)), model(bias=bias), model(Q=FLAT.noise(q[:2]))]

    prior, models = sigmax.Gaussian(mean, cov), built()
    want = [runs("EKF", made) for made in models]
    for array in (q, dense, R, mean, cov, B, b):
        array[...] = -5.0
    for made, expected in zip(models, want, strict=True):
        assert np.array_equal(sigmax.run("EKF", made, prior, Z, dt=DT).mean, expected)
    for array in (prior.mean, prior.cov, models[0].Q.entries, models[1].Q, models[2].bias.motion):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_frame_is_taken_by_the_names_of_its_columns():
    z, u = pd.DataFrame(Z, columns=["x", "y"]), pd.DataFrame(U, columns=["speed", "turn_rate"])
    truth = pd.DataFrame(RNG.normal(size=(7, 4)), columns=list(FLAT.state))
    want = sigmax.run("EKF", PLAIN, PRIOR, Z)
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, z[["y", "x"]]).mean, want.mean)
    assert np.array_equal(want.errors(truth[truth.columns[::-1]]), want.mean - truth.to_numpy())
    unnamed = model(sensor=lambda x: x[:2])
    assert np.array_equal(sigmax.run("EKF", unnamed, PRIOR, z).mean, want.mean)
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, pd.DataFrame(Z)).mean, want.mean)
    live, other = (sigmax.Live("EKF", PLAIN, PRIOR) for _ in range(2))
    live.step(z[["y", "x"]].iloc[0], 1.0)
    other.step(Z[0], 1.0)
    assert np.array_equal(live.mean, other.mean)
    unicycle = motions.unicycle()
    robot = sigmax.Model(motion=unicycle, sensor=sensors.position(), Q=[0.1] * 3, R=[1.0, 1.0])
    start = sigmax.Gaussian(np.zeros(3), np.eye(3))
    driven = [sigmax.run("EKF", robot, start, Z, inputs=v).mean for v in (U, u, u[["turn_rate", "speed"]])]
    assert np.array_equal(driven[0], driven[1])
    assert np.array_equal(driven[0], driven[2])


LIVE, LIVE_DRIVEN = sigmax.Live("EKF", PLAIN, PRIOR), sigmax.Live("EKF", DRIVEN, PRIOR)
RESULT = sigmax.run("EKF", PLAIN, PRIOR, Z)
EPOCHS = 1.7e9 + np.arange(7.0)
LEVEL = dict(motion=lambda x, dt: x, sensor=lambda x: x, Q=[1.0] * 2, R=[1.0] * 2)
REFUSED = {
    "other columns": (
        lambda: sigmax.run("EKF", PLAIN, PRIOR, pd.DataFrame(Z, columns=["lat", "lon"])),
        r"columns \['lat', 'lon'\], the model \['x', 'y'\]",
    ),
    "one column of another name": (
        lambda: sigmax.run("EKF", PLAIN, PRIOR, pd.DataFrame(Z, columns=["x", "z"])),
        "columns",
    ),
    "a column twice": (lambda: sigmax.run("EKF", PLAIN, PRIOR, pd.DataFrame(Z, columns=["x", "x"])), "columns"),
    "a row of other names": (lambda: LIVE.update(pd.Series([1.0, 2.0], index=["e", "n"])), "entries"),
    "a truth of other names": (
        lambda: RESULT.errors(pd.DataFrame(np.zeros((7, 4)), columns=list("abcd"))),
        "the truth has columns",
    ),
    "a truth of one column": (lambda: RESULT.errors(np.zeros((7, 1))), r"shape \(7, 4\)"),
    "a truth of fewer rows": (lambda: RESULT.errors(np.zeros((6, 4))), r"shape \(7, 4\)"),
    "a truth of one row": (lambda: RESULT.errors(np.zeros(4)), r"shape \(7, 4\)"),
    "a set of states": (lambda: sigmax.Model(**LEVEL, state={"pos", "vel"}), "state .* set has no order"),
    "a dict of states": (lambda: sigmax.Model(**LEVEL, state={"pos": 1, "vel": 2}), "dict has no order"),
    "a set measured": (lambda: sigmax.Model(**LEVEL, measurement=frozenset("ab")), "measurement .* no order"),
    "a set of biases": (
        lambda: sigmax.Bias(prior=sigmax.Gaussian([0.0, 0.0], [1.0, 1.0]), motion=np.eye(2), names={"a", "b"}),
        "names .* no order",
    ),
    "inputs for nobody": (lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, inputs=U), "nothing in this model takes inputs"),
    "u for nobody": (lambda: LIVE.predict(1.0, u=[1.0]), "nothing in this model takes inputs"),
    "u of a step for nobody": (lambda: LIVE.step(Z[0], 1.0, u=[1.0]), "nothing in this model takes inputs"),
    "u of an update for nobody": (lambda: LIVE.update(Z[0], u=[1.0]), "nothing in this model takes inputs"),
    "inputs left out": (lambda: sigmax.run("EKF", DRIVEN, PRIOR, Z), "motion takes inputs u"),
    "times for dt": (lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=EPOCHS), "give them as t="),
    "times of tracks": (lambda: sigmax.run("EKF", PLAIN, PRIOR, TRACKS, dt=np.stack([EPOCHS] * 2)), "give them as t="),
    "times after an update": (
        lambda: sigmax.run("EKF", PLAIN, PRIOR, Z, dt=EPOCHS[1:], update_first=True),
        "give them as t=",
    ),
    "a covariance": (lambda: sigmax.Gaussian([0.0, 0.0], [1.0, 1.0, 1.0]), r"shape \(2, 2\) or \(2,\)"),
    "Q of a function": (
        lambda: sigmax.run("EKF", model(Q=lambda dt: jnp.eye(4).at[0, 1].set(0.5)), PRIOR, Z),
        r"Q\(…\) at the start must be symmetric; .* use \(P \+ P\.T\) / 2 of this P",
    ),
    "a sensor of several": (lambda: LIVE.update(Z[0], "x"), "unknown sensor 'x'; none here has a name"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_meant_is_refused_in_words(case):
    call, says = REFUSED[case]
    with pytest.raises(sigmax.InputError, match=says):
        call()


def test_intervals_that_are_long_or_grow_are_no_times():
    for dt in (np.full(7, 2e5), 1.0 + 1e-6 * np.arange(7), np.arange(7.0), 1e5 * 2.0 ** np.arange(7)):
        assert sigmax.run("EKF", PLAIN, PRIOR, Z, dt=dt).ok.all()


def test_a_function_of_any_arguments_needs_no_inputs():
    made = model(motion=lambda *a: FLAT.function(*a), state=FLAT.state, sensor=lambda *a: a[0][:2])
    assert np.array_equal(sigmax.run("EKF", made, PRIOR, Z).mean, RESULT.mean)


@pytest.mark.parametrize("row", [1, 0])
def test_a_row_that_is_none_is_a_row_missing(row):
    z, holed = Z.tolist(), Z.copy()
    z[row], holed[row] = None, np.nan
    want = sigmax.run("EKF", PLAIN, PRIOR, holed)
    assert np.array_equal(sigmax.run("EKF", PLAIN, PRIOR, z).mean, want.mean)
    tracks = sigmax.run("EKF", PLAIN, PRIOR, [z, Z.tolist()])
    assert np.array_equal(tracks.mean[0], want.mean)


@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("name", ["EKF", "SRCKF", "EIF", "SREKFB"])
@pytest.mark.one_in(2)
def test_a_measurement_beyond_all_reason_is_a_fault(name, backend):
    """Its square has no number: neither NIS nor log-likelihood of the record say inf, and the other track goes on."""
    wild = Z.copy()
    wild[3] = 1e160
    got = sigmax.run(name, PLAIN, PRIOR, np.stack([wild, Z]), backend=backend)
    assert not got.ok[0, 3]
    assert got.ok[1].all()
    assert np.isfinite(got.log_likelihood).all()
    assert not np.isinf(got.nis).any()


@pytest.mark.parametrize("where", ["motion", "sensor"])
def test_a_parameter_in_a_linear_function_is_fitted_with_the_kalman_filter(where):
    """As with EKF, which is the same on a linear model and asks for no linearity; what is not linear is refused."""

    def built(power):
        def build(p):
            motion = (lambda x, dt: p["a"] * x) if where == "motion" else (lambda x, dt: 0.8 * x)
            sensor = (lambda x: p["a"] * x**power) if where == "sensor" else (lambda x: x**power)
            made = sigmax.Model(motion=motion, sensor=sensor, Q=[0.1], R=[0.1], state=("level",))
            return made, sigmax.Gaussian([1.0], [1.0])

        return build

    rng, x, z = np.random.default_rng(0), 1.0, []
    for _ in range(60):
        x = 0.8 * x + rng.normal(0, 0.3)
        z.append([x + rng.normal(0, 0.3)])
    got, want = (sigmax.fit(name, built(1), {"a": 0.5}, np.array(z)) for name in ("KF", "EKF"))
    assert got.converged
    assert np.isclose(got.parameters["a"], want.parameters["a"], rtol=1e-4)
    with pytest.raises(sigmax.InputError, match="KF is for linear models"):
        sigmax.fit("KF", built(2), {"a": 0.5}, np.array(z))
