"""What a filter tells of each component, of the state and of the bias."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sigmax.records import Record
from sigmax.records.units import Dimension
from sigmax.running import Result


class Told(NamedTuple):
    """One component over all tracks.

    Attributes:
        name: of the component.
        dimension: of it.
        mean: (B, T).
        deviation: (B, T).
        truth: (B, T), NaN where it is not known, as for a bias.
        error: (B, T), mean − truth.
        angular: whether it is an angle that turns.
    """

    name: str
    dimension: Dimension
    mean: np.ndarray
    deviation: np.ndarray
    truth: np.ndarray
    error: np.ndarray
    angular: bool


def told(record: Record, result: Result) -> Iterator[Told]:
    """The components of the state, and behind them those of the bias."""
    n, unknown = record.model.size, np.full(record.time.shape, np.nan)
    mean, deviation, error = result.mean, result.std, result.errors(record.truth)
    for i, (name, dimension) in enumerate(record.components.items()):
        if i < n:
            own = (mean[..., i], deviation[..., i], record.truth[..., i], error[..., i], record.model.angular[i])
        else:
            own = (result.bias_mean[..., i - n], result.bias_std[..., i - n], unknown, unknown, False)
        yield Told(str(name), dimension, *own)
