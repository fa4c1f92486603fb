"""Fits of records: numbers by name, several records at once."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sigmax.corrections.filter_numbers import filter_made
from sigmax.corrections.free_model import build_of
from sigmax.corrections.free_numbers import Number, asked, find
from sigmax.descriptions.trial import Trial, parse_trial, with_updates
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.fitting import Fit, em, fit
from sigmax.models import Gaussian, Model
from sigmax.records.load import load, load_plots
from sigmax.records.record import Record


class RecordFit(NamedTuple):
    """What was fitted.

    Attributes:
        fit: the fit.
        numbers: what was freed, as it stands in the first record.
        records: the records.
        trial: whose likelihood it is.
    """

    fit: Fit
    numbers: tuple[Number, ...]
    records: tuple[Record, ...]
    trial: Trial


def fit_numbers(
    names: Sequence[str],
    free: Sequence[str],
    *,
    filter: str | None = None,
    hold_out: float = 0.0,
    by_em: bool = False,
    progress: Callable[[str], Any] | None = None,
) -> RecordFit:
    """Fit numbers of one or several records, which share them.

    Args:
        names: of records, as of `load`.
        free: numbers by name, such as "Q", "R.radar", "range_scale", "motion.tau=1..30": see the docs, `docs/fit.md`.
        filter: whose likelihood, as for `sigmax track`; else the first of the first record.
        hold_out: as of `sigmax.fit`.
        by_em: whether the factors of Q and R start where `sigmax.fitting.em` of the first record ends.
        progress: as of `sigmax.fit`.

    Raises:
        InputError: for what is not known, and whatever `sigmax.fit` refuses.
    """
    wanted = asked(free)
    records, paths = [], []
    for name in names:
        if load_plots(name, None) is not None:
            raise InputError(f"{name} holds plots: numbers are fitted to records whose measurements belong to a track")
        records.append(load(name))
        paths.append(Path(name) if Path(name).suffix.casefold() == ".toml" else None)
    trial = records[0].trials[0] if filter is None else parse_trial(filter)
    told = [_given(record, path, wanted, trial) for record, path in zip(records, paths, strict=True)]
    numbers, first, chosen = told[0]
    for other, (own, _, judge) in zip(records[1:], told[1:], strict=True):
        for a, b in zip(numbers, own, strict=True):
            if (a.unit, a.kind) != (b.unit, b.kind):
                raise InputError(f"{a.name} is in {a.unit!r} in {records[0].name} and in {b.unit!r} in {other.name}")
        if record_filter(other, judge) != record_filter(records[0], chosen):
            raise InputError(f"{other.name} corrects by other updates than {records[0].name}: give one by --filter")
    of_filter = [n.name for n in numbers if n.kind == "filter"]
    found = fit(
        filter_made(records[0], chosen, of_filter) if of_filter else record_filter(records[0], chosen),
        first["build"],
        {n.name: n.start for n in numbers},
        first["z"],
        dt=first["dt"],
        inputs=first["inputs"],
        update_first=first["update_first"],
        positive=[n.name for n in numbers if n.positive and n.bounds is None],
        bounds={n.name: n.bounds for n in numbers if n.bounds is not None},
        more=[given for _, given, _ in told[1:]],
        hold_out=hold_out,
        begin=_starts(records[0], chosen, numbers, progress) if by_em else None,
        progress=progress,
    )
    return RecordFit(found, tuple(numbers), tuple(records), trial)


def _starts(
    record: Record, trial: Trial, numbers: Sequence[Number], progress: Callable[[str], Any] | None
) -> dict[str, float]:
    """Where numbers start, factors of noises by expectation–maximisation."""
    factors = [n for n in numbers if n.kind == "factor"]
    for n in factors:
        if n.at[0] == "Q" and len(n.at) > 1:
            raise InputError(f"--em gives one factor of Q, not {n.name}: free Q")
    if not factors:
        raise InputError("--em starts factors of noises: free Q or R, or leave it out")
    if progress is not None:
        progress("expectation and maximisation")
    filter, model, prior = record.of_trial(trial)
    found = em(
        filter, model, prior, record.z, dt=record.dt, inputs=record.inputs, update_first=record.update_first, steps=20
    )
    starts = {n.name: n.start for n in numbers}
    for n in factors:
        if n.at[0] == "Q":
            starts[n.name] = found.Q
            continue
        some = {s: v for s, v in found.R.items() if len(n.at) == 1 or s == n.at[1]}
        names = {s: model.measured_deviations(s) or () for s in some}
        kept = [v[j] for s, v in some.items() for j, c in enumerate(names[s]) if len(n.at) < 3 or c == n.at[2]]
        starts[n.name] = float(np.exp(np.mean(np.log(kept))))
    return starts


def record_filter(record: Record, trial: Trial) -> Filter:
    """The filter of a trial with the updates of a record's sensors."""
    return with_updates(trial.filter, record.updates)


def _given(record: Record, path: Path | None, wanted: Any, trial: Trial) -> tuple[list[Number], dict[str, Any], Any]:
    """The numbers, what `fit` is given of a record, and its filter."""
    numbers = find(record, path, trial, wanted)
    plain = trial._replace(fixed=tuple(f for f in trial.fixed if f not in wanted))

    def told(model: Model) -> tuple[Model, Gaussian]:
        if not plain.fixed:
            return model, record.prior
        return replace(record, model=model).of_trial(plain)[1:]

    inputs = record.inputs
    given = {
        "build": build_of(record, path, numbers, told),
        "z": record.z,
        "dt": record.dt,
        "inputs": None if inputs is None else np.asarray(inputs),
        "update_first": record.update_first,
    }
    return numbers, given, plain
