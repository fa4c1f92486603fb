"""What a filter tells of each component, of the state and of the bias."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sigmax.files.units import Dimension
from sigmax.records import Record
from sigmax.running import Result
from sigmax.spaces import Space, in_world_axes, readable


class ComponentEstimate(NamedTuple):
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


def component_estimates(record: Record, result: Result) -> Iterator[ComponentEstimate]:
    """The components of the state, and behind them those of the bias."""
    space, unknown = record.model.space, np.full(record.time.shape, np.nan)
    n, mean, truth = space.dim, readable(space, result.mean), readable(space, record.truth)
    S = in_world_axes(space, np.asarray(result.mean), _factor(result))
    deviation, error = np.sqrt((S * S).sum(-1)), np.array(result.errors(record.truth))
    for part, _, to in space.parts():
        if not part.flat:
            # What turns is compared by turning, what lies in the world by its distance there.
            moved = slice(to.start + part.turns, to.stop)
            error[..., moved] = (mean - truth)[..., moved]
    turning = _turning(space)
    for i, (name, dimension) in enumerate(record.components.items()):
        if i < n:
            own = (mean[..., i], deviation[..., i], truth[..., i], error[..., i], turning[i])
        else:
            own = (result.bias_mean[..., i - n], result.bias_std[..., i - n], unknown, unknown, False)
        yield ComponentEstimate(str(name), dimension, *own)


def row_of(record: Record, place: int) -> int:
    """Which component a number of the state is, of those of `component_estimates`."""
    return list(record.model.deviations).index(record.model.state[place])


def _factor(result: Result) -> np.ndarray:
    """The rows of the factor that belong to the state."""
    return np.asarray(result.kept()[1])[..., result.layout.deviations[0], :]


def _turning(space: Space) -> list[bool]:
    found = [False] * space.dim
    for part, _, to in space.parts():
        for k in range(part.dim):
            found[to.start + k] = part.periodic[k] if part.flat else k < part.turns
    return found
