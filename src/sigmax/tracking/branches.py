"""Multi-hypothesis tracking: each target is a family of branches, which differ in the plots of the last scans."""

from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.models.parts import made_once
from sigmax.tracking.associate import Evidence, existence_after
from sigmax.tracking.set_packing import best_packing


class Branches(NamedTuple):
    """What tells the branches (B,) of families apart; those of a family stand together.

    Attributes:
        score: log of how much likelier each is than the best of its family (B,).
        plots: the place of its plot in each of the last N scans, the latest first, -1 for none (B, N).
        parents: the place it, its parent, … came from in the scan before (B, N).
        best: whether it is the family's branch in the best global hypothesis (B,).
    """

    score: np.ndarray
    plots: np.ndarray
    parents: np.ndarray
    best: np.ndarray

    @classmethod
    def begun(cls, plot: np.ndarray, scans: int) -> "Branches":
        """Families that begin with a plot (F,) each."""
        plots = np.full((len(plot), scans), -1)
        plots[:, :1] = plot[:, None]
        return cls(np.zeros(len(plot)), plots, np.full((len(plot), scans), -1), np.ones(len(plot), bool))

    def without(self, plot: np.ndarray) -> np.ndarray:
        """Places of those that have not taken one of these plots of the last scan."""
        return np.flatnonzero(self.best | ~np.isin(self.plots[:, :1], plot).any(1))

    def take(self, index: np.ndarray) -> "Branches":
        """Some of the branches."""
        return Branches(*(a[index] for a in self))

    def joined(self, other: "Branches") -> "Branches":
        """These and others behind them."""
        return Branches(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class Children(NamedTuple):
    """The branches (C,) after a scan.

    Attributes:
        parent: the branch that each comes from (C,).
        pair: the place of its pair in the evidence, -1 for no plot (C,).
        existence: the probability that there is a target (C,).
        branches: what tells them apart.
    """

    parent: np.ndarray
    pair: np.ndarray
    existence: np.ndarray
    branches: Branches


class MultiHypothesis(NamedTuple):
    """What `mht` gives.

    Attributes:
        scans: after so many further scans a decision is final.
        branches: at most so many of one family.
        spread: log of how much less likely than the best of its family a branch may be.
    """

    scans: int
    branches: int
    spread: float

    def children(self, e: Evidence, family: np.ndarray, branches: Branches) -> Children:
        """All branches after a scan; `family` (B,) is 0 to F - 1, ascending.

        Each gives one child without a plot and one for each plot in its gate. The best global hypothesis takes one
        child of every family and no plot twice; those that differ from it more than `scans` scans ago are given up.
        """
        B, K = len(family), len(e.track)
        parent, pair = np.concatenate([np.arange(B), e.track]), np.concatenate([np.full(B, -1), np.arange(K)])
        log_ratio = np.concatenate([e.silence, e.ratio])
        score = branches.score[parent] + log_ratio
        # The quiet children of what was best share no plot: with them there is always an answer.
        quiet = (pair < 0) & branches.best[parent]
        kept = _likely(family[parent], score, quiet, self.branches, self.spread)
        parent, pair, log_ratio, score, quiet = (a[kept] for a in (parent, pair, log_ratio, score, quiet))
        group = family[parent]
        plot = np.full(len(pair), -1)
        plot[pair >= 0] = e.plot[pair[pair >= 0]]
        plots = np.concatenate([plot[:, None], branches.plots[parent]], axis=1)
        parents = np.concatenate([parent[:, None], branches.parents[parent]], axis=1)[:, : self.scans]
        places = best_packing(group, score, plots, np.flatnonzero(quiet))
        best = np.zeros(len(parent), bool)
        best[places] = True
        alive = parents[:, -1] == parents[places, -1][group] if self.scans else best
        top = np.full(len(places), -np.inf)
        np.maximum.at(top, group[alive], score[alive])
        children = Branches(score - top[group], plots[:, : self.scans], parents, best)
        existence = existence_after(log_ratio, e.existence[parent])
        return Children(parent[alive], pair[alive], existence[alive], children.take(alive))


@made_once
def mht(scans: int = 3, branches: int = 32, spread: float = 12.0) -> MultiHypothesis:
    """Decide which plot is whose after `scans` more scans (track-oriented MHT; Blackman and Popoli 1999, ch. 16).

    A track follows several sequences of plots, its branches; what is reported is the branch in the best global
    hypothesis, which takes one branch of every track and no plot twice. With `scans=0` it is `gnn`. Branches are
    scored as `gnn` scores pairs: by P_D p(z) / clutter, as if all targets existed.

    Cost: as GNN's for every branch, and an integer program for each cluster of tracks whose best branches share a
    plot.

    Args:
        scans: after so many further scans a decision is final.
        branches: at most so many of one track.
        spread: log of how much less likely than the best of its track a branch may be.

    Raises:
        InputError: for numbers that make no sense.
    """
    if scans < 0 or branches < 1 or not spread > 0:
        raise InputError(
            f"mht needs scans of at least 0, branches of at least 1 and a spread above 0; got {scans}, {branches} "
            f"and {spread}"
        )
    return MultiHypothesis(scans, branches, spread)


def _likely(family: np.ndarray, score: np.ndarray, needed: np.ndarray, most: int, spread: float) -> np.ndarray:
    """Places of the likeliest of each family, the likeliest first, and of those needed in any case."""
    order = np.lexsort((-score, family))
    first = np.searchsorted(family[order], family[order])
    within = score[order] >= score[order][first] - spread
    return order[(within & (np.arange(len(order)) - first < most)) | needed[order]]
