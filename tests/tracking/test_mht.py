"""Multi-hypothesis tracking against enumeration of all hypotheses, against GNN, and under disorder."""

from itertools import product

import numpy as np
import pytest

from sigmax.tracking import Detector, Scan, Tracker, gnn, mht
from sigmax.tracking.branches import Branches
from sigmax.tracking.global_hypotheses import global_hypotheses
from sigmax.tracking.life import Life, Tracks
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
def test_without_scans_to_wait_targets_that_are_certain_make_it_gnn(seed):
    scans, truth = world(targets=8, scans=20, clutter=400.0, seed=seed)
    mean = np.array([[*t.position[0], *(t.position[1] - t.position[0]) / 2] for t in truth])
    found = []
    for rule in (mht(0), gnn):
        c, state = settled(rule, mean, np.diag([25.0, 25.0, 4.0, 4.0]), 1 - 1e-15, detection=0.9, clutter=6e-6)
        told = []
        for scan in scans[1:]:
            state, one = c.advance(state, scan)
            told.append(one)
        found.append(told)
    same(*found)


def test_plots_that_are_plain_make_it_gnn():
    scans, _ = world(targets=4, scans=20, clutter=0.0, detection=1.0, seed=3)
    same(Tracker(cycle(1.0, associate=mht())).run(scans), Tracker(cycle(1.0, associate=gnn)).run(scans), 0.1)


def settled(associate, mean, cov, existence, detection=PD, clutter=CLUTTER):
    """A cycle in which no track begins and none ends, and its state with these tracks at time 0."""
    c = cycle(
        associate=associate,
        gate=GATE,
        merge=0.0,
        lifetime=1e300,
        rule=lambda t, life: (np.ones(len(life.id), bool), np.zeros(len(life.id), bool)),
    )
    object.__setattr__(c, "detectors", {"": Detector(detection, clutter, None)})
    F = len(mean)
    beliefs = modes().start(mean, np.tile(cov, (F, 1, 1)))
    branches = None if associate is gnn else Branches.begun(np.full(F, -1), associate.scans, existence)
    return c, State(Tracks(0.0, beliefs, Life.begun(0, mean[:, :2], 0.0, existence, 1)), F, {}, branches)


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


@pytest.mark.parametrize("words", [1, 2])
@pytest.mark.parametrize("seed", range(40))
@pytest.mark.one_in(4)
def test_shares_and_the_likeliest_are_those_of_all_global_hypotheses(seed, words):
    """Against enumeration; with two words there are more plots than bits in one."""
    rng = np.random.default_rng(seed)
    family, score = np.repeat(np.arange(3), 5), 3 * rng.normal(size=15)
    plots, absent = rng.integers(-1, 4, (15, 2)), 3 * rng.normal(size=3)
    if words == 2:
        crowd_of = np.arange(70)
        family = np.concatenate([family, np.repeat([3, 4], 70)])
        score = np.concatenate([score, np.full(140, -50.0)])
        plots = np.concatenate([plots, np.stack([np.full(140, -1), np.tile(crowd_of, 2)], 1)])
        # One plot ties all of them together.
        plots[[0, 15, 85], 0] = 5
        order = np.argsort(family, kind="stable")
        family, score, plots = family[order], score[order], plots[order]
        absent = np.concatenate([absent, [0.0, 0.0]])
    found = global_hypotheses(family, score, plots, absent)
    share, total, best = np.zeros(len(score)), 0.0, (-np.inf, ())
    members = [[-1, *np.flatnonzero(family == f)] for f in range(3)]
    for chosen in product(*members):
        used = [(k, p) for b in chosen if b >= 0 for k, p in enumerate(plots[b]) if p >= 0]
        if len(set(used)) < len(used):
            continue
        value = sum(absent[f] if b < 0 else score[b] for f, b in enumerate(chosen))
        total += np.exp(value)
        best = max(best, (value, chosen))
        for b in chosen:
            if b >= 0:
                share[b] += np.exp(value)
    np.testing.assert_allclose(found.share[:15], share[:15] / total, atol=1e-12 if words == 1 else 1e-9)
    assert tuple(found.best[:3]) == best[1]


def test_too_many_sets_leave_the_likely_ones(monkeypatch):
    rng = np.random.default_rng(3)
    family = np.repeat(np.arange(6), 12)
    score, plots, absent = 3 * rng.normal(size=72), rng.integers(-1, 12, (72, 2)), np.full(6, -1.0)
    exact = global_hypotheses(family, score, plots, absent)
    monkeypatch.setattr("sigmax.tracking.global_hypotheses._MOST_SETS", 64)
    few = global_hypotheses(family, score, plots, absent)
    assert 0 < np.abs(few.share - exact.share).max() < 0.1
    used = plots[few.best[few.best >= 0]]
    assert all(len(set(c[c >= 0])) == (c >= 0).sum() for c in used.T)


@pytest.mark.parametrize("wait", [1, 2])
@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_enumeration_of_all_hypotheses(seed, wait):
    """Two tracks, Kalman filters by hand, every joint sequence kept until `wait` scans decide.

    A hypothesis says of each track that it never was a target (None), or which plots it had.
    """
    rng = np.random.default_rng(seed)
    mean = np.array([[0.0, -12.0, 10.0, 1.0], [0.0, 12.0, 10.0, -1.0]])
    prior = np.diag([25.0, 25.0, 4.0, 4.0])
    c, state = settled(mht(wait, 10**6, 1e6), mean, prior, existence := 0.6)
    F = np.eye(4)
    F[0, 2] = F[1, 3] = 2.0
    Q = 0.1 * np.kron(np.array([[8 / 3, 2.0], [2.0, 2.0]]), np.eye(2))
    H, R = np.eye(2, 4), NOISE**2 * np.eye(2)
    there, not_there = np.log(existence), np.log1p(-existence)
    grown = [
        (sum(there if a else not_there for a in alive), tuple(() if a else None for a in alive), mean, [prior] * 2)
        for alive in product((True, False), repeat=2)
    ]
    for k in range(1, 5):
        truth = np.array([[20.0 * k, -12 + 6 * k], [20.0 * k, 12 - 6 * k]])
        z = truth + NOISE * rng.standard_normal((2, 2))
        if rng.random() < 0.3:
            z = z[:1]
        turned = c.advance(state, Scan(2.0 * k, "", z[::-1]))[1]
        state, told = c.advance(state, Scan(2.0 * k, "", z))
        np.testing.assert_allclose(turned.mean, told.mean, atol=1e-9)
        older, grown = grown, []
        for score, past, m, P in older:
            m, P = m @ F.T, [F @ p @ F.T + Q for p in P]
            for event in product(*([None] if own is None else range(-1, len(z)) for own in past)):
                if event[0] is not None and event[0] == event[1] >= 0:
                    continue
                s, mm, PP = score, m.copy(), list(P)
                for i, j in enumerate(event):
                    if j is None or j < 0:
                        s += 0.0 if j is None else np.log(1 - PD * GATE)
                        continue
                    S = H @ P[i] @ H.T + R
                    v = z[j] - H @ m[i]
                    s += np.log(PD / CLUTTER) - 0.5 * (v @ np.linalg.solve(S, v) + np.log(np.linalg.det(2 * np.pi * S)))
                    K = P[i] @ H.T @ np.linalg.inv(S)
                    mm[i], PP[i] = m[i] + K @ v, P[i] - K @ S @ K.T
                paths = tuple(None if j is None else (*own, j) for own, j in zip(past, event, strict=True))
                grown.append((s, paths, mm, PP))
        weight = np.exp(np.array([h[0] for h in grown]) - max(h[0] for h in grown))
        best, stay = grown[int(weight.argmax())], np.ones(len(grown), bool)
        for i in range(2):
            # What stands for a track: its path in the best hypothesis, or else its likeliest.
            paths = {h[1][i]: 0.0 for h in grown if h[1][i] is not None}
            for w, h in zip(weight, grown, strict=True):
                if h[1][i] is not None:
                    paths[h[1][i]] += w
            stands = best[1][i] if best[1][i] is not None else max(paths, key=lambda p: paths[p])
            final = max(k - wait, 0)
            with_it = [h[1][i] is None or h[1][i][:final] == stands[:final] for h in grown]
            own = [(w, h) for w, h, ok in zip(weight, grown, with_it, strict=True) if ok and h[1][i] is not None]
            np.testing.assert_allclose(
                told.mean[i], sum(w * h[2][i] for w, h in own) / sum(w for w, _ in own), atol=1e-6
            )
            assert told.plot[i] == stands[-1]
            stay &= with_it
        grown = [h for h, ok in zip(grown, stay, strict=True) if ok]
