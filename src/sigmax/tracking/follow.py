"""Tracks and their plots after association: one belief for each track, or several branches."""

from typing import Any, NamedTuple

import numpy as np

from sigmax.tracking.associate import Associate, Evidence
from sigmax.tracking.branches import Branches, MultiHypothesis
from sigmax.tracking.gate import Pairs
from sigmax.tracking.life import Life
from sigmax.tracking.mixture import merged, summed
from sigmax.tracking.modes import Beliefs, Modes


class Followed(NamedTuple):
    """Tracks (B,) after the plots of a scan, or branches of tracks.

    Attributes:
        beliefs: what is known of each.
        life: the life of each.
        share: the probability of each pair (K,).
        plot: the plot that most likely belongs to each, -1 for none (B,).
        nis: of that plot (B,), NaN for none.
        branches: what tells branches apart; None for tracks without any.
        reported: index of those that are reported, one of each track.
        track: the place among the reported of each one's track.
        weight: the probability of each within its track (B,).
    """

    beliefs: Beliefs
    life: Life
    share: np.ndarray
    plot: np.ndarray
    nis: np.ndarray
    branches: Branches | None
    reported: Any
    track: Any
    weight: np.ndarray

    def estimates(self, modes: Modes, best: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means (T, n) and covariances (T, n, n) of tracks over their branches, and their modes (T, M)."""
        count = int(best.sum())
        mode = summed(self.weight[:, None] * self.beliefs.weight, self.track, count)
        if not count:
            return *modes.moments(self.beliefs), mode
        return *merged(*modes.moments(self.beliefs), self.weight, self.track, count, modes.model.angular), mode


def associated(
    modes: Modes,
    associate: Associate,
    time: float,
    beliefs: Beliefs,
    life: Life,
    pairs: Pairs,
    e: Evidence,
    chance: np.ndarray,
) -> Followed:
    """Each track after the plots that a rule gives it."""
    found = associate(e)
    hit, plot, nis = _best(pairs.track, pairs.plot, pairs.made.nis, found.share, len(life.id))
    return Followed(
        modes.update(beliefs, pairs.made, pairs.track, found.share),
        life.after_scan(time, hit, chance, found.existence),
        found.share,
        plot,
        nis,
        None,
        slice(None),
        slice(None),
        np.ones(len(life.id)),
    )


def branched(
    modes: Modes,
    mht: MultiHypothesis,
    time: float,
    beliefs: Beliefs,
    life: Life,
    pairs: Pairs,
    e: Evidence,
    chance: np.ndarray,
    branches: Branches,
) -> Followed:
    """The branches of each track after a scan."""
    family = np.unique(life.id, return_inverse=True)[1]
    made = mht.children(e, family, branches)
    seen = made.pair >= 0
    of = made.pair[seen]
    corrections = pairs.made.take(of)
    plot, nis = np.full(len(seen), -1), np.full(len(seen), np.nan)
    plot[seen], nis[seen] = pairs.plot[of], pairs.made.nis[of]
    return Followed(
        modes.update(beliefs.take(made.parent), corrections, np.flatnonzero(seen), np.ones(len(of))),
        life.take(made.parent).after_scan(time, made.hit, chance[made.parent], made.existence),
        made.share,
        plot,
        nis,
        made.branches,
        np.flatnonzero(made.branches.best),
        family[made.parent],
        made.weight,
    )


def _best(
    track: np.ndarray, plot: np.ndarray, nis: np.ndarray, share: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each track most likely had a plot, which, and its NIS."""
    order = np.argsort(share, kind="stable")
    best = np.full(count, -1)
    best[track[order]] = order
    hit = np.bincount(track, share, count) > 0.5
    place = np.where(hit, best, -1)
    chosen = place >= 0
    told_plot, told_nis = np.full(count, -1), np.full(count, np.nan)
    told_plot[chosen], told_nis[chosen] = plot[place[chosen]], nis[place[chosen]]
    return hit, told_plot, told_nis
