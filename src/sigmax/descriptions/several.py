"""Several tables with clocks of their own as one, in the order of time: [tables.NAME] of a description."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.descriptions.local import frame_of, with_local
from sigmax.errors import InputError
from sigmax.files.description import Description, TimeColumn
from sigmax.files.frame import Frame
from sigmax.files.read_table import Logs, data_of, read_table
from sigmax.files.table import Table
from sigmax.files.units import TIME, quantity

# The column of times of what was joined.
_TIME = "tables.time"
Instants = Callable[[Table, TimeColumn], tuple[np.ndarray, pd.Timestamp | None]]
Ordered = Callable[[Table, str | None, np.ndarray, bool], Any]


def read_data(
    description: Description, folder: Path, instants: Instants, ordered: Ordered
) -> tuple[Description, Table, Frame | None]:
    """The data of a description as one table, the description of that table, and where its metres lie.

    Columns of other tables are called `NAME.column`. A row of theirs has nothing of the others but the inputs of the
    motion, which are those of the interval that it divides. Rows that tell the truth alone count between the first and
    the last of the others.

    Args:
        description: of the data.
        folder: where the files lie.
        instants: what gives the times of a table.
        ordered: what refuses rows that are not in order.

    Raises:
        InputError: for whatever is missing or does not fit.
    """
    # Tables of one log come from one reading of it.
    logs: Logs = {}
    table = data_of(description, folder, logs=logs)
    frame = None if description.local is None else frame_of(description.local, table)
    first = with_local(table, description.local, frame)
    if not description.tables:
        return description, first, frame
    time, epoch = instants(first, description.time)
    ordered(first, description.track, time, description.sort)
    pieces, times, sources = [first.columns], [time], [first]
    of_truth = [np.zeros(len(first), bool)]
    notes = list(table.notes)
    for name, part in description.tables.items():
        where = f"tables.{name}"
        if "." in name:
            raise InputError(f"{where}: a name of a table has no point in it")
        other = read_table(
            folder / (part.data or description.data),
            table=part.table,
            decimal=description.decimal,
            header=part.header,
            logs=logs,
        )
        notes += [note for note in other.notes if note not in notes]
        if part.local is not None:
            own_frame = frame_of(part.local, other) if frame is None or part.local.origin is not None else frame
            frame = frame or own_frame
            if own_frame != frame:
                raise InputError(
                    f"{where}.local: all tables of a record have one frame, {frame.name} ({_place(frame)}), not "
                    f"{own_frame.name} ({_place(own_frame)}): leave origin and frame out"
                )
            other = with_local(other, part.local, own_frame)
        own, began = instants(other, part.time)
        if (began is None) != (epoch is None):
            raise InputError(f"{where}.time counts otherwise than time: both are dates, or both are numbers")
        if (part.track is None) != (description.track is None):
            raise InputError(f"{where}.track: both tables tell tracks apart, or none does")
        ordered(other, part.track, own, description.sort)
        own = own - quantity(part.ahead, TIME, f"{where}.ahead")
        if began is not None and epoch is not None:
            own = own + (began - epoch).total_seconds()
        named = other.columns.set_axis([f"{name}.{column}" for column in other.names], axis=1)
        if part.track is not None and description.track is not None:
            named[description.track] = other.column(part.track).astype("string").str.strip()
        pieces.append(named)
        times.append(own)
        sources.append(other)
        of_truth.append(np.full(len(other), _only_truth(description, name)))
    if description.track is not None:
        who = table.column(description.track).astype("string").str.strip()
        pieces[0] = pieces[0].assign(**{description.track: who})
    # What differs by less than a nanosecond is at the same time, and in the order of the tables.
    moments, alone = np.round(np.concatenate(times), 9), np.concatenate(of_truth)
    order = np.argsort(moments, kind="stable")
    inside = ~alone[order]
    span = moments[order][inside]
    order = order[inside | ((moments[order] >= span.min()) & (moments[order] <= span.max()))]
    joined = pd.concat(pieces, ignore_index=True).iloc[order].reset_index(drop=True)
    table_of = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])[order]
    row_of = np.concatenate([np.arange(len(piece)) for piece in pieces])[order]
    names = ["", *description.tables]
    for column in _of_motion(description):
        if column in joined:
            its = next((k for k, name in enumerate(names) if name and column.startswith(f"{name}.")), 0)
            series = joined[column] if description.track is None else joined.groupby(description.track)[column]
            joined[column] = joined[column].where(table_of == its, series.bfill())
    seconds = moments[order]
    nanoseconds = pd.to_timedelta(np.round(seconds * 1e9).astype("int64"), unit="ns")
    joined[_TIME] = seconds if epoch is None else epoch + nanoseconds

    def label(index: int) -> str:
        source = sources[table_of[index]]
        return f"{source.row(int(row_of[index]))} of {source.path.name}"

    whole = replace(first, columns=joined, first_row=1, left_out=(), notes=tuple(notes), label=label)
    given = description.model_copy(update={"time": TimeColumn(column=_TIME), "sort": False})
    return given, whole, frame


def _of_motion(description: Description) -> set[str]:
    """Columns that drive the motion."""
    motions = [*description.motion, *(m for mode in description.modes.values() for m in mode.motion)]
    return {column.column for motion in motions for column in motion.inputs.values()}


def _only_truth(description: Description, name: str) -> bool:
    """Whether of a table nothing is taken but the truth."""
    used = repr([sensor.model_dump() for sensor in description.sensors.values()])
    return f"'{name}." not in used and not any(column.startswith(f"{name}.") for column in _of_motion(description))


def _place(frame: Frame) -> str:
    """The origin of a frame in words."""
    latitude, longitude, *height = frame.origin
    above = f", {height[0]:g} m" if height else ""
    return f"{math.degrees(latitude):.6f} deg, {math.degrees(longitude):.6f} deg{above}"
