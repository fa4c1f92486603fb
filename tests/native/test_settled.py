"""Records whose covariance settles: the same as step by step, and as a Kalman filter written by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.engine import steady
from sigmax.engine.lowered import lowered
from sigmax.functions.current import current_model
from sigmax.preparation.prepare import as_filter

F = {
    "turn": np.array([[-0.05, 0.3, 0.0], [-0.3, -0.05, 0.2], [0.0, 0.0, -0.4]]),
    "drift": np.array([[0.0, 1.0], [0.0, 0.0]]),
}
H = {"turn": np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.2]]), "drift": np.array([[1.0, 0.0]])}
MOTIONS = {k: (lambda x, dt, A=A: x + dt * (jnp.asarray(A) @ x)) for k, A in F.items()}
SENSORS = {k: (lambda x, C=C: jnp.asarray(C) @ x) for k, C in H.items()}


def covariance(rng, n, size=1.0):
    A = rng.normal(size=(n, n + 2))
    return size * (A @ A.T) / n


def problem(kind, rng, steps):
    """A random model and prior, measurements with gaps and jumps, intervals that change now and then."""
    m, n = H[kind].shape
    Q = covariance(rng, n, 10 ** rng.uniform(-9, 1)) * rng.choice([0, 1], p=[0.1, 0.9])
    model = sigmax.Model(motion=MOTIONS[kind], sensor=SENSORS[kind], Q=Q, R=covariance(rng, m))
    prior = sigmax.Gaussian(rng.normal(size=n), covariance(rng, n, 10 ** rng.uniform(-2, 3)))
    z = rng.normal(size=(steps, m)).cumsum(0)
    for at in rng.integers(300, steps, 3):
        z[at, rng.integers(m)] = np.nan
    z[rng.integers(300, steps)] = np.nan
    z[-5, 0] = rng.choice([1e17, 1e30])
    dt = np.full(steps, rng.choice([0.1, 1.0]))
    dt[rng.integers(200, steps, 2)] *= 1.5
    dt[rng.integers(600, steps) :] *= 0.5
    return model, prior, z, dt


def step_by_step(filter, model, prior, z, dt, dtype):
    """Beside a track that is never heard whole for long, nothing settles."""
    gaps = z.copy()
    gaps[::6] = np.nan
    return sigmax.run(filter, model, prior, np.stack([z, gaps]), dt=dt, dtype=dtype, backend="native")


def kalman(kind, model, prior, z, dt):
    """Means and covariances by the textbook."""
    x, P, found = prior.mean, prior.cov, []
    R, Q = (np.diag(a.entries) if hasattr(a, "entries") else a for a in (model.R[""], model.Q))
    for value, d in zip(z, dt, strict=True):
        A = np.eye(len(x)) + d * F[kind]
        x, P = A @ x, A @ P @ A.T + d * Q
        seen = ~np.isnan(value)
        C = H[kind][seen]
        K = np.linalg.solve(C @ P @ C.T + R[np.ix_(seen, seen)], C @ P).T
        x, P = x + K @ (value[seen] - C @ x), P - K @ C @ P
        found.append((x, P))
    return [np.array(a) for a in zip(*found, strict=True)]


def same(settled, full, tolerance):
    """Every part of two results, in parts of the largest number that there was until then."""
    for part in ("mean", "stored_factor", "nis", "step_log_likelihood", "innovation", "dof", "stored_fault"):
        a, b = np.asarray(getattr(settled, part), float), np.asarray(getattr(full, part), float)[0]
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b), part)
        a, b = (np.nan_to_num(v).reshape(len(v), -1) for v in (a, b))
        size = np.maximum.accumulate(np.abs(b).max(1, keepdims=True))
        assert (np.abs(a - b) <= tolerance * (1 + size)).all(), (part, np.max(np.abs(a - b) / (1 + size)))


@pytest.mark.parametrize("filter", ["EKF", "SRCKFB"])
@pytest.mark.parametrize("kind", F)
@pytest.mark.one_in(2)
def test_settled_records_are_those_of_every_step(kind, filter):
    check(kind, filter, 4)


def check(kind, filter, rounds):
    for seed in range(rounds):
        model, prior, z, dt = problem(kind, np.random.default_rng(seed), 3000)
        settled = sigmax.run(filter, model, prior, z, dt=dt, backend="native")
        same(settled, step_by_step(filter, model, prior, z, dt, "float64"), 1e-12)
        short = slice(0, 300)
        mean, cov = kalman(kind, model, prior, z[short], dt[short])
        np.testing.assert_allclose(settled.mean[short], mean, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(settled.cov[short], cov, rtol=1e-5, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("filter", ["KF", "EKF", "SRCKFB", "SRUKFB", "UKF"])
@pytest.mark.parametrize("kind", F)
def test_settled_records_of_many_models(kind, filter):
    check(kind, filter, 200)


def test_settled_records_of_float32():
    model, prior, z, dt = problem("drift", np.random.default_rng(3), 3000)
    z[np.abs(z) > 1e10] = 0.0
    settled = sigmax.run("EKF", model, prior, z, dt=dt, dtype="float32", backend="native")
    same(settled, step_by_step("EKF", model, prior, z, dt, "float32"), 1e-4)


def is_settled(filter, steps=3000, inputs=False, **changes):
    given = dict(motion=MOTIONS["drift"], sensor=SENSORS["drift"], Q=np.eye(2), R=[1.0]) | changes
    model, chosen = current_model(sigmax.Model(**given)), as_filter(filter)
    low = lowered(chosen, model, 0, np.float64, alone=True)
    return steady.settled(low, model, {"": 1}, steps, inputs) is not None


def test_only_what_can_settle_is_settled():
    assert is_settled("EKF")
    assert is_settled("SRCKFB")
    assert not is_settled("EKF", steps=100)
    assert not is_settled("EKF", inputs=True)
    assert not is_settled(sigmax.get("EKF", update=sigmax.robust("huber")))
    bent = lambda x: jnp.stack([x[0] ** 2])  # noqa: E731
    assert not is_settled("EKF", sensor=bent)
    named = dict(state=("x", "v"), measurement=("z",))
    assert not is_settled("EKF", R=lambda x: jnp.stack([1 + x[0] ** 2]), **named)
    assert not is_settled("EKF", Q=lambda x, dt: dt * jnp.eye(2) * (1 + x[0] ** 2), **named)
    assert not is_settled("EKF", domain=lambda x: x, **named)


def test_a_batch_that_begins_alike_settles_and_one_that_does_not_is_the_same():
    model, prior, z, dt = problem("drift", np.random.default_rng(5), 1000)
    several = np.stack([z, z[::-1], np.where(np.isnan(z), 0.0, z), z + 1])
    batch = sigmax.run("EKF", model, prior, several, dt=dt, backend="native")
    apart = sigmax.Gaussian(np.stack([prior.mean] * 4), prior.cov * np.arange(1, 5)[:, None, None])
    other = sigmax.run("EKF", model, apart, several, dt=dt, backend="native")
    for k in range(4):
        one = sigmax.run("EKF", model, prior, several[k], dt=dt, backend="native")
        alone = sigmax.run("EKF", model, sigmax.Gaussian(prior.mean, apart.cov[k]), several[k], dt=dt, backend="native")
        for many, single in ((batch, one), (other, alone)):
            np.testing.assert_allclose(many.mean[k], single.mean, rtol=1e-11, atol=1e-11)
            np.testing.assert_allclose(many.cov[k], single.cov, rtol=1e-11, atol=1e-11)
