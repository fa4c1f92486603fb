"""Which plot belongs to which track: rules that give each pair its probability."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, min_weight_full_bipartite_matching

from sigmax.tracking.joint import marginals
from sigmax.tracking.mixture import summed


class Evidence(NamedTuple):
    """What speaks for each pair.

    Attributes:
        track: place of the track (K,), ascending.
        plot: place of the plot (K,).
        ratio: log of P_D p(plot | track) / density of clutter (K,).
        silence: log of 1 - P_D P_G (B,): the track's ratio without any plot.
        existence: the probability that there is a target (B,).
        plots: how many plots there are.
    """

    track: np.ndarray
    plot: np.ndarray
    ratio: np.ndarray
    silence: np.ndarray
    existence: np.ndarray
    plots: int

    @property
    def score(self) -> np.ndarray:
        """Log of how much likelier each pair is than that the track, if there is a target, has no plot (K,)."""
        return self.ratio - self.silence[self.track]

    @property
    def gain(self) -> np.ndarray:
        """Log of how much likelier each pair is than that the track has no plot (K,)."""
        quiet = np.log1p(self.existence * np.expm1(self.silence))
        with np.errstate(divide="ignore"):
            return self.ratio + np.log(self.existence[self.track]) - quiet[self.track]


class Association(NamedTuple):
    """Probabilities of pairs (K,), and of the existence of each track (B,) afterwards."""

    share: np.ndarray
    existence: np.ndarray


Associate = Callable[[Evidence], Association]


def nearest(e: Evidence) -> Association:
    """Each track takes its likeliest plot, whoever else takes it too (nearest neighbour)."""
    order = np.lexsort((-e.ratio, e.track))
    first = np.ones(len(order), bool)
    first[1:] = e.track[order][1:] != e.track[order][:-1]
    return _hard(e, order[first])


def gnn(e: Evidence) -> Association:
    """The likeliest assignment of plots to tracks, one to one (global nearest neighbour).

    Solved exactly as a sparse assignment in which each track may also stay without a plot; pairs of which
    neither the track nor the plot has another choice are taken directly. Weighed as if all targets existed: a track
    that is in doubt would else lose the plots that could confirm it.
    """
    gain = e.score
    worth = gain > 0
    places = np.flatnonzero(worth)
    track, plot = e.track[places], e.plot[places]
    alone = (np.bincount(track, minlength=len(e.silence))[track] == 1) & (
        np.bincount(plot, minlength=e.plots)[plot] == 1
    )
    rest = places[~alone]
    chosen = [places[alone]]
    if len(rest):
        tracks, row = np.unique(e.track[rest], return_inverse=True)
        plots, column = np.unique(e.plot[rest], return_inverse=True)
        T, P = len(tracks), len(plots)
        # Costs have to be above 0: an entry of 0 is no entry.
        top = gain[rest].max() + 1
        cost = np.concatenate([top - gain[rest], np.full(T, top)])
        rows, columns = np.concatenate([row, np.arange(T)]), np.concatenate([column, P + np.arange(T)])
        i, j = min_weight_full_bipartite_matching(csr_array((cost, (rows, columns)), shape=(T, P + T)))
        taken = np.full(T, -1)
        taken[i] = j
        chosen.append(rest[taken[row] == column])
    return _hard(e, np.concatenate(chosen))


def pda(e: Evidence) -> Association:
    """Each track takes all plots of its gate by their probability, alone (Bar-Shalom and Tse 1975).

    With existence, integrated PDA (Musicki, Evans and Stankovic 1994).
    """
    odds = np.exp(np.minimum(e.gain, 600.0))
    return _soft(e, odds / (1 + np.bincount(e.track, odds, len(e.silence)))[e.track])


def jpda(e: Evidence) -> Association:
    """As `pda`, but a plot belongs to at most one track: all joint events of each cluster are weighed.

    (Fortmann, Bar-Shalom and Scheffe 1983; with existence, Musicki and Evans 2004.) Exact; a cluster with too many
    joint events to count is approximated by loopy belief propagation (Williams and Lau 2014).
    """
    gain = e.gain
    odds = np.exp(np.minimum(gain, 600.0))
    share = odds / (1 + np.bincount(e.track, odds, len(e.silence)))[e.track]
    # Tracks that share no plot are done; the others go cluster by cluster.
    shared = np.bincount(e.plot, minlength=e.plots)[e.plot] > 1
    joint = np.flatnonzero(np.bincount(e.track, shared, len(e.silence))[e.track] > 0)
    for members in clusters(e.track[joint], e.plot[joint], len(e.silence), e.plots):
        places = joint[members]
        share[places] = marginals(e.track[places], e.plot[places], gain[places])
    return _soft(e, share)


def clusters(track: np.ndarray, plot: np.ndarray, tracks: int, plots: int) -> list[np.ndarray]:
    """Places of pairs that are linked by common tracks or plots, cluster by cluster."""
    if not len(track):
        return []
    graph = coo_array((np.ones(len(track)), (track, tracks + plot)), shape=(tracks + plots,) * 2)
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label[track], kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[track][order])) + 1)


def _hard(e: Evidence, chosen: np.ndarray) -> Association:
    share = np.zeros(len(e.track))
    share[chosen] = 1.0
    log_ratio = e.silence.copy()
    log_ratio[e.track[chosen]] = e.ratio[chosen]
    return Association(share, existence_after(log_ratio, e.existence))


def existence_after(log_ratio: np.ndarray, existence: np.ndarray) -> np.ndarray:
    """The probability that there is a target, after what is so many times likelier if there is (Bayes)."""
    with np.errstate(divide="ignore", over="ignore"):
        return 1 / (1 + np.exp(-log_ratio) * (1 - existence) / existence)


def _soft(e: Evidence, share: np.ndarray) -> Association:
    """Existence from the shares: certain with a plot, less likely than before without one."""
    hit = np.clip(summed(share, e.track, len(e.silence)), 0, 1)
    quiet = np.exp(e.silence)
    without = e.existence * quiet / (1 - e.existence * (1 - quiet))
    return Association(share, hit + (1 - hit) * without)
