"""Which plots may belong to which tracks: a spatial index finds the near ones, the innovation's factor decides."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from sigmax.algebra.arrays import TWO_PI, wrapped
from sigmax.native.machine import cores
from sigmax.tracking.detector import Scan
from sigmax.tracking.modes import Beliefs, Corrections, Modes


class Pairs(NamedTuple):
    """Pairs of a track and a plot in its gate, ordered by track.

    Attributes:
        track: place of the track (K,).
        plot: place of the plot (K,).
        made: what the plot makes of the track's beliefs.
        expected: what the sensor should measure of each track (B, m), in its likeliest mode.
    """

    track: np.ndarray
    plot: np.ndarray
    made: Corrections
    expected: np.ndarray

    def log_likelihood(self, weight: np.ndarray) -> np.ndarray:
        """Of each plot (K,), over the modes with weights (B, M)."""
        with np.errstate(divide="ignore"):
            joint = np.log(weight[self.track]) + self.made.log_likelihood
        top = joint.max(1, initial=-1e300)
        return top + np.log(np.exp(joint - top[:, None]).sum(1))


def gated(modes: Modes, beliefs: Beliefs, scan: Scan, probability: float) -> Pairs:
    """All pairs within the gate that holds a target's plot with this probability, in any mode.

    Cost: n log n in tracks and plots, and one compiled correction a pair.
    """
    m = scan.z.shape[1]
    angular = modes.model.measured_angular(scan.sensor, m)
    centres, deviations = modes.expect(beliefs, scan.sensor, m, scan.u)
    likeliest = np.argmax(beliefs.weight, axis=1)
    expected = np.stack(centres)[likeliest, np.arange(len(likeliest))] if len(likeliest) else np.empty((0, m))
    # A gate of at most m components: the box of the widest.
    limit = _quantiles(probability, m)
    reach = np.sqrt(limit[m])
    found = [_near(c, reach * d, scan.z, angular) for c, d in zip(centres, deviations, strict=True)]
    codes = found[0] if len(found) == 1 else np.unique(np.concatenate(found))
    track, plot = np.divmod(codes, max(len(scan.z), 1))
    made = modes.correct(beliefs, track, scan.sensor, scan.z[plot], scan.u)
    # A correction that is not sound has no degrees of freedom, and no place in the gate.
    inside = (made.dof > 0) & (made.nis <= limit[made.dof])
    made = Corrections(
        tuple(r[inside] for r in made.rows), made.log_likelihood[inside], made.nis[inside], made.dof[inside]
    )
    return Pairs(track[inside], plot[inside], made, expected)


@cache
def _quantiles(probability: float, m: int) -> np.ndarray:
    """Of chi-square with 0, 1, … m degrees of freedom."""
    return np.array([0.0, *(chdtri(i + 1, 1 - probability) for i in range(m))])


def _near(centre: np.ndarray, half: np.ndarray, z: np.ndarray, angular: Sequence[bool]) -> np.ndarray:
    """Pairs whose difference lies within ± half (B, m), as track * plots + plot, sorted; NaN in z matches all."""
    sound = np.isfinite(centre).all(1) & np.isfinite(half).all(1)
    seen = ~np.isnan(z)
    codes = []
    patterns = np.ones((1, z.shape[1]), bool) if seen.all() else np.unique(seen, axis=0)
    for pattern in patterns:
        members = np.flatnonzero((seen == pattern).all(1))
        if pattern.any():
            tracks = np.flatnonzero(sound)
            args = centre[tracks][:, pattern], half[tracks][:, pattern], z[members][:, pattern]
            i, j = _box(*args, np.asarray(angular)[pattern])
            codes.append(tracks[i] * len(z) + members[j])
    return np.sort(np.concatenate(codes)) if codes else np.empty(0, int)


def _box(centre: np.ndarray, half: np.ndarray, z: np.ndarray, angular: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(centre) or not len(z):
        return np.empty(0, int), np.empty(0, int)
    # In units of the usual gate, where a box is nearly a cube.
    unit = np.maximum(np.median(half, axis=0), 1e-12)
    period = np.where(angular, TWO_PI / unit, 0.0)
    tree = cKDTree(_scaled(z, unit, period), boxsize=period if angular.any() else None)
    near = tree.query_ball_point(
        _scaled(centre, unit, period), (half / unit).max(1), p=np.inf, return_sorted=False, workers=cores()
    )
    count = np.fromiter(map(len, near), int, len(near))
    track = np.repeat(np.arange(len(centre)), count)
    plot = np.fromiter((j for some in near for j in some), int, int(count.sum()))
    inside = (np.abs(wrapped(z[plot] - centre[track], angular.tolist())) <= half[track]).all(1)
    return track[inside], plot[inside]


def _scaled(a: np.ndarray, unit: np.ndarray, period: np.ndarray) -> np.ndarray:
    scaled = a / unit
    turned = np.mod(scaled, np.where(period > 0, period, 1.0))
    # A number just below 0 may come out as the period itself, which the index does not take.
    return np.where(period > 0, np.where(turned >= period, 0.0, turned), scaled)
