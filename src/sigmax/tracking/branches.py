"""Multi-hypothesis tracking: each target is a family of branches, which differ in the plots of the last scans."""

from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.parts import made_once
from sigmax.tracking.associate import Evidence, existence_after
from sigmax.tracking.global_hypotheses import global_hypotheses

# A track is never less probable to be a target than e to the minus this: what was not seen for long may come back.
_DOUBT = 20.0


class Branches(NamedTuple):
    """What tells the branches (B,) of families apart; those of a family stand together.

    Attributes:
        score: log of how much likelier each is than the likeliest of its family (B,).
        absent: the same of its family's never having been a target (B,).
        plots: the place of its plot in each of the last N scans, the latest first, -1 for none (B, N).
        parents: the place it, its parent, … came from in the scan before (B, N).
        best: whether it is its family's in the likeliest global hypothesis (B,).
    """

    score: np.ndarray
    absent: np.ndarray
    plots: np.ndarray
    parents: np.ndarray
    best: np.ndarray

    @classmethod
    def begun(cls, plot: np.ndarray, scans: int, existence: float) -> "Branches":
        """Families that begin with a plot (F,) each, and are targets with this probability."""
        plots = np.full((len(plot), scans), -1)
        plots[:, :1] = plot[:, None]
        absent = np.full(len(plot), np.log1p(-existence) - np.log(existence))
        return cls(np.zeros(len(plot)), absent, plots, np.full((len(plot), scans), -1), np.ones(len(plot), bool))

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
        hit: whether it has a plot, and its family is likelier a target than not (C,).
        existence: the probability that there is a target (C,).
        weight: the probability of each, if its family is a target (C,).
        branches: what tells them apart.
        share: the probability of each pair of the evidence (K,).
    """

    parent: np.ndarray
    pair: np.ndarray
    hit: np.ndarray
    existence: np.ndarray
    weight: np.ndarray
    branches: Branches
    share: np.ndarray


class MultiHypothesis(NamedTuple):
    """What `mht` gives.

    Attributes:
        scans: after so many further scans a decision is final.
        branches: at most so many of one family.
        spread: log of how much less probable than the likeliest of its family a branch may be.
    """

    scans: int
    branches: int
    spread: float

    def children(self, e: Evidence, family: np.ndarray, branches: Branches) -> Children:
        """All branches after a scan; `family` (B,) is 0 to F - 1, ascending.

        Each gives one child without a plot and one for each plot in its gate. The likeliest global hypothesis takes
        one child of every target and no plot twice; those that differ from it more than `scans` scans ago are given
        up, and those of little probability over all global hypotheses.
        """
        B, K = len(family), len(e.track)
        parent, pair = np.concatenate([np.arange(B), e.track]), np.concatenate([np.full(B, -1), np.arange(K)])
        order = np.argsort(family[parent], kind="stable")
        parent, pair, log_ratio = parent[order], pair[order], np.concatenate([e.silence, e.ratio])[order]
        score = branches.score[parent] + log_ratio
        group = family[parent]
        first = np.searchsorted(group, np.arange(family.max(initial=-1) + 1))
        plot = np.full(len(pair), -1)
        plot[pair >= 0] = e.plot[pair[pair >= 0]]
        plots = np.concatenate([plot[:, None], branches.plots[parent]], axis=1)
        parents = np.concatenate([parent[:, None], branches.parents[parent]], axis=1)[:, : self.scans]
        absent = branches.absent[parent[first]]
        share, places = global_hypotheses(group, score, plots, absent)
        # Of a family that is likelier no target, the likeliest branch stands for it until it ends.
        places = np.where(places < 0, np.lexsort((-share, group))[first], places)
        best = np.zeros(len(parent), bool)
        best[places] = True
        alive = parents[:, -1] == parents[places, -1][group] if self.scans else best
        kept = _likely(group, np.where(alive, share, 0.0), best, self.branches, np.exp(-self.spread))
        hit = (pair >= 0) & (np.bincount(group, share) > 0.5)[group]
        given = np.bincount(pair[pair >= 0], share[pair >= 0], K)
        parent, pair, hit, log_ratio, score, group, share, best = (
            a[kept] for a in (parent, pair, hit, log_ratio, score, group, share, best)
        )
        total = np.bincount(group, share)[group]
        weight = np.divide(share, total, out=best.astype(float), where=total > 0)
        top = np.full(len(first), -np.inf)
        np.maximum.at(top, group, score)
        return Children(
            parent,
            pair,
            hit,
            existence_after(log_ratio, e.existence[parent]),
            weight,
            Branches(
                score - top[group],
                np.minimum(absent - top, _DOUBT)[group],
                plots[kept, : self.scans],
                parents[kept],
                best,
            ),
            given,
        )


@made_once
def mht(scans: int = 3, branches: int = 32, spread: float = 12.0) -> MultiHypothesis:
    """Decide which plot is whose after `scans` more scans (track-oriented MHT; Blackman and Popoli 1999, ch. 16).

    A track follows several sequences of plots, its branches. A global hypothesis takes at most one branch of every
    track and no plot twice; a track of which it takes none was never a target. Branches are scored by P_D p(z) /
    clutter, and by how surely a new track is a target. All global hypotheses are summed up: what is reported of a
    track is the mean of its branches by their probabilities, and its plot in the likeliest global hypothesis.

    Cost: as JPDA's for every branch.

    Args:
        scans: after so many further scans a decision is final.
        branches: at most so many of one track.
        spread: log of how much less probable than the likeliest of its track a branch may be.

    Raises:
        InputError: for numbers that make no sense.
    """
    if scans < 0 or branches < 1 or not spread > 0:
        raise InputError(
            f"mht needs scans of at least 0, branches of at least 1 and a spread above 0; got {scans}, {branches} "
            f"and {spread}"
        )
    return MultiHypothesis(scans, branches, spread)


def _likely(family: np.ndarray, share: np.ndarray, best: np.ndarray, most: int, least: float) -> np.ndarray:
    """Places of the likeliest of each family, the likeliest first, and of the best in any case."""
    order = np.lexsort((-share, family))
    first = np.searchsorted(family[order], family[order])
    within = (share[order] > 0) & (share[order] >= share[order][first] * least)
    return order[(within & (np.arange(len(order)) - first < most)) | best[order]]
