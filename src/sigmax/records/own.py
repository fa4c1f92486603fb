"""A user's own record: a table and the TOML that describes it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.descriptions.delays import Rows, undelayed
from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.landmarks import with_landmark_inputs, with_landmarks
from sigmax.descriptions.local import placed
from sigmax.descriptions.model import build
from sigmax.descriptions.prior import ALL_FROM, FROM, read_prior, search
from sigmax.descriptions.several import read_data
from sigmax.descriptions.trial import parse_trial
from sigmax.errors import InputError, unknown
from sigmax.files.description import Column, Description, TimeColumn, read_toml
from sigmax.files.table import Table
from sigmax.files.units import TIME, Dimension, parse_unit, to_si
from sigmax.models import Gaussian
from sigmax.proposals.column_meanings import counted_since_1970
from sigmax.proposals.doubts import doubts
from sigmax.records.beginning import from_measurements
from sigmax.records.record import Record

# Padding may take this many times the room of the data, or this many steps.
_PADDING, _ROOM = 8, 4_000_000


def own(path: Path) -> Record:
    """The record that a TOML file describes.

    Raises:
        InputError: for whatever does not fit, in the description, the data or the user's functions.
    """
    description = read_toml(path, Description)
    try:
        return _record(path, description)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error


def _record(path: Path, description: Description) -> Record:
    trials = tuple(dict.fromkeys(parse_trial(text) for text in description.filters))
    description = with_landmark_inputs(description)
    built = build(description, path.parent)
    check_columns(description, built)
    description, table, frame = read_data(description, path.parent, instants, _tracks)
    table, known = with_landmarks(description, table, path.parent)
    time, epoch = instants(table, description.time)
    names, rows = _tracks(table, description.track, time, description.sort)
    measured = {sensor: columns(table, measured_columns(description, built, sensor)) for sensor in built.sensings}
    inputs = _inputs(table, built, measured, rows)
    truth = np.full((len(table), built.model.size), np.nan)
    for name, column in description.truth.items():
        place = built.model.state.index(name)
        truth[:, place] = _column(table, column, built.dimensions[place], f"truth.{name}")
    of_table = time, epoch, names, rows, measured
    (time, rows, measured, inputs, truth), late = undelayed(Rows(time, rows, measured, inputs, truth), built)
    names, rows, silent = _beginning(description.prior.get(FROM), measured, names, rows)
    asked = description.prior
    found = search(asked, built, measured, rows) if ALL_FROM in asked else None
    if found is None:
        mean, cov, rows, notes = read_prior(asked, built, measured, inputs, rows, names)
    else:
        (mean, _), cov, notes = found, np.eye(built.model.dim), ()
    steps = np.array([len(r) for r in rows])
    if steps.max() * len(rows) > max(_PADDING * steps.sum(), _ROOM):
        raise InputError(
            f"the {len(rows)} tracks run in one batch as long as the longest of {steps.max()} rows, of which "
            f"{steps.sum() / (steps.max() * len(rows)):.1%} would be used: put the long tracks into a file of their own"
        )
    # Behind its end a track stands still: row 0 of nothing measured, no time, the last inputs.
    index = np.stack([np.pad(r, (0, steps.max() - len(r)), mode="edge") for r in rows])
    real = np.arange(steps.max()) < steps[:, None]
    z = {s: np.where(real[..., None], v[index], np.nan) for s, v in measured.items()}
    times = time[index]
    landmarks = known | {
        sensor: (s.origin[0], s.origin[1])
        for sensor, s in built.sensings.items()
        if s.origin is not None and len(s.origin) > 1
    }
    made = Record(
        name=path.stem,
        title=description.title or path.stem,
        model=built.model,
        prior=Gaussian(mean, cov),
        tracks=names,
        time=times,
        steps=steps,
        z=z,
        dt=np.diff(times, axis=1, prepend=times[:, :1]),
        inputs=None if inputs is None else inputs[index],
        truth=truth[index],
        position=built.position,
        dimensions=built.dimensions,
        bias_dimensions=() if built.biased is None else built.biased.dimensions,
        trials=trials,
        epoch=epoch,
        landmarks=landmarks,
        source=description.source or description.data,
        licence=description.licence,
        notes=(*table.notes, *late, *silent, *notes),
        doubts=doubts(description, built, table, *of_table),
        update_first=True,
        updates=built.updates,
        placed=placed(description, built, frame),
    )
    return made if found is None else from_measurements(made, *found)


def check_columns(description: Description, built: DescribedModel) -> None:
    """What can be refused before the table is read.

    Raises:
        InputError: for columns that are missing, too many, or of a unit that does not fit.
    """
    for sensor, sensing in built.sensings.items():
        given = description.sensors[sensor].columns
        for name in given:
            if name not in sensing.dimensions:
                raise InputError(f"sensors.{sensor}.columns: {unknown('component', name, sensing.dimensions)}")
        for name, dimension in sensing.dimensions.items():
            if name not in given:
                raise InputError(f"sensors.{sensor}.columns needs {str(name)!r}: the column of {dimension.what}")
            to_si(given[name].unit, dimension, f"sensors.{sensor}.columns.{name}")
    for item in built.inputs:
        if item.dimension is not None:
            to_si(item.column.unit, item.dimension, item.where)
    for name, column in description.truth.items():
        if name not in built.model.state:
            raise InputError(f"truth: {unknown('component', name, built.model.state)}")
        to_si(column.unit, built.dimensions[built.model.state.index(name)], f"truth.{name}")
    to_si(description.time.unit, TIME, "time")


def measured_columns(
    description: Description, built: DescribedModel, sensor: str
) -> list[tuple[Column, Dimension | None, str]]:
    """What a sensor measures: column, dimension, and where it is said."""
    given = description.sensors[sensor].columns
    dimensions = built.sensings[sensor].dimensions
    return [(given[name], dimension, f"sensors.{sensor}.columns.{name}") for name, dimension in dimensions.items()]


def columns(table: Table, wanted: Sequence[tuple[Column, Dimension | None, str]]) -> np.ndarray:
    """Columns in SI (rows, k)."""
    return np.column_stack([_column(table, *one) for one in wanted])


def _column(table: Table, column: Column, dimension: Dimension | None, where: str) -> np.ndarray:
    if dimension is None:
        factor = parse_unit(column.unit, where)[0] if column.unit.strip() else 1.0
    else:
        factor = to_si(column.unit, dimension, where)
    return column.numbers(table) * factor


def instants(table: Table, column: TimeColumn) -> tuple[np.ndarray, pd.Timestamp | None]:
    """Times in seconds, and the instant of 0 where they are timestamps or counts since 1970."""
    if column.missing:
        raise InputError("time: every row needs one; missing belongs to what is measured")
    time, epoch = table.times(column.column, column.format)
    if epoch is not None:
        if column.unit.strip():
            raise InputError(f"time: the column {column.column!r} holds timestamps, which have no unit {column.unit!r}")
        return time, epoch
    factor = to_si(column.unit, TIME, "time")
    counted = counted_since_1970(time, factor if column.unit.strip() else None)
    return (time * factor, None) if counted is None else counted


def _tracks(table: Table, column: str | None, time: np.ndarray, sort: bool) -> tuple[tuple[str, ...], list[np.ndarray]]:
    """Names of the tracks and the rows of each, in their order, times checked; or sorted by time."""
    if column is None:
        names: tuple[str, ...] = ("1",)
        rows = [np.arange(len(table))]
    else:
        series: pd.Series[Any] = table.column(column)
        if series.isna().any() or (series.astype("string").str.strip() == "").any():
            empty = series.isna() | (series.astype("string").str.strip() == "")
            row = table.row(int(np.flatnonzero(empty.to_numpy(bool))[0]))
            raise InputError(f"{table.path.name}, row {row}: the column {column!r} does not say which track")
        codes, labels = pd.factorize(series)
        names = tuple(str(label).strip() for label in labels)
        order = np.argsort(codes, kind="stable")
        rows = np.split(order, np.cumsum(np.bincount(codes))[:-1])
    if sort:
        return names, [r[np.argsort(time[r], kind="stable")] for r in rows]
    for name, r in zip(names, rows, strict=True):
        back = np.flatnonzero(np.diff(time[r]) < 0)
        if len(back):
            i = int(back[0])
            track = "" if column is None else f" of the track {name!r}"
            raise InputError(
                f"{table.path.name}: time runs backwards{track} from row {table.row(int(r[i]))} ({time[r[i]]:.15g} s) "
                f"to row {table.row(int(r[i + 1]))} ({time[r[i + 1]]:.15g} s); sort the rows by time, or write "
                "sort = true at the top of the description"
            )
    return names, rows


def _beginning(
    sensor: str | None, measured: dict[str, np.ndarray], names: tuple[str, ...], rows: list[np.ndarray]
) -> tuple[tuple[str, ...], list[np.ndarray], tuple[str, ...]]:
    """The tracks without those in which the sensor that shall begin them never measures, and a note of these."""
    if not isinstance(sensor, str) or sensor not in measured:
        return names, rows, ()
    seen = [bool((~np.isnan(measured[sensor][r])).all(1).any()) for r in rows]
    if all(seen) or not any(seen):
        return names, rows, ()
    left_out = [name for name, any_seen in zip(names, seen, strict=True) if not any_seen]
    shown = ", ".join(left_out[:5]) + (", …" if len(left_out) > 5 else "")
    note = f"{len(left_out)} of {len(names)} tracks are left out, as {sensor!r} never measures them: {shown}."
    kept = [k for k, any_seen in enumerate(seen) if any_seen]
    return tuple(names[k] for k in kept), [rows[k] for k in kept], (note,)


def _inputs(
    table: Table, built: DescribedModel, measured: dict[str, np.ndarray], rows: list[np.ndarray]
) -> np.ndarray | None:
    """All inputs (rows, k). An empty one holds the value before it; a sensor's may miss where it measured nothing."""
    if not built.inputs:
        return None
    values = columns(table, [(i.column, i.dimension, i.where) for i in built.inputs])
    for k, item in enumerate(built.inputs):
        for r in rows:
            held = pd.Series(values[r, k]).ffill().to_numpy()
            silent = np.zeros(len(r), bool) if item.sensor is None else np.isnan(measured[item.sensor][r]).all(1)
            missing = np.isnan(held) & ~silent
            if missing.any():
                row = table.row(int(r[np.flatnonzero(missing)[0]]))
                raise InputError(
                    f"{table.path.name}, row {row}: the column {item.column.column!r} is empty, and so are the rows "
                    f"of the track before it; {item.where} needs a value from the first row on"
                )
            below = ~(held > 0) & ~silent
            if item.deviation and below.any():
                row = table.row(int(r[np.flatnonzero(below)[0]]))
                raise InputError(
                    f"{table.path.name}, row {row}: {item.where} must be above 0, a standard deviation; it is "
                    f"{held[below][0]:g}: name numbers that mean nothing, missing = {held[below][0]:g}"
                )
            values[r, k] = np.nan_to_num(held, nan=float(item.deviation))
    return values
