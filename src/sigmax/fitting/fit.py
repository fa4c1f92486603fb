"""Numbers of a model from records, by maximum likelihood."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.fitting.assessment import Begin, judged, with_filter_numbers
from sigmax.fitting.lattice import Lattice, Tried, filter_of, names_read
from sigmax.fitting.likelihood import Data, Likelihoods, first_fault
from sigmax.fitting.maximum import climb
from sigmax.fitting.parametric_model import Build
from sigmax.fitting.result import Fit
from sigmax.fitting.search import Parameters, search_of
from sigmax.preparation.prepare import as_filter


def fit(
    filter: Filter | str | Callable[[Parameters], Filter],
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
    begin: Mapping[str, Any] | None = None,
    progress: Callable[[str], Any] | None = None,
) -> Fit:
    """Fit numbers by the likelihood that a filter gives one or several records.

    The parameters become inputs of the compiled filter, and a batch of them one run: derivatives are differences over a
    tenth of a standard error, steps Newton's.

    Args:
        filter: whose likelihood, its update included: a robust one has the tails of its own density. Or a function of
            the parameters that gives it, `lambda p: sigmax.get("UKF", alpha=p["alpha"])`: those that it reads need
            bounds, and are tried on a lattice, for each value is compiled.
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
        begin: where the search begins, if not at `start`, which the result is held against.
        progress: is told of each step, in words.

    Returns:
        The fit, with standard errors, correlations and what the record does not determine.

    Raises:
        InputError: where a name is not known, or the likelihood at the start is not finite.
    """
    if not isinstance(start, Mapping) or not start:
        raise InputError(
            f"start must name the parameters and where they start, such as {{'sigma': 1.0}}; it is {start!r}"
        )
    if not isinstance(hold_out, int | float) or isinstance(hold_out, bool) or not 0 <= hold_out <= 0.9:
        raise InputError(f"hold_out is the share of the last steps, from 0 to 0.9; it is {hold_out!r}")
    own = Data(build, z, dt, inputs, R, update_first)
    records = [own, *(_another(own, one, k) for k, one in enumerate(more))]
    limits = {} if bounds is None else bounds
    if begin is not None and (not isinstance(begin, Mapping) or set(begin) != set(start)):
        raise InputError(f"begin must have the names of start, {', '.join(start)}; it is {begin!r}")
    chosen: Any = filter
    if callable(chosen) and not isinstance(chosen, Filter | type):
        return _with_filters(
            chosen, records, (start, positive, limits), start if begin is None else begin, hold_out, progress
        )
    chosen, (search, theta) = as_filter(chosen), search_of(start, positive, limits)
    likelihoods = Likelihoods(chosen, records, search, theta)
    first = Begin(likelihoods, theta, _at(likelihoods, chosen, theta))
    if begin is not None:
        theta = search_of(begin, positive, limits)[1]
        _at(likelihoods, chosen, theta)
    y = search.inside(theta)
    summit = climb(likelihoods.inside(), y, search.unit(y), search.straight, progress)
    return judged(Tried(likelihoods, summit), first, hold_out, progress)


def _with_filters(
    make: Callable[[Parameters], Filter],
    records: list[Data],
    given: tuple[Mapping[str, Any], Collection[str], Mapping[str, Any]],
    began: Mapping[str, Any],
    hold_out: float,
    progress: Callable[[str], Any] | None,
) -> Fit:
    """The fit where the filter is made of parameters, too."""
    start, positive, bounds = given
    names = names_read(make, start)
    for name in names:
        if name not in bounds:
            raise InputError(f"{name} is one of the filter: give bounds={{{name!r}: (low, high)}} to look between")
    own = {name: start[name] for name in names}
    whole, at = search_of(own, (), {name: bounds[name] for name in names})
    limits = dict(zip(whole.labels, zip(whole.low, whole.high, strict=True), strict=True))
    others = {k: v for k, v in start.items() if k not in names}
    search, theta = search_of(
        others,
        [name for name in positive if name not in names],
        {k: v for k, v in bounds.items() if k not in names},
    )
    lattice = Lattice(make, records, search, search.flat({k: began[k] for k in others}), limits, progress)
    first = lattice.likelihoods(tuple(at))
    begin = Begin(first, theta, _at(first, filter_of(make, {**others, **own}), theta))
    best = lattice.best(tuple(at))
    found = judged(lattice.tried[best], begin, hold_out, progress)
    return with_filter_numbers(found, lattice, best, dict(zip(limits, at, strict=True)))


def _at(likelihoods: Likelihoods, filter: Filter, theta: np.ndarray) -> float:
    """The log-likelihood at the start.

    Raises:
        InputError: where there is none.
    """
    value = float(likelihoods(theta[None])[0])
    if not np.isfinite(value):
        faults = [f for one in likelihoods.each for f in first_fault(one.data, filter, likelihoods.search, theta)]
        raise InputError(
            f"the log-likelihood at the start is not finite ({'; '.join(faults[:1]) or value}); start elsewhere"
        )
    return value


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
