"""The libraries in the race, a module each, set up as their documentation says.

A module offers what its library can do: `batch(z)` for measurements (B, T, 3), `offline(z)` and
`live(z)` for one track (T, 3). Each gives entries that are ready to be called again and again.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from scenario import Estimate


class Entry(NamedTuple):
    """One line of a table.

    Attributes:
        name: library and filter.
        kind: entries of one kind compute the same answer: "EKF", "CKF" (which is the unscented filter with
            alpha 1, beta 0, kappa 0), or the name of a filter that has no like.
        gives: what a call returns.
        run: the call to be timed.
    """

    name: str
    kind: str
    gives: str
    run: Callable[[], Estimate]


def step_by_step(tracker: Any, z: np.ndarray) -> Estimate:
    """Predict and update with each measurement, as libraries do whose trackers hold x and P."""
    means, covs = [], []
    for measured in z:
        tracker.predict()
        tracker.update(measured)
        means.append(tracker.x)
        covs.append(tracker.P)
    return Estimate(np.array(means), np.array(covs))
