"""Whether everybody computes the same thing: nobody is timed doing something else."""

from typing import NamedTuple

import numpy as np

from contenders import Entry
from scenario import COURSE, Estimate

# Largest difference of means and of covariances, in standard deviations, over all tracks and steps.
TOLERANCE = 1e-6
# Filters of different kinds agree in how far they are off, not in what they say.
RMSE_FACTOR = 1.25


class Answer(NamedTuple):
    """What one entry computed.

    Attributes:
        entry: who.
        rmse: root of the mean squared error of the position, metres.
        reference: the entry of its kind that it is compared with, itself where it is the first.
        apart: largest difference from it, in standard deviations.
        good: within the tolerances.
    """

    entry: Entry
    rmse: float
    reference: str
    apart: float
    good: bool


class Answers:
    """Compares entries on the same measurements with the first one of their kind.

    Args:
        truth: (..., T, 5).
    """

    def __init__(self, truth: np.ndarray) -> None:
        self.truth = truth
        self.seen: list[Answer] = []
        self._first: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}

    def look(self, entry: Entry, estimate: Estimate) -> None:
        """Take down what an entry computed, of all steps or of the last ones alone.

        Covariances may be missing, but not those of the first of a kind, which is to hand over all steps.
        """
        mean, cov = np.asarray(estimate.mean), None if estimate.cov is None else np.asarray(estimate.cov)
        steps = slice(-mean.shape[-2], None)
        truth = self.truth[..., steps, :]
        rmse = _position_rmse(mean, truth)
        if cov is not None:
            self._first.setdefault(entry.kind, (entry.name, mean, cov))
        name, at, spread = self._first[entry.kind]
        at, spread = at[..., steps, :], spread[..., steps, :, :]
        deviation = np.sqrt(np.einsum("...ii->...i", spread))
        gap = mean - at
        gap[..., COURSE] -= 2 * np.pi * np.round(gap[..., COURSE] / (2 * np.pi))
        apart = float(np.abs(gap / deviation).max())
        if cov is not None:
            for i in range(5):  # a row at a time: covariances of a large batch fill the memory as it is
                scale = deviation[..., i, None] * deviation
                apart = max(apart, float(np.abs((cov[..., i, :] - spread[..., i, :]) / scale).max()))
        usual = _position_rmse(next(iter(self._first.values()))[1][..., steps, :], truth)
        good = apart < TOLERANCE and usual / RMSE_FACTOR < rmse < usual * RMSE_FACTOR
        self.seen.append(Answer(entry, rmse, name, apart, good))


def _position_rmse(mean: np.ndarray, truth: np.ndarray) -> float:
    error = (mean - truth)[..., :2]
    return float(np.sqrt((error**2).sum(-1).mean()))
