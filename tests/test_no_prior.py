"""A prior from the first measurements: least squares in the linear case, honest in the nonlinear one, rank judged."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.spaces import Rotation

CV = sigmax.motions.constant_velocity()
RNG = np.random.default_rng(0)
T, DT = 6, 0.7
# Two positions in turn, from step to step.
Z = np.where((np.arange(T)[:, None] + [0, 1]) % 2 == 1, 3 * RNG.standard_normal((T, 2)), np.nan)
PLANE = sigmax.Model(motion=CV, sensor=lambda x: x[:2], Q=CV.noise(0.3), R=[1.0, 4.0])


def by_least_squares(z):
    """Mean and covariance of the last state: all states and measurements in one dense system."""
    F = np.block([[np.eye(2), DT * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    L = np.linalg.cholesky(np.asarray(CV.noise(0.3)(DT)))
    rows, right = [], []
    for k in range(T):
        for i, deviation in enumerate((1.0, 2.0)):
            if np.isfinite(z[k, i]):
                row = np.zeros((1, 4 * T))
                row[0, 4 * k + i] = 1 / deviation
                rows.append(row)
                right.append([z[k, i] / deviation])
        if k:
            block = np.zeros((4, 4 * T))
            block[:, 4 * k : 4 * k + 4] = np.linalg.inv(L)
            block[:, 4 * k - 4 : 4 * k] = -np.linalg.inv(L) @ F
            rows.append(block)
            right.append(np.zeros(4))
    A, b = np.concatenate(rows), np.concatenate(right)
    cov = np.linalg.inv(A.T @ A)
    return (cov @ A.T @ b)[-4:], cov[-4:, -4:]


def test_of_a_linear_model_it_is_least_squares():
    found = sigmax.start(PLANE, Z, dt=DT)
    mean, cov = by_least_squares(Z)
    scale = np.sqrt(np.diag(cov))
    assert np.abs((found.mean - mean) / scale).max() < 1e-8
    assert np.abs((found.cov - cov) / np.outer(scale, scale)).max() < 1e-9


def test_a_filter_goes_on_as_from_a_wide_prior():
    more = RNG.standard_normal((4, 2))
    went_on = sigmax.run("SRCKFB", PLANE, sigmax.start(PLANE, Z, dt=DT), more, dt=DT)
    wide = sigmax.Gaussian(np.zeros(4), np.full(4, 1e12))
    whole = sigmax.run("SRCKFB", PLANE, wide, np.concatenate([Z, more]), dt=DT, update_first=True)
    assert np.abs((went_on.mean - whole.mean[T:]) / whole.std[T:]).max() < 1e-6


STATIONS = jnp.array([[0.0, 0.0], [8.0, 0.0]])
BEARING = np.radians(0.5)


def bearings(x):
    return jnp.arctan2(x[1] - STATIONS[:, 1], x[0] - STATIONS[:, 0])


TWO = sigmax.Model(
    motion=CV,
    sensor=bearings,
    Q=CV.noise(0.05),
    R=np.full(2, BEARING**2),
    measurement=(sigmax.angle("a"), sigmax.angle("b")),
)


def crossing(tracks, seed):
    """Targets six metres from two stations, seen twice; the states at the second time."""
    rng = np.random.default_rng(seed)
    x = np.array([4.0, 6.0, 0.0, 0.0]) + rng.standard_normal((tracks, 4)) * [1.0, 1.0, 0.5, 0.5]
    L = np.linalg.cholesky(np.asarray(CV.noise(0.05)(1.0)))
    after = x + np.c_[x[:, 2:], np.zeros((tracks, 2))] + rng.standard_normal((tracks, 4)) @ L.T
    seen = [np.arctan2(y[:, 1, None] - STATIONS[:, 1], y[:, 0, None] - STATIONS[:, 0]) for y in (x, after)]
    return after, np.stack(seen, 1) + BEARING * rng.standard_normal((tracks, 2, 2))


def test_two_bearings_from_two_stations_give_an_honest_start():
    """Four numbers for four unknowns, where a filter from a wide prior claims too much."""
    after, z = crossing(400, 1)
    found = sigmax.start(TWO, z, dt=1.0, at=[4.0, 6.0, 0.0, 0.0])
    e = found.mean - after
    nees = np.einsum("bi,bi->b", e, np.linalg.solve(found.cov, e[..., None])[..., 0]) / 4
    # The mean of 400 chi-squares of four degrees has a deviation of 0.035.
    assert 0.88 < nees.mean() < 1.12
    alone = sigmax.start(TWO, z[7], dt=1.0, at=[4.0, 6.0, 0.0, 0.0])
    np.testing.assert_allclose(alone.mean, found.mean[7], rtol=1e-12)
    wide = sigmax.Gaussian([4.0, 6.0, 0.0, 0.0], np.full(4, 100.0))
    filtered = sigmax.run("EKF", TWO, wide, z, dt=1.0, update_first=True)
    e = filtered.mean[:, -1] - after
    assert np.einsum("bi,bi->b", e, np.linalg.solve(filtered.cov[:, -1], e[..., None])[..., 0]).mean() / 4 > 1.5


def test_an_attitude_from_two_directions_known():
    """Directions of the sky seen from the body fix an attitude at once, from a guess a radian off."""
    sky = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    model = sigmax.Model(
        motion=lambda x, dt: x,
        sensor=lambda x: jnp.concatenate([sigmax.spaces.rotate(sigmax.spaces.conjugate(x), v) for v in sky]),
        Q=np.full(3, 1e-4),
        R=np.full(6, 1e-4),
        state=(sigmax.rotation("attitude"),),
    )
    truth = np.asarray(sigmax.spaces.exponential(jnp.array([0.6, -0.5, 0.7])))
    z = np.asarray(model.sensors[""](truth))[None] + 0.01 * RNG.standard_normal((1, 6))
    found = sigmax.start(model, z, at=[1.0, 0.0, 0.0, 0.0])
    e = np.asarray(Rotation().difference(jnp.asarray(truth), jnp.asarray(found.mean)))
    assert e @ np.linalg.solve(found.cov, e) < 16
    with pytest.raises(sigmax.InputError, match="give at="):
        sigmax.start(model, z)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: sigmax.start(PLANE, Z * [1.0, np.nan], dt=DT), "do not determine y, vy"),
        (lambda: sigmax.start(PLANE, Z[:1], dt=DT), "do not determine"),
        (lambda: sigmax.start(PLANE, Z, dt=DT, at=[0.0]), "at must be a state"),
        (lambda: sigmax.start(PLANE, Z, dt=DT, within={"w": 1.0}), "'w'"),
        (lambda: sigmax.start(PLANE, Z, dt=DT, within={"vx": 0.0}), "above 0"),
        (lambda: sigmax.start(TWO, crossing(1, 1)[1][0], dt=1.0, at=[0.0, 0.0, 0.0, np.nan]), "finite"),
    ],
)
def test_what_cannot_be_is_told_in_words(call, says):
    with pytest.raises(sigmax.InputError, match=says):
        call()


def test_a_batch_of_anything_gives_a_prior_for_each():
    intervals = np.array([0.5, 0.7, 1.1])[:, None] * np.ones(T)
    found = sigmax.start(PLANE, Z, dt=intervals)
    for k, dt in enumerate(intervals):
        alone = sigmax.start(PLANE, Z, dt=dt)
        np.testing.assert_allclose(found.mean[k], alone.mean, rtol=1e-12)
        np.testing.assert_allclose(found.cov[k], alone.cov, rtol=1e-12)
    with pytest.raises(sigmax.InputError, match="differ in size"):
        sigmax.start(PLANE, np.stack([Z, Z]), dt=intervals)


def test_what_is_known_besides_counts_as_a_measurement():
    found = sigmax.start(PLANE, Z[:2], dt=DT, within={"x": 5.0, "vx": 1.0, "vy": 1.0})
    wide = sigmax.Gaussian(np.zeros(4), [25.0, 1e14, 1.0, 1.0])
    want = sigmax.run("SRCKFB", PLANE, wide, Z[:2], dt=DT, update_first=True)
    np.testing.assert_allclose(found.mean, want.mean[-1], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.cov, want.cov[-1], rtol=1e-7, atol=1e-9)


def test_measurements_that_fit_no_state_are_told():
    with pytest.warns(UserWarning, match="fit badly"):
        sigmax.start(PLANE, np.where(np.arange(T)[:, None] == 3, 1e4, 0.0) * np.ones(2), dt=DT)
