"""A sigma set as data: unit points and weights that replace N(0, I)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sigmax.dependence.line import grouped
from sigmax.errors import InputError


class SigmaSet(NamedTuple):
    """Points ξ and weights w with Σw = 1, Σwξ = 0, Σwξξᵀ = I, sorted for evaluation.

    Attributes:
        pairs: (k, n), one of each pair ±ξ of a symmetric set; k = 0 where the set is not symmetric.
        pair_weights: (k,), the weight of each of the two.
        singles: (s, n), all the points of a set that is not symmetric.
        single_weights: (s,).
        centre: weight of the point 0 in the mean of a symmetric set, None where it is not evaluated.
        centre_covariance: weight of the point 0 in covariances.
    """

    pairs: np.ndarray
    pair_weights: np.ndarray
    singles: np.ndarray
    single_weights: np.ndarray
    centre: float | None
    centre_covariance: float

    @property
    def dimension(self) -> int:
        """N."""
        return self.pairs.shape[1]

    @property
    def evaluations(self) -> int:
        """The number of points."""
        return 2 * len(self.pairs) + len(self.singles) + (self.centre is not None)

    @property
    def points(self) -> np.ndarray:
        """All points (evaluations, n): one of each pair, the other ones, the singles, the centre."""
        centre = np.zeros((int(self.centre is not None), self.dimension))
        return np.concatenate([self.pairs, -self.pairs, self.singles, centre])

    @property
    def counts(self) -> tuple[int, ...]:
        """How many different points there are by their first 0, 1, … n coordinates."""
        return tuple(len(first) for first in grouped(self.points).first)

    @property
    def weights(self) -> np.ndarray:
        """The weight of each point in the mean."""
        return np.concatenate([self.pair_weights, self.pair_weights, self.single_weights, [self.centre or 0.0]])[
            : self.evaluations
        ]

    @property
    def sizes(self) -> tuple[int, ...]:
        """The numbers of first coordinates by which the set can be projected without any change of the regression.

        There the other coordinates of points that fall together have the mean 0. All n of them always; any number in
        the sets here, but for the simplex of Moireau and Chapelle, which sees a correlation where there is none.
        """
        found = []
        for size in range(1, self.dimension + 1):
            where = grouped(self.points).where[size]
            rest = self.weights[:, None] * self.points[:, size:]
            sums = np.array([np.bincount(where, column) for column in rest.T])
            if not sums.size or np.abs(sums).max() < 1e-12:
                found.append(size)
        return tuple(found)

    @property
    def elements(self) -> tuple[int, ...]:
        """ξ (n,): how many different values each component takes where the factor is triangular.

        Belov et al., (7)-(9): 3, 5, … 2n − 1, 2n of the 2n points and 3, 5, … 2n + 1 of the 2n + 1; of the
        simplex 2, 3, … n + 1, or 3, 4, … n + 1, n + 1 as Moireau writes it ((8) and (9) corrected).
        """
        return self.counts[1:]

    def projected(self, size: int) -> "SigmaSet":
        """The set by its first coordinates alone, points that fall together being one: a set for N(0, I) again."""
        if size == self.dimension:
            return self
        points, (first, where) = self.points[:, :size], (g[size] for g in grouped(self.points))
        k = len(self.pairs)
        if not k:
            return self._replace(
                singles=points[first], single_weights=np.bincount(where, self.single_weights), pairs=points[:0]
            )
        middle = np.flatnonzero(~points.any(1))
        weights = np.concatenate([self.pair_weights, self.pair_weights])
        together = np.bincount(where[: 2 * k], weights)
        # Of each pair of points that are left, one; each of a pair has the weights of all that fell on it.
        kept = [i for i in first if i < 2 * k and i not in middle]
        halves = [i for i in kept if i < first[where[(i + k) % (2 * k)]]]
        at_centre = float(weights[middle[middle < 2 * k]].sum())
        centre, of_covariance = (self.centre or 0.0) + at_centre, self.centre_covariance + at_centre
        pair_weights = together[where[halves]]
        used = pair_weights != 0
        return SigmaSet(
            points[halves][used],
            pair_weights[used],
            points[:0],
            np.empty(0),
            None if centre == 0.0 and of_covariance == 0.0 else centre,
            of_covariance,
        )


def sigma_set(points: ArrayLike, weights: ArrayLike, centre_covariance: float | None = None) -> SigmaSet:
    """Check a set of unit points (N, n) with weights (N,) and sort it; points of weight 0 are left out.

    Args:
        points: unit points, one a row, for N(0, I).
        weights: their weights, negative ones allowed.
        centre_covariance: the weight of the point 0 in covariances, if it is not its weight in the mean.

    Raises:
        InputError: if the set does not reproduce mean 0 and covariance I to 1e-9, with what it gives.
    """
    xi = np.atleast_2d(np.asarray(points, float))
    w = np.asarray(weights, float)
    if w.shape != xi.shape[:1]:
        raise InputError(f"a sigma set needs one weight a point: {len(xi)} points, weights of shape {w.shape}")
    moments = {
        "sum of weights": (w.sum(), 1.0),
        "mean": (w @ xi, 0.0),
        "covariance": (np.einsum("i,ij,ik->jk", w, xi, xi), np.eye(xi.shape[1])),
    }
    for what, (have, want) in moments.items():
        if not np.allclose(np.asarray(have), np.asarray(want), atol=1e-9, rtol=0):
            raise InputError(
                f"a sigma set for N(0, I) must have {what} {np.asarray(want).tolist()}, "
                f"this one has {np.round(have, 9).tolist()}; scale its points or weights"
            )
    at_centre = (np.abs(xi) < 1e-14).all(1)
    centre = float(w[at_centre].sum()) if at_centre.any() else None
    pairs: list[np.ndarray] = []
    pair_weights: list[float] = []
    rest = list(np.flatnonzero(~at_centre))
    while rest:
        i = rest.pop(0)
        twin = next(
            (j for j in rest if np.allclose(xi[j], -xi[i], atol=1e-13) and np.isclose(w[j], w[i], rtol=1e-12)), None
        )
        if twin is None:
            pairs = []
            break
        rest.remove(twin)
        if w[i] != 0.0:
            pairs.append(xi[i])
            pair_weights.append(w[i])
    n = xi.shape[1]
    none = np.empty((0, n)), np.empty(0)
    if not pairs:
        if centre_covariance is not None:
            raise InputError("a weight of the centre in covariances needs a symmetric set")
        return SigmaSet(*none, xi[w != 0], w[w != 0], None, 0.0)
    for_covariance = (centre or 0.0) if centre_covariance is None else float(centre_covariance)
    if centre == 0.0 and for_covariance == 0.0:
        centre = None
    return SigmaSet(np.array(pairs), np.array(pair_weights), *none, centre, for_covariance)
