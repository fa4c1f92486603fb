"""Parameters by name, and the plain vectors in which they are searched for."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import finite, numbers, strings

Parameters = dict[str, Any]
# A number in a box is searched from so near its bounds on.
_INSIDE = 1e-3


@dataclass(frozen=True)
class Search:
    """Where parameters are searched: positive ones by their logarithm, those in a box by its logit.

    Attributes:
        shapes: of the parameters by name, in alphabetical order; p numbers in all.
        low: bounds (p,): 0 of positive ones, −∞ where there is none.
        high: the same from above.
    """

    shapes: tuple[tuple[str, tuple[int, ...]], ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """What each of the p numbers is called: "q", or "Q[0, 1]" in an array."""
        found = []
        for name, shape in self.shapes:
            places = [", ".join(map(str, at)) for at in np.ndindex(shape)]
            found += [name] if not shape else [f"{name}[{at}]" for at in places]
        return tuple(found)

    @property
    def size(self) -> int:
        """How many numbers there are, p."""
        return len(self.low)

    @property
    def logarithmic(self) -> np.ndarray:
        """Which are searched by their logarithm (p,)."""
        return (np.array(self.low) == 0) & np.isinf(self.high)

    @property
    def straight(self) -> np.ndarray:
        """Which are searched as they are (p,)."""
        return ~(self.logarithmic | self.boxed)

    @property
    def boxed(self) -> np.ndarray:
        """Which lie between two bounds (p,)."""
        return np.isfinite(self.low) & np.isfinite(self.high)

    def named(self, theta: Any) -> Parameters:
        """The parameters of a vector (p,), numbers or traced."""
        found, at = {}, 0
        for name, shape in self.shapes:
            size = int(np.prod(shape))
            found[name] = theta[at : at + size].reshape(shape)
            at += size
        return found

    def numbers(self, theta: np.ndarray) -> Parameters:
        """The same of numbers that are known, as arrays of JAX: to slice one would be compiled."""
        return {name: jnp.asarray(value) for name, value in self.named(theta).items()}

    def flat(self, named: Mapping[str, Any]) -> np.ndarray:
        """The vector (p,) of parameters."""
        return np.concatenate([np.zeros(0), *(np.ravel(np.asarray(named[name], float)) for name, _ in self.shapes)])

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """Where parameters (..., p) are searched."""
        y = np.array(theta, float)
        y[..., self.logarithmic] = np.log(y[..., self.logarithmic])
        low, high, at = self._box()
        share = np.clip((y[..., at] - low) / (high - low), _INSIDE, 1 - _INSIDE)
        y[..., at] = np.log(share / (1 - share))
        return y

    def outside(self, y: np.ndarray) -> np.ndarray:
        """The parameters (..., p) of what is searched."""
        theta = np.array(y, float)
        theta[..., self.logarithmic] = np.exp(theta[..., self.logarithmic])
        low, high, at = self._box()
        theta[..., at] = low + (high - low) / (1 + np.exp(-theta[..., at]))
        return theta

    def slope(self, y: np.ndarray) -> np.ndarray:
        """How fast the parameters change (p,) with what is searched."""
        theta = self.outside(y)
        found = np.ones(self.size)
        found[self.logarithmic] = theta[self.logarithmic]
        low, high, at = self._box()
        found[at] = (theta[at] - low) * (high - theta[at]) / (high - low)
        return found

    def unit(self, y: np.ndarray) -> np.ndarray:
        """What is about one of each (p,) as it is searched, at the start."""
        return np.where(~self.straight | (y == 0), 1.0, np.maximum(np.abs(y), 1e-3))

    def _box(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = self.boxed
        return np.array(self.low)[at], np.array(self.high)[at], at


def search_of(
    start: Mapping[str, Any], positive: Collection[str], bounds: Mapping[str, Any]
) -> tuple[Search, np.ndarray]:
    """Where to search, and the start (p,) as numbers.

    Raises:
        InputError: for what names no parameter, no number, or a start that is not within.
    """
    values = {name: np.asarray(numbers(name, start[name]), float) for name in sorted(start)}
    for name, value in values.items():
        finite(f"{name} at the start", value)
    above = frozenset(strings("positive", positive, ordered=False))
    if not isinstance(bounds, Mapping):
        raise InputError(f"bounds must be pairs by name, such as {{'alpha': (0.1, 1.0)}}; it is {bounds!r}")
    for name in (*above, *bounds):
        if name not in values:
            raise unknown("parameter", name, values)
    low, high = [], []
    for name, value in values.items():
        least, most = _bounds(name, bounds[name]) if name in bounds else (0.0 if name in above else -np.inf, np.inf)
        if name in above and name not in bounds and not (value > 0).all():
            raise InputError(f"{name} is to stay positive and starts at {value}")
        if name in bounds and not ((value >= least) & (value <= most)).all():
            raise InputError(f"{name} is to stay between {least:g} and {most:g} and starts at {value}")
        low += [least] * value.size
        high += [most] * value.size
    search = Search(tuple((name, value.shape) for name, value in values.items()), tuple(low), tuple(high))
    return search, search.flat(values)


def _bounds(name: str, given: Any) -> tuple[float, float]:
    pair = np.ravel(numbers(f"bounds of {name}", given)).astype(float)
    if pair.size != 2 or not np.isfinite(pair).all() or not pair[0] < pair[1]:
        raise InputError(f"bounds of {name} must be two numbers, the smaller first; it is {given!r}")
    return float(pair[0]), float(pair[1])
