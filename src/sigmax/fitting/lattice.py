"""Numbers of the filter itself, such as the spread of its points: each value is a filter of its own, compiled.

They are tried on a lattice between their bounds, the other parameters fitted at each place, and then between the best
three places; values have three digits, so that what was compiled for one is found again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.fitting.likelihood import Data, Likelihoods
from sigmax.fitting.maximum import Summit, climb
from sigmax.fitting.parametric_model import Build
from sigmax.fitting.search import Parameters, Search
from sigmax.modelling.checks import numbers

# Places of the lattice, refinements, and sweeps where there are several numbers.
_PLACES, _REFINED, _SWEEPS = 7, 6, 2
# Bounds so far apart are parted by their logarithms.
_LOGARITHMIC = 8.0
# A lattice on which less is lost says nothing; a parabola is laid through places that lose less than the other.
_TOLD, _NEAR = 0.5, 6.0
# Where the best and its neighbours differ by less, it is found; how far into a half the search goes.
_FINE, _GOLDEN = 0.25, 0.382


class Tried(NamedTuple):
    """One filter, and the other parameters at their best with it."""

    likelihoods: Likelihoods
    summit: Summit


@dataclass
class Lattice:
    """The search over numbers of the filter.

    Attributes:
        make: parameters by name -> filter.
        records: the records.
        search: of the other parameters.
        begin: where these start.
        bounds: of the filter's, by name.
        progress: is told of each filter.
    """

    make: Callable[[Parameters], Filter]
    records: list[Data]
    search: Search
    begin: np.ndarray
    bounds: Mapping[str, tuple[float, float]]
    progress: Callable[[str], object] | None
    tried: dict[tuple[float, ...], Tried] = field(default_factory=dict)
    evaluations: int = 0

    def best(self, start: Sequence[float]) -> tuple[float, ...]:
        """The values (k,) of greatest likelihood, in the order of the bounds."""
        at = tuple(map(float, start))
        self.value(at)
        for _ in range(_SWEEPS if len(at) > 1 else 1):
            for i in range(len(at)):
                at = self._best_along(at, i)
        return at

    def value(self, at: tuple[float, ...]) -> float:
        """The log-likelihood with these values, all else at its best."""
        if at not in self.tried:
            if self.progress is not None:
                said = ", ".join(f"{name} = {v:g}" for name, v in zip(self.bounds, at, strict=True))
                self.progress(f"filter with {said}")
            known = max(self.tried.values(), key=lambda t: t.summit.value, default=None)
            self.tried[at] = self._fitted(at, None if known is None else known.summit.y)
        return self.tried[at].summit.value

    def along(self, at: tuple[float, ...], i: int) -> tuple[np.ndarray, np.ndarray]:
        """Values of the i-th number that were tried with the others as in `at`, and the log-likelihoods."""
        some = sorted(t[i] for t in self.tried if t[:i] + t[i + 1 :] == at[:i] + at[i + 1 :])
        return np.array(some), np.array([self.value((*at[:i], v, *at[i + 1 :])) for v in some])

    def spread(self, at: tuple[float, ...], i: int) -> tuple[float, np.ndarray]:
        """Standard error of the i-th number by a parabola, and how fast what is searched goes with it."""
        values, at_values = self.along(at, i)
        lost = at_values.max() - at_values
        near = np.argsort(np.abs(values - at[i]))
        near = near[lost[near] < _NEAR][:5]
        none = np.zeros(self.search.size)
        if len(near) < 3:
            return float("nan"), none
        curvature = 2 * np.polyfit(values[near] - at[i], lost[near], 2)[0]
        if not curvature > 0 or (lost[np.isfinite(lost)] < _TOLD).all():
            return float("nan"), none
        ys = [self.tried[(*at[:i], values[j], *at[i + 1 :])].summit.y for j in near]
        slope = np.polyfit(values[near] - at[i], np.array(ys), 1)[0] if self.search.size else none
        return float(1 / np.sqrt(curvature)), slope

    def untold(self, at: tuple[float, ...], i: int) -> str:
        """Why the i-th number is not determined, in words; empty where it is."""
        name, (low, high) = list(self.bounds.items())[i]
        values, at_values = self.along(at, i)
        if at[i] in (low, high):
            return f"{name} runs into its bound {at[i]:g}"
        if np.nanmin(at_values) > at_values.max() - _TOLD:
            return f"the record says nothing of {name}: from {values[0]:g} to {values[-1]:g}"
        return "" if np.isfinite(self.spread(at, i)[0]) else f"of {name} the likelihood is too rough to tell"

    def likelihoods(self, at: tuple[float, ...]) -> Likelihoods:
        """With one filter."""
        known = dict(zip(self.bounds, at, strict=True))
        filter = filter_of(self.make, {**self.search.named(self.begin), **known})
        records = [d._replace(build=_with(d.build, tuple(known.items()))) for d in self.records]
        return Likelihoods(filter, records, self.search, self.begin)

    def _fitted(self, at: tuple[float, ...], near: np.ndarray | None) -> Tried:
        likelihoods = self.likelihoods(at)
        y = self.search.inside(self.begin)
        start = y if near is None else near
        if near is not None and not np.isfinite(likelihoods.inside()(near[None]))[0]:
            start = y
        if not np.isfinite(likelihoods.inside()(start[None]))[0]:
            p = self.search.size
            summit = Summit(y, -np.inf, np.zeros(p), np.zeros((p, p)), np.ones(p), False, "no filter runs there", 0)
        else:
            summit = climb(likelihoods.inside(), start, self.search.unit(y), self.search.straight)
        self.evaluations += likelihoods.evaluations
        return Tried(likelihoods, summit)

    def _best_along(self, at: tuple[float, ...], i: int) -> tuple[float, ...]:
        low, high = list(self.bounds.values())[i]
        bent = low > 0 and high / low > _LOGARITHMIC
        spaced = np.geomspace if bent else np.linspace

        def put(v: float) -> tuple[float, ...]:
            return (*at[:i], _rounded(v), *at[i + 1 :])

        for v in spaced(low, high, _PLACES):
            self.value(put(v))
        for _ in range(_REFINED):
            values, found = self.along(at, i)
            k = int(np.argmax(found))
            if k in (0, len(values) - 1) or found[k] - found[k - 1 : k + 2].min() < _FINE:
                break
            x = np.log(values[k - 1 : k + 2]) if bent else values[k - 1 : k + 2]
            top = _between(x, found[k - 1 : k + 2])
            self.value(put(float(np.exp(top) if bent else top)))
        values, found = self.along(at, i)
        return put(float(values[np.argmax(found)]))


def _between(x: np.ndarray, f: np.ndarray) -> float:
    """The top of the parabola through three places; where it is one of them, a place in the wider half."""
    slopes = np.diff(f) / np.diff(x)
    bent = (slopes[1] - slopes[0]) / (x[2] - x[0])
    top = (x[0] + x[1]) / 2 - slopes[0] / (2 * bent) if bent < 0 and np.isfinite(bent) else x[1]
    if abs(top - x[1]) > 0.1 * min(x[1] - x[0], x[2] - x[1]) and x[0] < top < x[2]:
        return float(top)
    left = x[1] - x[0] > x[2] - x[1]
    return float(x[1] + _GOLDEN * ((x[0] if left else x[2]) - x[1]))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _with(build: Build, known: tuple[tuple[str, float], ...]) -> Build:
    """A build that is given numbers of the filter, too."""

    def made(parameters: Parameters) -> Any:
        return build({**parameters, **dict(known)})

    return made


def filter_of(make: Callable[[Parameters], Any], parameters: Parameters) -> Filter:
    """The filter of parameters.

    Raises:
        InputError: where it is none.
    """
    made = make(parameters)
    if not isinstance(made, Filter):
        raise InputError(f"filter= as a function of parameters must give a filter; it gives {type(made).__name__}")
    return made


def names_read(make: Callable[[Parameters], Any], start: Mapping[str, Any]) -> tuple[str, ...]:
    """Which parameters a filter is made of."""
    read: dict[str, None] = {}

    class Watched(dict[str, Any]):
        def __getitem__(self, key: str) -> Any:
            read[key] = None
            return super().__getitem__(key)

    filter_of(make, Watched({name: float(np.ravel(numbers(name, v))[0]) for name, v in start.items()}))
    return tuple(read)
