"""A maximum as a fit: what it is worth, what is not told, and how steps that were left out judge it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sigmax.fitting.identifiability import covariance, untold
from sigmax.fitting.lattice import Lattice, Tried
from sigmax.fitting.likelihood import Likelihoods
from sigmax.fitting.maximum import Summit, climb
from sigmax.fitting.result import Along, Fit, HeldOut

# The picture along a number: so many deviations to each side, at so many places.
_WIDE, _PLACES = 3.0, 13


class Begin(NamedTuple):
    """The start: its likelihoods, its parameters (p,), and the log-likelihood there."""

    likelihoods: Likelihoods
    theta: np.ndarray
    value: float


def judged(tried: Tried, begin: Begin, hold_out: float, progress: Callable[[str], Any] | None) -> Fit:
    """The fit of a maximum."""
    likelihoods, summit = tried
    search = likelihoods.search
    found, summit = untold(likelihoods.inside(), summit, search, search.labels)
    spread = covariance(summit, search, found)
    held = _held_out(tried, begin, 1 - hold_out, progress) if hold_out else None
    along = _along(likelihoods, summit, spread)
    best, std = (search.named(v) for v in (search.outside(summit.y), np.sqrt(np.diag(spread))))
    return Fit(
        best, std, summit.value, summit.converged, summit.message, likelihoods.evaluations,
        tuple(one.said for one in found), search.labels, spread, search.named(begin.theta), begin.value, held, along,
        likelihoods.each[0].filter.name,
    )  # fmt: skip


def with_filter_numbers(fit: Fit, lattice: Lattice, at: tuple[float, ...], start: Mapping[str, float]) -> Fit:
    """The fit with the numbers of its filter, which widen the errors of what goes with them."""
    search, names = lattice.search, list(lattice.bounds)
    p, q = search.size, len(names)
    slope = search.slope(lattice.tried[at].summit.y)
    spread = np.full((p + q, p + q), np.nan)
    inner = fit.covariance if fit.covariance is not None else np.zeros((p, p))
    spread[:p, :p] = inner
    said, along, std = [], [], {}
    for i, name in enumerate(names):
        deviation, with_it = lattice.spread(at, i)
        why = lattice.untold(at, i)
        said += [why] if why else []
        std[name] = np.array(np.nan if why else deviation)
        values, found = lattice.along(at, i)
        along.append(Along(name, values, fit.log_likelihood - found))
        if why:
            continue
        line = with_it * slope
        spread[:p, :p] += np.outer(line, line) * deviation**2
        spread[p + i, :p] = spread[:p, p + i] = line * deviation**2
        spread[p + i, p + i] = deviation**2
    deviations = np.sqrt(np.diag(spread)[:p])
    return replace(
        fit,
        parameters=fit.parameters | {name: np.array(v) for name, v in zip(names, at, strict=True)},
        std=search.named(deviations) | std,
        undetermined=(*fit.undetermined, *said),
        labels=(*fit.labels, *names),
        covariance=spread,
        start=(fit.start or {}) | {name: np.array(v) for name, v in start.items()},
        along=(*fit.along, *along),
        evaluations=fit.evaluations + lattice.evaluations,
    )


def _held_out(tried: Tried, begin: Begin, share: float, progress: Callable[[str], Any] | None) -> HeldOut:
    """The fit of the first steps, judged by the last ones; from the maximum of all of them it is near."""
    likelihoods, summit = tried
    search, early = likelihoods.search, likelihoods.inside(share)
    first = climb(early, summit.y, search.unit(search.inside(begin.theta)), search.straight, progress)
    old, new = begin.theta[None], search.outside(first.y)[None]
    before = (begin.likelihoods(old) - begin.likelihoods(old, share))[0]
    after = (likelihoods(new) - likelihoods(new, share))[0]
    steps = sum((one.steps - (likelihoods.first(one, share) or 0)) * one.tracks for one in likelihoods.each)
    return HeldOut(steps, float(before), float(after))


def _along(likelihoods: Likelihoods, summit: Summit, spread: np.ndarray) -> tuple[Along, ...]:
    """The log-likelihood along each number, all in one batch."""
    search = likelihoods.search
    if not search.size:
        return ()
    slope, places = search.slope(summit.y), np.linspace(-_WIDE, _WIDE, _PLACES)
    directions = []
    for i in range(search.size):
        variance = spread[i, i]
        if np.isfinite(variance) and variance > 0:
            line = np.nan_to_num(spread[i] / np.sqrt(variance)) / slope
        else:  # so far that something is seen of a number that is not told
            line = np.eye(search.size)[i] * (1.0 if search.logarithmic[i] or search.boxed[i] else 10 * summit.steps[i])
        directions.append(line)
    points = np.concatenate([summit.y + places[:, None] * line for line in directions])
    lost = (summit.value - likelihoods.inside()(points)).reshape(search.size, -1)
    values = search.outside(points).reshape(search.size, _PLACES, -1)
    return tuple(Along(name, values[i, :, i], lost[i]) for i, name in enumerate(search.labels))
