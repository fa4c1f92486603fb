"""The life of tracks: from tentative to confirmed, coasting, and the end."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sigmax.errors import InputError
from sigmax.modelling.parts import made_once
from sigmax.tracking.modes import Beliefs

_REMEMBERED = 64


class Life(NamedTuple):
    """What is known of the life of B tracks.

    Attributes:
        id: a number that is never given again (B,).
        born: time of the first plot (B,).
        heard: time of the last plot (B,).
        existence: the probability that there is a target (B,).
        confirmed: whether it has been confirmed (B,).
        history: bit k tells whether the scan k chances ago brought a plot (B,).
        chances: scans that should have seen it (B,).
        origin: where it was first estimated to be (B, d).
    """

    id: np.ndarray
    born: np.ndarray
    heard: np.ndarray
    existence: np.ndarray
    confirmed: np.ndarray
    history: np.ndarray
    chances: np.ndarray
    origin: np.ndarray

    @classmethod
    def begun(cls, first_id: int, origin: np.ndarray, time: float, existence: float, hits: int) -> "Life":
        """The life of tracks that begin at positions (B, d) with so many plots each."""
        count = len(origin)
        return cls(
            np.arange(first_id, first_id + count),
            np.full(count, time),
            np.full(count, time),
            np.full(count, existence),
            np.zeros(count, bool),
            np.full(count, (1 << hits) - 1, np.uint64),
            np.full(count, hits),
            origin,
        )

    def take(self, index: np.ndarray) -> "Life":
        """Some of the tracks."""
        return Life(*(a[index] for a in self))

    def joined(self, other: "Life") -> "Life":
        """These tracks and others behind them."""
        return Life(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def after_scan(self, time: float, hit: np.ndarray, chance: np.ndarray, existence: np.ndarray) -> "Life":
        """After a scan that brought plots (`hit`), or should have (`chance`)."""
        shifted = (self.history << np.uint64(1)) | hit.astype(np.uint64)
        return self._replace(
            heard=np.where(hit, time, self.heard),
            existence=np.clip(existence, 1e-9, 1 - 1e-9),
            history=np.where(chance | hit, shifted, self.history),
            chances=self.chances + (chance | hit),
        )

    def hits(self, last: int) -> np.ndarray:
        """How many of the last scans brought a plot (B,)."""
        return np.bitwise_count(self.history & np.uint64((1 << min(last, _REMEMBERED)) - 1))


# time, lives -> which are confirmed now, which end now
Rule = Callable[[float, Life], tuple[np.ndarray, np.ndarray]]


@made_once
def m_of_n(m: int = 3, n: int = 5, misses: int = 5, coast: float = np.inf) -> Rule:
    """Confirm with `m` plots in the first `n` chances or later; end a tentative track that cannot get there.

    Args:
        m: plots.
        n: of so many chances, at most 64.
        misses: a confirmed track ends after so many chances without a plot on end.
        coast: a track ends after so many seconds without a plot.

    Raises:
        InputError: for counts that make no sense.
    """
    if not 0 < m <= n <= _REMEMBERED or not 0 < misses <= _REMEMBERED:
        raise InputError(
            f"m of n needs 0 < m ≤ n ≤ {_REMEMBERED} and 0 < misses ≤ {_REMEMBERED}; got {m}, {n}, {misses}"
        )

    def rule(time: float, life: Life) -> tuple[np.ndarray, np.ndarray]:
        enough = life.hits(n) >= m
        hopeless = ~life.confirmed & (life.chances >= n) & ~enough
        silent = life.confirmed & (life.chances >= misses) & (life.hits(misses) == 0)
        return enough, hopeless | silent | (time - life.heard > coast)

    return rule


@made_once
def by_existence(
    confirm: float = 0.99,
    drop: float = 0.01,
    plots: int = 2,
    coast: float = np.inf,
    tentative: float = np.inf,
    age: float = 0.0,
) -> Rule:
    """Confirm and end by the probability of existence (Musicki, Evans and Stankovic 1994).

    Args:
        confirm: a track of this probability is confirmed,
        plots: once it has had so many plots, the first included.
        drop: below this one it ends.
        coast: seconds without a plot after which a confirmed track ends in any case.
        tentative: the same for one that is not confirmed.
        age: seconds since its first plot before which no track is confirmed: false plots of a fast sensor come back
            for a moment, and many of them within a second say little more than one.

    Raises:
        InputError: for what are no probabilities in order.
    """
    if not 0 < drop < confirm < 1:
        raise InputError(f"existence needs 0 < drop < confirm < 1; got drop {drop} and confirm {confirm}")

    def rule(time: float, life: Life) -> tuple[np.ndarray, np.ndarray]:
        patience = np.where(life.confirmed, coast, tentative)
        enough = (life.existence >= confirm) & (life.hits(_REMEMBERED) >= plots) & (time - life.born >= age)
        return enough, (life.existence < drop) | (time - life.heard > patience)

    return rule


def duplicates(mean: np.ndarray, cov: np.ndarray, position: tuple[int, ...], life: Life, nearer: float) -> np.ndarray:
    """Which tracks (B,) repeat an older or confirmed one.

    The difference of two states, by their covariances, is below `nearer`² for the whole state: the same target
    would give a value about its size, for independent errors; for two tracks fed by the same plots much less.
    """
    again = np.zeros(len(mean), bool)
    place = mean[:, position]
    if len(mean) < 2 or nearer <= 0:
        return again
    reach = nearer * np.sqrt(2 * np.median(cov[:, position, position].sum(1)))
    for i, j in cKDTree(place).query_pairs(reach, output_type="ndarray"):
        d = mean[i] - mean[j]
        if d @ np.linalg.solve(cov[i] + cov[j], d) < nearer**2:
            weaker = i if (life.confirmed[i], -life.id[i]) < (life.confirmed[j], -life.id[j]) else j
            again[weaker] = True
    return again


def none(d: int) -> Life:
    """No tracks in d dimensions."""
    return Life.begun(0, np.empty((0, d)), 0.0, 0.0, 0)


def later(life: Life, dt: float, lifetime: float) -> Life:
    """Dt seconds later, targets staying for `lifetime` seconds on average."""
    return life._replace(existence=life.existence * np.exp(-dt / lifetime))


class Tracks(NamedTuple):
    """All tracks at one time.

    Attributes:
        time: seconds; None before the first scan.
        beliefs: what is known of each.
        life: the life of each.
    """

    time: float | None
    beliefs: Beliefs
    life: Life
