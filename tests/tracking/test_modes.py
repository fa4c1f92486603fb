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


def alike(count=2):
    return Modes([("EKF", model(density)) for density in (0.02, 25.0, 1.0)[:count]])


def taken(modes, beliefs, z, share=1.0):
    track = np.zeros(1, int)
    return modes.update(beliefs, modes.correct(beliefs, track, "", np.array([z]), None), track, np.array([share]))


def test_a_mode_comes_back_after_any_time():
    """Without switching between them the modes are judged by the plots alone: calm for long, then wild, then calm."""
    modes = alike()
    rng = np.random.default_rng(0)
    beliefs = modes.start(np.zeros((1, 4)), np.eye(4)[None] * 25)
    likelier, place, speed = [], np.zeros(2), np.zeros(2)
    for k in range(1200):
        speed = speed + rng.normal(size=2) * (8.0 if 500 <= k < 700 else 0.1)
        place = place + speed
        beliefs, sound = modes.predict(beliefs, 1.0)
        assert sound.all()
        beliefs = taken(modes, beliefs, place + NOISE * rng.standard_normal(2))
        likelier.append(beliefs.weight[0].argmax())
    assert (np.array(likelier)[100:500] == 0).all()
    assert (np.array(likelier)[530:700] == 1).all()
    assert likelier[-1] == 0


@pytest.mark.parametrize("sojourn", [None, (40.0, 8.0, 5.0), (1e-9, 1e12, 1.0)])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.one_in(4)
def test_probabilities_are_probabilities_in_any_order_of_events(sojourn, seed):
    """Plots near, absurdly far, missing, of any share, several at once, and intervals of any length."""
    modes = Modes([("EKF", model(d)) for d in (0.02, 25.0, 1.0)], sojourn=sojourn)
    rng = np.random.default_rng(seed)
    beliefs = modes.start(np.zeros((2, 4)), np.tile(np.eye(4) * 25, (2, 1, 1)))
    for _ in range(60):
        beliefs, _ = modes.predict(beliefs, float(rng.choice([0.0, 1e-9, 1.0, 10.0])))
        K = int(rng.integers(0, 4))
        track = rng.integers(0, 2, K)
        z = rng.normal(size=(K, 2)) * rng.choice([1.0, 1e3, 1e9, 1e70])
        z[rng.random((K, 2)) < 0.2] = np.nan
        share = rng.dirichlet(np.ones(K + 1))[:K] * rng.choice([1.0, 1e-300, 0.0])
        if rng.random() < 0.3:
            share = np.eye(1, K)[0]
        made = modes.correct(beliefs, track, "", z, None)
        beliefs = modes.update(beliefs, made, track, share)
        assert np.isfinite(beliefs.weight).all()
        np.testing.assert_allclose(beliefs.weight.sum(1), 1)
        assert (beliefs.weight >= 0.9e-12).all()
        mean, cov = modes.moments(beliefs)
        assert np.isfinite(mean).all()
        assert np.isfinite(cov).all()


def test_a_plot_that_is_sound_in_no_mode_is_no_plot():
    modes = alike()
    before = modes.start(np.zeros((1, 4)), np.eye(4)[None])
    after = taken(modes, before, [np.nan, np.nan])
    assert np.array_equal(after.weight, before.weight)
    for a, b in zip(after.rows, before.rows, strict=True):
        assert np.array_equal(a, b)
