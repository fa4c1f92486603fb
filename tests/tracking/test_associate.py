"""Association: exact where it says so, whatever the clusters."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sigmax.tracking.associate import Evidence, clusters, gnn, jpda, nearest, pda
from sigmax.tracking.joint import _exact, _propagated


def evidence(tracks, plots, seed, share=0.7):
    rng = np.random.default_rng(seed)
    track, plot = np.nonzero(rng.random((tracks, plots)) < share)
    silence = np.log1p(-rng.uniform(0.3, 0.95, tracks))
    return Evidence(track, plot, rng.normal(1, 3, len(track)), silence, rng.uniform(0.1, 1, tracks), plots)


def events(e, weights):
    """All joint events: which pair each track has, -1 for none, with their log weights."""
    T = len(e.silence)
    choices = [[-1, *np.flatnonzero(e.track == t)] for t in range(T)]
    for event in product(*choices):
        taken = [e.plot[k] for k in event if k >= 0]
        if len(set(taken)) == len(taken):
            yield event, sum(weights[k] for k in event if k >= 0)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 10**6))
def test_gnn_finds_the_likeliest_event(tracks, plots, seed):
    e = evidence(tracks, plots, seed)
    best = max(weight for _, weight in events(e, e.score))
    found = gnn(e).share
    assert set(np.unique(found)) <= {0.0, 1.0}
    assert (np.bincount(e.track, found, tracks) <= 1).all()
    assert (np.bincount(e.plot, found, plots) <= 1).all()
    assert found @ e.score == pytest.approx(best, abs=1e-9) if len(e.track) else best == 0


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 10**6))
def test_jpda_is_the_sum_over_joint_events(tracks, plots, seed):
    e = evidence(tracks, plots, seed)
    share, total = np.zeros(len(e.track)), 0.0
    for event, weight in events(e, e.gain):
        total += np.exp(weight)
        for k in event:
            if k >= 0:
                share[k] += np.exp(weight)
    np.testing.assert_allclose(jpda(e).share, share / total, atol=1e-10)


def test_tracks_alone_make_jpda_pda():
    e = evidence(5, 5, 1)
    alone = Evidence(e.track, e.track * 5 + e.plot, *e[2:5], 25)
    np.testing.assert_allclose(jpda(alone).share, pda(alone).share, atol=1e-12)
    np.testing.assert_allclose(jpda(alone).existence, pda(alone).existence, atol=1e-12)


def test_a_wide_cluster_is_close_to_exact():
    """Loopy belief propagation, which takes over where there are too many events, on a cluster that can be counted."""
    rng = np.random.default_rng(2)
    rows, columns = (a.ravel() for a in np.mgrid[:7, :7])
    gain = rng.normal(0, 1.5, 49)
    exact = _exact(rows, columns, gain)
    assert np.abs(_propagated(rows, columns, gain) - exact).max() < 0.12
    assert np.bincount(rows, exact).max() <= 1 + 1e-12
    assert _exact(*(a.ravel() for a in np.mgrid[:20, :20]), np.zeros(400)) is None


def test_a_track_in_doubt_still_takes_its_plot():
    """Its plot is 3 times as likely as clutter, its existence 0.1: a hard decision takes the target as given."""
    e = Evidence(np.array([0]), np.array([0]), np.log([3.0]), np.log([0.2]), np.array([0.1]), 1)
    assert e.gain[0] < 0 < e.score[0]
    assert gnn(e).share.tolist() == [1]
    assert gnn(e).existence[0] > 0.1


def test_nearest_may_share_a_plot_and_gnn_may_not():
    e = Evidence(np.array([0, 1, 1]), np.array([0, 0, 1]), np.array([5.0, 6.0, 4.0]), np.full(2, -1.0), np.ones(2), 2)
    assert nearest(e).share.tolist() == [1, 1, 0]
    assert gnn(e).share.tolist() == [1, 0, 1]


def test_existence_follows_bayes():
    """One track, one plot: r' = r L / (1 - r + r L), with L = 1 - P_D + P_D p / density (Musicki et al. 1994)."""
    e = Evidence(np.array([0]), np.array([0]), np.array([2.0]), np.log([0.2]), np.array([0.3]), 1)
    L = 0.2 + np.exp(2.0)
    assert pda(e).existence[0] == pytest.approx(0.3 * L / (0.7 + 0.3 * L))
    missed = e._replace(track=np.empty(0, int), plot=np.empty(0, int), ratio=np.empty(0))
    for rule in (pda, jpda, gnn, nearest):
        assert rule(missed).existence[0] == pytest.approx(0.3 * 0.2 / (0.7 + 0.3 * 0.2))


def test_clusters_hold_together_what_is_linked():
    track, plot = np.array([0, 1, 1, 2, 3]), np.array([0, 0, 1, 2, 2])
    found = sorted(sorted(c.tolist()) for c in clusters(track, plot, 4, 3))
    assert found == [[0, 1, 2], [3, 4]]
