"""Targets that are longer than a point: where their own plots may lie."""

import numpy as np
from scipy.spatial import cKDTree

from sigmax.tracking.initiate import Layout

# A course counts as known where the speed is above 0 by so many standard deviations.
_CERTAIN = 2.0


def covered(
    place: np.ndarray, mean: np.ndarray, cov: np.ndarray, layout: Layout, along: float, across: float
) -> np.ndarray:
    """Which places (k, d) lie on one of the targets: within `along` of its middle on its course, `across` beside it.

    A ship and its wake are long on the course and narrow beside it, so that a boat that goes abreast is another
    target, and the far end of the ship is not. Of a target whose course is not known, a circle of the longer.

    Args:
        place: m (k, d).
        mean: states of the targets (B, n).
        cov: (B, n, n).
        layout: where position and velocity stand in the state.
        along: m, on the course, ahead and astern.
        across: m, beside it.
    """
    reach = max(along, across)
    if reach <= 0 or not len(mean) or not len(place):
        return np.zeros(len(place), bool)
    middle = mean[:, layout.position]
    near = cKDTree(middle).query_ball_point(place, reach)
    i = np.repeat(np.arange(len(place)), [len(some) for some in near])
    j = np.fromiter((k for some in near for k in some), int, len(i))
    speed, deviation = layout.speed(mean, cov)
    d = place[i] - middle[j]
    ahead = np.abs((d * layout.course(mean)[j]).sum(1))
    beside = np.sqrt(np.maximum((d**2).sum(1) - ahead**2, 0.0))
    unknown = speed[j] < _CERTAIN * deviation[j]
    on = np.zeros(len(place), bool)
    on[i[unknown | ((ahead <= along) & (beside <= across))]] = True
    return on
