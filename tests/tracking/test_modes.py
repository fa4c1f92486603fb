"""The IMM filter beside one written out here in NumPy, and beside FilterPy's."""

import numpy as np
import pytest

from sigmax.tracking import Modes
from tests.tracking.worlds import NOISE, model

DENSITIES = (0.02, 25.0)
SOJOURN = (40.0, 8.0)
H = np.eye(2, 4)
R = NOISE**2 * np.eye(2)


def transition(dt):
    """Of two modes that are left at the rates a and b, in closed form."""
    a, b = 1 / SOJOURN[0], 1 / SOJOURN[1]
    gone = 1 - np.exp(-(a + b) * dt)
    return np.array([[1 - a / (a + b) * gone, a / (a + b) * gone], [b / (a + b) * gone, 1 - b / (a + b) * gone]])


def motion(dt, density):
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    one = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F, np.kron(one, np.eye(2))


def textbook(mean, cov, weight, moments, plots):
    """Blom and Bar-Shalom 1988, table I: mix, predict and correct each mode, weigh, combine."""
    x, P, mu = [mean] * 2, [cov] * 2, np.array(weight)
    for dt, z in zip(np.diff(moments, prepend=0.0), plots, strict=True):
        p = transition(dt)
        after = mu @ p
        mixed = mu[:, None] * p / after
        x0 = [sum(mixed[i, j] * x[i] for i in range(2)) for j in range(2)]
        P0 = [sum(mixed[i, j] * (P[i] + np.outer(x[i] - x0[j], x[i] - x0[j])) for i in range(2)) for j in range(2)]
        like = np.ones(2)
        x, P = [], []
        for j, density in enumerate(DENSITIES):
            F, Q = motion(dt, density)
            m, C = F @ x0[j], F @ P0[j] @ F.T + Q
            if not np.isnan(z).any():
                S = H @ C @ H.T + R
                v = z - H @ m
                K = C @ H.T @ np.linalg.inv(S)
                like[j] = np.exp(-0.5 * v @ np.linalg.solve(S, v)) / np.sqrt(np.linalg.det(2 * np.pi * S))
                m, C = m + K @ v, C - K @ S @ K.T
            x.append(m)
            P.append(C)
        mu = after * like / (after @ like)
        center = mu @ np.array(x)
        yield center, sum(w * (C + np.outer(m - center, m - center)) for w, m, C in zip(mu, x, P, strict=True)), mu


def world(even):
    """A target that turns hard for a while, seen at uneven moments, once not at all."""
    rng = np.random.default_rng(4)
    moments = 2.0 * np.arange(1, 41) if even else np.cumsum(rng.uniform(0.3, 4.0, 40))
    path = np.stack([20 * moments, np.where(moments > 40, 300 * np.sin((moments - 40) / 10), 0.0)], axis=1)
    plots = path + NOISE * rng.standard_normal(path.shape)
    if not even:
        plots[17] = np.nan
    return np.array([0.0, 0, 20, 0]), np.diag([100.0, 100, 16, 16]), moments, plots


def ours(mean, cov, moments, plots):
    # Forms that differ: what they carry must not show.
    modes = Modes([("EKF", model(DENSITIES[0])), ("SREKFB", model(DENSITIES[1]))], sojourn=SOJOURN)
    beliefs = modes.start(mean[None], cov[None])
    for dt, z in zip(np.diff(moments, prepend=0.0), plots, strict=True):
        beliefs, sound = modes.predict(beliefs, dt)
        assert sound.all()
        if not np.isnan(z).any():
            track = np.zeros(1, int)
            beliefs = modes.update(beliefs, modes.correct(beliefs, track, "", z[None], None), track, np.ones(1))
        m, C = modes.moments(beliefs)
        yield m[0], C[0], beliefs.weight[0]


def test_the_imm_filter_is_that_of_the_textbook():
    mean, cov, moments, plots = world(even=False)
    weight = np.array(SOJOURN) / sum(SOJOURN)
    seen = []
    for one, other in zip(ours(mean, cov, moments, plots), textbook(mean, cov, weight, moments, plots), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
        seen.append(one[2][1])
    # Both modes had their time, else nothing is compared.
    assert min(seen) < 0.1
    assert max(seen) > 0.9


def test_the_imm_filter_is_that_of_filterpy():
    kalman = pytest.importorskip("filterpy.kalman", reason="FilterPy is not installed")
    mean, cov, moments, plots = world(even=True)
    filters = []
    for density in DENSITIES:
        f = kalman.KalmanFilter(dim_x=4, dim_z=2)
        f.F, f.Q = motion(2.0, density)
        f.H, f.R, f.x, f.P = H, R, mean.copy(), cov.copy()
        filters.append(f)
    theirs = kalman.IMMEstimator(filters, np.array(SOJOURN) / sum(SOJOURN), transition(2.0))
    for (m, C, weight), z in zip(ours(mean, cov, moments, plots), plots, strict=True):
        theirs.predict()
        theirs.update(z)
        np.testing.assert_allclose(m, theirs.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(C, theirs.P, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(weight, theirs.mu, rtol=1e-9, atol=1e-9)


def test_modes_change_in_any_steps_alike():
    """Two short predictions move the probabilities of the modes as one long one does, and the sojourn is as said."""
    mean, cov = np.zeros((1, 4)), np.eye(4)[None]
    modes = Modes([("EKF", model(DENSITIES[0])), ("EKF", model(DENSITIES[1]))], sojourn=SOJOURN)
    start = modes.start(mean, cov)._replace(weight=np.array([[1.0, 0.0]]))
    once = modes.predict(start, 5.0)[0].weight
    twice = modes.predict(modes.predict(start, 2.0)[0], 3.0)[0].weight
    np.testing.assert_allclose(once, twice, rtol=1e-12)
    np.testing.assert_allclose(once[0], transition(5.0)[0], rtol=1e-12)
    short = modes.predict(start, 1e-3)[0].weight
    assert short[0, 1] == pytest.approx(1e-3 / SOJOURN[0], rel=1e-3)
