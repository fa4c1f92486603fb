"""What in a record looks as if it were meant otherwise, in words: units, tracks that run together, rows there twice."""

import math
import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.sensor import first_position
from sigmax.files.description import Description
from sigmax.files.table import Table, clock_period
from sigmax.files.units import ANGLE, TURN_RATE, quantity
from sigmax.proposals.column_meanings import LATEST, epoch_unit, likely_track, speeds
from sigmax.proposals.roles import has_numbers

_SENTINELS = (-9999.0, -999.0, -99999.0, 9999.0, 99999.0, 999999.0, -32768.0, 32767.0)
# A target may be so many times as fast or slow as the prior has it.
_FAST, _SLOW = 100.0, 1e-3


def doubts(
    description: Description,
    built: DescribedModel,
    table: Table,
    time: np.ndarray,
    epoch: pd.Timestamp | None,
    names: tuple[str, ...],
    rows: list[np.ndarray],
    measured: dict[str, np.ndarray],
) -> tuple[str, ...]:
    """One sentence for each doubt, with what to write if it is right.

    Args:
        description: of the record.
        built: its model.
        table: its data.
        time: of the rows, s.
        epoch: the instant of time 0, None where times are numbers.
        names: of the tracks.
        rows: of each track.
        measured: by sensor (rows, m), in SI.
    """
    return (
        *_time(description, table, time, epoch),
        *clock_doubts(description.time.column, description.time.format, time, epoch),
        *standstill(description.time.column, time, rows),
        *_angles(description, built, table),
        *_sentinels(description, built, table),
        *_twice(description, time, names, rows, measured),
        *_pace(description, built, table, time, rows, measured),
    )


def _time(description: Description, table: Table, time: np.ndarray, epoch: pd.Timestamp | None) -> Iterator[str]:
    column = description.time
    if column.unit.strip() or column.format:
        return
    if epoch is not None:
        if has_numbers(table, column.column):
            unit = epoch_unit(float(table.numbers(column.column).max()))
            yield (
                f"The time {column.column!r} is taken for a count since 1970 in {unit}, by its size; to say so, write "
                f'time = {{ column = "{column.column}", unit = "{unit}" }}.'
            )
        return
    told = re.search(r"(?:^|[^a-z])(ms|us|ns|milli|micro|nano)", column.column.casefold())
    largest = float(np.abs(time).max())
    unit = ""
    if told:
        unit = {"mi": "ms", "us": "us", "ns": "ns", "na": "ns", "ms": "ms"}[told[1][:2]]
        unit = "us" if told[1] == "micro" else unit
    elif largest > LATEST:
        unit = epoch_unit(largest)
    if unit:
        yield (
            f"The time {column.column!r} is read as seconds, up to {largest:.6g}; if it counts otherwise, write "
            f'time = {{ column = "{column.column}", unit = "{unit}" }}.'
        )


def clock_doubts(column: str, format: str, time: np.ndarray, epoch: pd.Timestamp | None) -> Iterator[str]:
    """That times of day were read as those of several days."""
    period = clock_period(format)
    if not period or epoch is None:
        return
    first, last = (int(moment.timestamp() // period) for moment in (epoch, epoch + pd.Timedelta(seconds=time.max())))
    if last > first:
        after = {86400: "midnight", 43200: "12 o'clock", 3600: "the full hour", 60: "the full minute"}[period]
        count = "" if last == first + 1 else f" {last - first} times"
        yield (
            f"The time {column!r} has no date and passes {after}{count}: one that falls by more than half a period "
            "is read as of the next. If that is not meant, write dates."
        )


def standstill(column: str, time: np.ndarray, rows: list[np.ndarray]) -> Iterator[str]:
    """That no time passes between the rows of any track."""
    several = [r for r in rows if len(r) > 1]
    if several and not any(np.ptp(time[r]) > 0 for r in several):
        yield (
            f"No time passes from row to row: {column!r} is the same in all rows of a track, so that nothing moves "
            "between them; another column may be the time."
        )


def _angles(description: Description, built: DescribedModel, table: Table) -> Iterator[str]:
    wanted = [
        (column, f"sensors.{s}.columns.{name}")
        for s, sensing in built.sensings.items()
        for name, column in description.sensors[s].columns.items()
        if sensing.dimensions[name] == ANGLE
    ]
    wanted += [(i.column, i.where) for i in built.inputs if i.dimension in (ANGLE, TURN_RATE)]
    for column, where in wanted:
        values = np.abs(column.numbers(table))
        large = np.isfinite(values).any() and np.nanmax(values) > 2.1 * math.pi
        if not column.unit.strip() and large:
            yield (
                f"{where} is read in radians and goes up to {np.nanmax(values):.4g}; if these are degrees, write "
                f'{{ column = "{column.column}", unit = "deg" }}.'
            )


def _sentinels(description: Description, built: DescribedModel, table: Table) -> Iterator[str]:
    for s in built.sensings:
        for name, column in description.sensors[s].columns.items():
            values = column.numbers(table)
            spread = np.abs(values[np.isfinite(values) & ~np.isin(values, _SENTINELS)])
            for value in _SENTINELS:
                count = int((values == value).sum())
                if count > 1 and (not len(spread) or abs(value) > 3 * spread.max()):
                    yield (
                        f"sensors.{s}.columns.{name} is {value:g} in {count} rows; if that means that nothing was "
                        f'measured, write {{ column = "{column.column}", missing = {value:g} }}.'
                    )


def _twice(
    description: Description,
    time: np.ndarray,
    names: tuple[str, ...],
    rows: list[np.ndarray],
    measured: dict[str, np.ndarray],
) -> Iterator[str]:
    z = np.concatenate(list(measured.values()), axis=1)
    count, first = 0, ""
    for name, r in zip(names, rows, strict=True):
        again = (np.diff(time[r]) == 0) & _same(z[r][1:], z[r][:-1])
        if again.any() and not count:
            place = time[r][1:][again][0]
            first = f"{place:.10g} s" + (f" of the track {name!r}" if description.track else "")
        count += int(again.sum())
    if count:
        yield (
            f"{count} rows say the same as the row before them, the first at {first}; each counts as a measurement of "
            "its own: if they are copies, remove them."
        )


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return ((a == b) | (np.isnan(a) & np.isnan(b))).all(1) & ~np.isnan(a).all(1)


def _pace(
    description: Description,
    built: DescribedModel,
    table: Table,
    time: np.ndarray,
    rows: list[np.ndarray],
    measured: dict[str, np.ndarray],
) -> Iterator[str]:
    """Doubts from how fast positions change against how fast the prior says that targets may be."""
    kinds = "position", "range_azimuth"
    sensor = next((s for s, one in built.sensings.items() if one.kind in kinds and not callable(one.R)), None)
    fastest = _fastest(description, built)
    if sensor is None or fastest is None:
        return
    place, _ = first_position(built.sensings[sensor], measured[sensor])
    column = next(iter(description.sensors[sensor].columns.values()))
    if re.match(r"#?\s*(lat|lon|lng)", column.column.casefold()) and description.local is None:
        yield (
            f"{column.column!r} is read as a length; if it is a latitude or a longitude, describe both in a table "
            "[local], which makes metres of them."
        )
    moved = speeds(place, time, rows)
    if not len(moved):
        return
    pace = float(np.median(moved))
    if description.track is None and pace > _FAST * fastest:
        other = likely_track(table, time, place)
        hint = f'track = "{other}"' if other else "track = the column that tells them apart"
        yield (
            f"From row to row the positions of {sensor!r} jump as if targets moved at {pace:.3g} m/s, where the prior "
            f"has {fastest:.3g} m/s at most; if there are several tracks in the file, write {hint}."
        )
    elif pace > _FAST * fastest or pace < _SLOW * fastest:
        yield (
            f"As the file is read, targets move at {pace:.3g} m/s, where the prior has up to {fastest:.3g} m/s; the "
            "unit of the time or of the positions may be another."
        )


def _fastest(description: Description, built: DescribedModel) -> float | None:
    """The largest speed that the prior finds likely."""
    state = built.model.state
    mean, deviation = built_prior(description, built)
    places = [state.index(f"v{state[i]}") for i in built.position if f"v{state[i]}" in state]
    if not places:
        return None
    return max(abs(mean[i]) + 3 * deviation[i] for i in places) or None


def built_prior(description: Description, built: DescribedModel) -> tuple[list[float], list[float]]:
    """Mean and deviation of each component, 0 where the prior of a description says nothing of it."""
    mean, deviation = [], []
    for name, dimension in zip(built.model.state, built.dimensions, strict=True):
        given = description.prior.get(str(name))
        both = given if isinstance(given, dict) else {"mean": 0, "std": 0}
        mean.append(quantity(both["mean"], dimension, f"prior.{name}.mean"))
        deviation.append(quantity(both["std"], dimension, f"prior.{name}.std"))
    return mean, deviation
