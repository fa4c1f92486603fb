"""Numbers of filters and updates that are freed: alpha of the points, nu of the tails, the gate."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sigmax.descriptions.trial import Trial, parse_trial, with_updates
from sigmax.errors import InputError
from sigmax.filters import BySensor, Filter, Update, catalogue
from sigmax.records.record import Record
from sigmax.rules import sets


class FilterNumber(NamedTuple):
    """Where a number of a filter is looked for: in what of it, called what there, between which bounds."""

    of: str
    called: str
    bounds: tuple[float, float]


# By the names that people give them. Those of points are parameters of the catalogue, the others of weights.
NAMES = {
    "alpha": FilterNumber("points", "alpha", (0.05, 1.0)),
    "beta": FilterNumber("points", "beta", (0.0, 4.0)),
    "kappa": FilterNumber("points", "kappa", (0.0, 3.0)),
    "w0": FilterNumber("points", "w0", (-0.5, 0.9)),
    "nu": FilterNumber("weight", "dof", (0.5, 50.0)),
    "dof": FilterNumber("weight", "dof", (0.5, 50.0)),
    "threshold": FilterNumber("weight", "threshold", (0.5, 5.0)),
    "gate": FilterNumber("weight", "probability", (0.9, 0.9999)),
    "probability": FilterNumber("weight", "probability", (0.9, 0.9999)),
}


def start_of(record: Record, trial: Trial, name: str) -> float:
    """Where a number of the filter stands now.

    Raises:
        InputError: where the filter has none of this name.
    """
    number = NAMES[name]
    if number.of == "points":
        base, given = _parts(trial)
        entry = {k.casefold(): v for k, v in catalogue().items()}[base.casefold()]
        if number.called not in entry.parameters:
            raise InputError(f"--free {name}: {base} has no parameter {number.called!r}")
        usual = inspect.signature(sets.scaled if name != "w0" else sets.unscented).parameters[number.called].default
        return float(given.get(number.called, usual))
    for update in _updates(with_updates(trial.filter, record.updates)):
        if hasattr(update.weight, number.called):
            return float(getattr(update.weight, number.called))
    raise InputError(f"--free {name}: no update has it; give one, as in --filter EKF:update=student")


def filter_made(record: Record, trial: Trial, names: Sequence[str]) -> Callable[[Mapping[str, Any]], Filter]:
    """The filter of a trial as a function of its numbers."""
    points = [name for name in names if NAMES[name].of == "points"]
    weights = [name for name in names if NAMES[name].of == "weight"]

    def made(parameters: Mapping[str, Any]) -> Filter:
        own = parse_trial(changed(trial, {n: float(parameters[n]) for n in points})).filter if points else trial.filter
        filter = with_updates(own, record.updates)
        if not weights:
            return filter
        values = {NAMES[n].called: float(parameters[n]) for n in weights}
        name = ", ".join([filter.name, *(f"{k} {v:g}" for k, v in values.items())])
        return replace(filter, update=with_weights(filter.update, values), name=name)

    return made


def changed(trial: Trial, values: Mapping[str, float]) -> str:
    """The trial as it is written, with other parameters of its points."""
    base, given = _parts(trial)
    rest = [p for p in _pieces(trial) if p.partition("=")[0].strip() not in values]
    return f"{base}:{','.join([*rest, *(f'{k}={v:g}' for k, v in values.items())])}" if values or given else base


def with_weights(update: Any, values: Mapping[str, float]) -> Any:
    """An update, or one by sensor, whose weights have other numbers."""
    if isinstance(update, BySensor):
        own = tuple((s, with_weights(u, values)) for s, u in update.updates)
        return replace(update, updates=own, others=with_weights(update.others, values))
    if update is None or update.weight is None:
        return update
    fitting: dict[str, Any] = {k: v for k, v in values.items() if hasattr(update.weight, k)}
    return replace(update, weight=replace(update.weight, **fitting))


def _updates(filter: Filter) -> list[Update]:
    update = filter.update
    if isinstance(update, BySensor):
        return [u for u in (*(u for _, u in update.updates), update.others) if u is not None]
    return [] if update is None else [update]


def _pieces(trial: Trial) -> list[str]:
    return [p.strip() for p in trial.name.partition(":")[2].split(",") if p.strip()]


def _parts(trial: Trial) -> tuple[str, dict[str, str]]:
    """The name of the filter, and its parameters."""
    pairs = (p.partition("=") for p in _pieces(trial))
    return trial.name.partition(":")[0].strip(), {k.strip(): v.strip() for k, _, v in pairs}
