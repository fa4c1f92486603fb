"""Multi-hypothesis tracking against enumeration of all hypotheses, against GNN, and under disorder."""

from itertools import product

import numpy as np
import pytest

from sigmax.tracking import Detector, Scan, Tracker, gnn, mht
from sigmax.tracking.branches import Branches
from sigmax.tracking.life import Life, Tracks
from sigmax.tracking.set_packing import best_packing
from sigmax.tracking.state import State
from tests.tracking.worlds import NOISE, cycle, modes, world

PD, CLUTTER, GATE = 0.8, 1e-4, 1 - 1e-9


def same(one, other, tolerance=0.0):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.id, b.id)
        np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=tolerance)
        np.testing.assert_allclose(a.cov, b.cov, rtol=0, atol=tolerance)


@pytest.mark.parametrize("seed", range(3))
def test_without_scans_to_wait_it_is_gnn(seed):
    scans, _ = world(targets=8, scans=20, clutter=40.0, seed=seed)
    same(Tracker(cycle(40.0, associate=mht(0))).run(scans), Tracker(cycle(40.0, associate=gnn)).run(scans))


def test_plots_that_are_plain_make_it_gnn():
    scans, _ = world(targets=4, scans=20, clutter=0.0, detection=1.0, seed=3)
    same(Tracker(cycle(1.0, associate=mht())).run(scans), Tracker(cycle(1.0, associate=gnn)).run(scans), 1e-9)


def crowd(seed, scans=25):
    """Targets side by side in dense clutter."""
    rng = np.random.default_rng(seed)
    for k in range(scans):
        x = np.stack([20.0 * k * np.ones(3), np.array([-1.0, 0.0, 1.0]) * abs(12 - k) * 3], 1)
        z = x[rng.random(3) < 0.9] + 0.0
        z += NOISE * rng.standard_normal(z.shape)
        false = rng.uniform([20.0 * k - 100, -100], [20.0 * k + 100, 100], (3, 2))
        yield Scan(2.0 * k, "", rng.permutation(np.concatenate([z, false])))


def test_late_scans_and_a_break_change_nothing():
    scans = list(crowd(1))
    rng = np.random.default_rng(2)
    c = cycle(3.0, associate=mht())
    plain = Tracker(c).run(scans)
    assert max(len(t.id) for t in plain) >= 3
    late = Tracker(c, window=6.0)
    same(late.run(sorted(scans, key=lambda s: s.time + rng.uniform(0, 5))), plain)
    assert late.counts["late"] > 0
    first = Tracker(c)
    first.run(scans[:12])
    second = Tracker(c)
    second.restore(first.save())
    same(second.run(scans[12:])[-13:], plain[12:])


def test_memory_is_bounded():
    c = cycle(3.0, associate=mht(branches=5))
    tracker = Tracker(c)
    most = 0
    for scan in crowd(5):
        tracker.step(scan)
        if len(tracker.state.tracks.life.id):
            most = max(most, np.unique(tracker.state.tracks.life.id, return_counts=True)[1].max())
    # The quiet child of the best one may come on top.
    assert 1 < most <= 6


@pytest.mark.parametrize("seed", range(40))
def test_the_packing_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    family = np.repeat(np.arange(3), 5)
    score, plots = rng.normal(size=15), rng.integers(-1, 4, (15, 2))
    plots[::5] = -1
    found = best_packing(family, score, plots, np.arange(0, 15, 5))
    best = -np.inf
    for chosen in product(range(5), range(5, 10), range(10, 15)):
        rows = [[(k, p) for k, p in enumerate(plots[b]) if p >= 0] for b in chosen]
        used = [u for row in rows for u in row]
        if len(set(used)) == len(used):
            best = max(best, score[list(chosen)].sum())
    assert score[found].sum() == pytest.approx(best)


@pytest.mark.parametrize("wait", [1, 2])
@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_enumeration_of_all_hypotheses(seed, wait):
    """Two targets, Kalman filters by hand, every joint sequence kept until `wait` scans decide."""
    rng = np.random.default_rng(seed)
    mean = np.array([[0.0, -12.0, 10.0, 1.0], [0.0, 12.0, 10.0, -1.0]])
    cov = np.tile(np.diag([25.0, 25.0, 4.0, 4.0]), (2, 1, 1))
    c = cycle(
        associate=mht(wait, 10**6, 1e6),
        gate=GATE,
        merge=0.0,
        lifetime=1e300,
        rule=lambda t, life: (np.ones(len(life.id), bool), np.zeros(len(life.id), bool)),
    )
    object.__setattr__(c, "detectors", {"": Detector(PD, CLUTTER, None)})
    life = Life.begun(0, mean[:, :2], 0.0, 0.9, 1)
    state = State(Tracks(0.0, modes().start(mean, cov), life), 2, {}, Branches.begun(np.full(2, -1), wait))
    F = np.eye(4)
    F[0, 2] = F[1, 3] = 2.0
    q = 0.1
    Q = q * np.kron(np.array([[8 / 3, 2.0], [2.0, 2.0]]), np.eye(2))
    H, R = np.eye(2, 4), NOISE**2 * np.eye(2)
    hypotheses = [(0.0, (), mean, cov)]
    for k in range(1, 5):
        truth = np.array([[20.0 * k, -12 + 6 * k], [20.0 * k, 12 - 6 * k]])
        z = truth + NOISE * rng.standard_normal((2, 2))
        if rng.random() < 0.3:
            z = z[:1]
        turned = c.advance(state, Scan(2.0 * k, "", z[::-1]))[1]
        state, told = c.advance(state, Scan(2.0 * k, "", z))
        np.testing.assert_allclose(turned.mean, told.mean, atol=1e-9)
        grown = []
        for score, past, m, P in hypotheses:
            m, P = m @ F.T, F @ P @ F.T + Q
            for event in product(range(-1, len(z)), repeat=2):
                if event[0] == event[1] >= 0:
                    continue
                s, mm, PP = score, m.copy(), P.copy()
                for i, j in enumerate(event):
                    if j < 0:
                        s += np.log(1 - PD * GATE)
                        continue
                    S = H @ P[i] @ H.T + R
                    v = z[j] - H @ m[i]
                    s += np.log(PD / CLUTTER) - 0.5 * (v @ np.linalg.solve(S, v) + np.log(np.linalg.det(2 * np.pi * S)))
                    K = P[i] @ H.T @ np.linalg.inv(S)
                    mm[i], PP[i] = m[i] + K @ v, P[i] - K @ S @ K.T
                grown.append((s, (*past, event), mm, PP))
        best = max(grown, key=lambda h: h[0])
        hypotheses = [h for h in grown if k <= wait or h[1][: k - wait] == best[1][: k - wait]]
        np.testing.assert_allclose(told.mean, best[2], atol=1e-6)
        np.testing.assert_array_equal(told.plot, best[1][-1])
