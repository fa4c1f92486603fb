"""Numbers of a model from records, by maximum likelihood."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.fitting.determined import covariance, untold
from sigmax.fitting.family import Build
from sigmax.fitting.found import Along, Fit, HeldOut
from sigmax.fitting.likelihood import Data, Likelihoods, first_fault
from sigmax.fitting.search import search_of
from sigmax.fitting.summit import Summit, climb
from sigmax.running.prepare import as_filter

# The picture along a number: so many deviations to each side, at so many places.
_WIDE, _PLACES = 3.0, 13


def fit(
    filter: Filter | str,
    build: Build,
    start: Mapping[str, Any],
    z: Any,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    R: Any = None,
    update_first: bool = False,
    positive: Collection[str] = (),
    bounds: Mapping[str, Any] | None = None,
    more: Sequence[Mapping[str, Any]] = (),
    hold_out: float = 0.0,
    progress: Callable[[str], Any] | None = None,
) -> Fit:
    """Fit numbers by the likelihood that a filter gives one or several records.

    The parameters become inputs of the compiled filter, and a batch of them one run: derivatives are differences over a
    tenth of a standard error, steps Newton's.

    Args:
        filter: whose likelihood, its update included: a robust one has the tails of its own density.
        build: parameters by name -> (model, prior); written with `jax.numpy` where it computes with them.
        start: where to start, numbers or arrays by name.
        z: the record, as in `run`; the likelihoods of a batch are added.
        dt: as in `run`.
        inputs: as in `run`.
        R: as in `run`.
        update_first: as in `run`.
        positive: names of parameters that must stay positive (deviations, densities): they are searched by their
            logarithm.
        bounds: pairs by name, of parameters that stay between two numbers.
        more: further records that share the parameters, each a dict of what is its own: z, and build, dt, inputs, R,
            update_first where they differ.
        hold_out: the share of the last steps that judge a fit of the others, from 0 to 0.9; the result is of all steps.
        progress: is told of each step, in words.

    Returns:
        The fit, with standard errors, correlations and what the record does not determine.

    Raises:
        InputError: where a name is not known, or the likelihood at the start is not finite.
    """
    chosen = as_filter(filter)
    search, begin = search_of(start, positive, {} if bounds is None else bounds)
    if not isinstance(hold_out, int | float) or isinstance(hold_out, bool) or not 0 <= hold_out <= 0.9:
        raise InputError(f"hold_out is the share of the last steps, from 0 to 0.9; it is {hold_out!r}")
    own = Data(build, z, dt, inputs, R, update_first)
    records = [own, *(_another(own, one, k) for k, one in enumerate(more))]
    likelihoods = Likelihoods(chosen, records, search, begin)
    at_start = float(likelihoods(begin[None])[0])
    if not np.isfinite(at_start):
        faults = [f for data in records for f in first_fault(data, chosen, search, begin)]
        raise InputError(
            f"the log-likelihood at the start is not finite ({'; '.join(faults[:1]) or at_start}); start elsewhere"
        )
    y = search.inside(begin)
    summit = climb(likelihoods.inside(), y, search.unit(y), search.straight, progress)
    found = untold(likelihoods.inside(), summit, search, search.labels)
    spread = covariance(summit, search, found)
    held = _held_out(likelihoods, summit, begin, 1 - hold_out, progress) if hold_out else None
    along = _along(likelihoods, summit, spread)
    best, std = (search.named(v) for v in (search.outside(summit.y), np.sqrt(np.diag(spread))))
    return Fit(
        best, std, summit.value, summit.converged, summit.message, likelihoods.evaluations,
        tuple(one.said for one in found), search.labels, spread, search.named(begin), at_start, held, along,
        chosen.name,
    )  # fmt: skip


def _another(own: Data, given: Mapping[str, Any], k: int) -> Data:
    """A further record: what is not its own is that of the first, but for z and R."""
    if not isinstance(given, Mapping) or "z" not in given:
        raise InputError(
            f"more[{k}] must be a dict with z, and build, dt, inputs, R where they differ; it is {given!r}"
        )
    for name in given:
        if name not in Data._fields:
            raise unknown("part of a record", name, Data._fields)
    return own._replace(**({"R": None, "inputs": None} | dict(given)))


def _held_out(
    likelihoods: Likelihoods, summit: Summit, begin: np.ndarray, share: float, progress: Callable[[str], Any] | None
) -> HeldOut:
    """The fit of the first steps, judged by the last ones; from the maximum of all of them it is near."""
    search = likelihoods.search
    early = likelihoods.inside(share)
    first = climb(early, summit.y, search.unit(search.inside(begin)), search.straight, progress)
    both = np.stack([begin, search.outside(first.y)])
    before, after = likelihoods(both) - likelihoods(both, share)
    steps = sum((one.steps - (likelihoods.first(one, share) or 0)) * one.tracks for one in likelihoods.each)
    return HeldOut(steps, float(before), float(after))


def _along(likelihoods: Likelihoods, summit: Summit, spread: np.ndarray) -> tuple[Along, ...]:
    """The log-likelihood along each number, all in one batch."""
    search = likelihoods.search
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
