"""A first description for a file of data, made from the names of its columns and from their numbers."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from sigmax.descriptions.local import POSITION
from sigmax.errors import InputError
from sigmax.files.read_table import read_tables
from sigmax.files.table import Table, clock_period
from sigmax.files.units import TIME, to_si
from sigmax.proposals.beacons import beacons
from sigmax.proposals.column_meanings import labels_of, likely_track, speeds
from sigmax.proposals.doubts import clock_doubts, standstill
from sigmax.proposals.positions import geodetic, plane, polar, quoted
from sigmax.proposals.roles import TimeRole, has_numbers, time_of, track_of

_DAY = 86400.0
# Names of tables that a receiver fills; they are preferred to those with what a device estimates from them.
_RECEIVER = re.compile(r"gps|gnss|fix|navsat", re.IGNORECASE)


class Proposal(NamedTuple):
    """A description to begin with, and what was taken for what."""

    toml: str
    remarks: tuple[str, ...]


class _Ranked(NamedTuple):
    """The proposal for a table of a log, whether it rests on no names, and how much speaks against the table."""

    proposal: Proposal
    guess: bool
    rank: tuple[float, ...]


def propose(path: Path) -> Proposal:
    """A minimal description: constant velocity, and what measures a position by the names and numbers of the columns.

    Of the tables of a log it is of the one that most likely measures positions.

    Raises:
        InputError: where the file cannot be read, or no columns look like a time and a position.
    """
    tables = read_tables(path)
    if len(tables) == 1:
        return _proposed(path, *_table(next(iter(tables.values())))).proposal
    found: dict[str, _Ranked] = {}
    refused: dict[str, str] = {}
    for name, one in tables.items():
        try:
            found[name] = _proposed(path, one, ".", name)
        except InputError as error:
            refused[name] = str(error)
    if not found:
        raise InputError(
            f"{path.name}: none of its tables {', '.join(tables)} has a time and a position; of the first it is said: "
            f"{next(iter(refused.values()))}"
        )
    best, *others = sorted(found, key=lambda name: found[name].rank)
    # What rests on no name is not worth a word.
    named = [repr(name) for name in others if not found[name].guess]
    more = f"; {', '.join(named[:8])} {'has' if len(named) == 1 else 'have'} positions, too" if named else ""
    toml, remarks = found[best].proposal
    return Proposal(toml, (f"Of {len(tables)} tables {best!r} is taken{more}.", *remarks))


def _proposed(path: Path, table: Table, decimal: str, of_log: str = "") -> _Ranked:
    names = list(table.names)
    if len(names) < 3:
        raise InputError(f"{path.name} has the columns {', '.join(names)}; a time and two measured ones are the least")
    time = time_of(table)
    clock, epoch = table.times(time.column, time.format)
    clock = clock * to_si(time.unit, TIME, "time")
    track = track_of(table, (time.column,))
    seen = (
        geodetic(table, clock, time, track)
        or beacons(table, time, track)
        or polar(table, time, track)
        or plane(table, time, track)
    )
    remarks = [*table.notes, time.remark, *seen.remarks]
    if track is None:
        others = [n for n in names if n not in (time.column, *seen.columns)]
        track = likely_track(table, clock, seen.place, others)
        if track:
            remarks.append(f"Tracks are told apart by {track!r}: so their positions hang together.")
    count = 1 if track is None else labels_of(table, track).nunique()
    remarks.append("All rows are one track." if track is None else f"{track!r} tells {count} tracks apart.")
    rows = [np.arange(len(table))]
    if track is not None:
        labels = labels_of(table, track).to_numpy()
        rows = [np.flatnonzero(labels == label) for label in dict.fromkeys(labels)]
    sort, unordered = _order(time, clock, epoch, rows)
    remarks += [*clock_doubts(time.column, time.format, clock, epoch), *standstill(time.column, clock, rows), unordered]
    if decimal == ",":
        remarks.append('Numbers are read with a decimal comma: decimal = ",".')
    moved = speeds(seen.place, clock, [r[np.argsort(clock[r], kind="stable")] for r in rows])
    pace = _round(float(np.quantile(moved, 0.9))) if len(moved) else 10.0
    remarks.append("Noises and priors are guesses: correct them.")
    head = [
        f"data = {quoted(path.name)}",
        *([f"table = {quoted(of_log)}"] if of_log else []),
        f"time = {_time(time)}",
        *([f"track = {quoted(track)}"] if track else []),
        *(['decimal = ","'] if decimal == "," else []),
        *(["sort = true"] if sort else []),
        'filters = ["EKF", "SRCKFB"]',
    ]
    x, y = seen.axes
    toml = (
        "\n".join(head)
        + f"""

[motion]
kind = "constant_velocity"
axes = ["{x}", "{y}"]
noise = {{ density = "{_density(pace)} m^2/s^3" }}

{seen.tables}
[prior]
{seen.prior or f'position_from = "{seen.sensor}"'}
v{x} = {{ mean = 0, std = "{pace:g} m/s" }}
v{y} = {{ mean = 0, std = "{pace:g} m/s" }}
"""
    )
    rank = (
        seen.guess,
        POSITION[0] not in seen.tables,
        not _RECEIVER.search(of_log),
        not seen.accurate,
        -len(table),
    )
    return _Ranked(Proposal(toml, tuple(filter(None, remarks))), seen.guess, rank)


def _table(table: Table) -> tuple[Table, str]:
    """The table, with a decimal comma where more columns are numbers so."""
    other = replace(table, decimal=",")
    numbers = [sum(has_numbers(t, n) for n in t.names) for t in (table, other)]
    return (other, ",") if numbers[1] > numbers[0] else (table, ".")


def _order(time: TimeRole, clock: np.ndarray, epoch: pd.Timestamp | None, rows: list[np.ndarray]) -> tuple[bool, str]:
    """Whether rows are to be sorted by time, and what is said of it.

    A time without a date that falls may be of the next day: only what is a little late is sorted.
    """
    fall = max((-np.diff(clock[r]).min(initial=0.0) for r in rows), default=0.0)
    if fall <= 0:
        return False, ""
    period = clock_period(time.format)
    passed = period and epoch is not None and any(clock_doubts(time.column, time.format, clock, epoch))
    if period and (passed or fall > period / 24):
        return False, (
            f"The time {time.column!r} has no date and falls by {fall:.6g} s: rows may be out of order, or of another "
            "day. Write dates, or sort = true if the rows are of one day."
        )
    if not period and fall > _DAY / 2 and clock.min() >= 0 and clock.max() <= _DAY + 1:
        return False, (
            f"The time {time.column!r} falls by {fall:.6g} s, as one that counts from midnight does on the next day; "
            "let it count on, or write sort = true if rows are out of order."
        )
    return True, "Rows are not in the order of time; sort = true puts them so."


def _time(time: TimeRole) -> str:
    if time.format:
        return f"{{ column = {quoted(time.column)}, format = {quoted(time.format)} }}"
    return (
        quoted(time.column) if time.unit in ("", "s") else f'{{ column = {quoted(time.column)}, unit = "{time.unit}" }}'
    )


def _density(pace: float) -> str:
    """A target of this pace turns so much."""
    return "1" if pace > 30 else "0.1" if pace > 3 else "0.01"


def _round(value: float) -> float:
    """The next of 1, 2, 5, 10 and so on."""
    if not value > 0 or not math.isfinite(value):
        return 1.0
    scale = 10.0 ** math.floor(math.log10(value))
    return float(next(f * scale for f in (1, 2, 5, 10) if f * scale >= value * 0.999))
