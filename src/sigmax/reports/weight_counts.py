"""How much of its measurements a robust filter took, by sensor."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sigmax.records import Record
from sigmax.results.weighing import weights, whitened
from sigmax.running import Result

# What counts as taken by less than half.
_HALF = 0.5


class WeightCounts(NamedTuple):
    """The measurements of one sensor by the weight that they had; of the smallest weight of their components.

    Attributes:
        measurements: how many there were.
        lowered: how many had less than half of their weight, those refused left out.
        refused: how many were not used at all.
    """

    measurements: int
    lowered: int
    refused: int


def least_weights(record: Record, result: Result) -> dict[str, np.ndarray]:
    """By sensor that is weighed: the smallest weight of a measurement's components (B, T), NaN where there is none."""
    by_sensor = dict(result.layout.weights)
    if not any(by_sensor.values()):
        return {}
    found: Any = result.weight
    shown = found if result.layout.several else dict.fromkeys(by_sensor, found)
    return {
        sensor: np.where(record.real & ~np.isnan(w).all(-1), np.fmin.reduce(w, axis=-1), np.nan)
        for sensor, w in shown.items()
        if by_sensor[sensor] is not None
    }


def refused(least: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Steps (B, T) with a measurement that was not used at all, by `least_weights`; None where nothing is weighed."""
    return np.any([w == 0 for w in least.values()], axis=0) if least else None


def judged_nis(result: Result) -> np.ndarray:
    """NIS (B, T), where an update has a distribution of its own as the chi-square variable exceeded as seldom.

    A miss that Student's t expects once in a thousand measurements counts as a Gaussian miss of that kind.
    """
    by_sensor, nis = dict(result.layout.weights), np.asarray(result.nis)
    if not any(hasattr(weight, "chi_square") for weight in by_sensor.values()):
        return nis
    squares = np.zeros(nis.shape)
    for sensor, innovation in result.stored_innovations.items():
        e = np.moveaxis(whitened(innovation), -1, 0)
        own = getattr(by_sensor[sensor], "chi_square", None)
        # As in the NIS itself, what was refused does not count.
        unused = (weights(by_sensor[sensor], innovation) == 0).any(-1)
        squares += np.where(unused, 0, np.nansum(e * e, 0) if own is None else own(e))
    return np.where(np.isnan(nis), np.nan, squares)


def weight_counts(least: Mapping[str, np.ndarray]) -> dict[str, WeightCounts]:
    """Counts by sensor, by `least_weights`; of sensors whose update weighs nothing there are none."""
    return {
        sensor: WeightCounts(
            int(np.isfinite(w).sum()), int(((w > 0) & (w < _HALF)).sum()), int(np.count_nonzero(w == 0))
        )
        for sensor, w in least.items()
    }
