"""Landmarks by their names: a table of where they stand, and a column that says which one was seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.files.description import Column, Description
from sigmax.files.read_table import read_table
from sigmax.files.table import Table
from sigmax.files.units import LENGTH, to_si

# The kinds that see landmarks, with their inputs.
_SEEN_BY = ("range_only", "range_bearing")


def with_landmark_inputs(description: Description) -> Description:
    """The description whose sensors of landmarks take their places as inputs.

    Raises:
        InputError: for a sensor that sees none, or places given twice.
    """
    sensors = dict(description.sensors)
    for name, part in sensors.items():
        if part.landmark is None:
            continue
        where = f"sensors.{name}.landmark"
        if description.landmarks is None:
            raise InputError(
                f'{where}: a table [landmarks] is needed, that says where they stand: data = "…", id = "…"'
            )
        if part.kind not in _SEEN_BY:
            raise InputError(f"{where}: {part.kind} sees no landmarks; {' and '.join(_SEEN_BY)} do")
        if part.inputs or part.origin is not None:
            raise InputError(f"{where}: the place comes from [landmarks]; drop the inputs and the origin")
        inputs = {f"beacon_{axis}": Column(column=f"landmark.{name}.{axis}") for axis in description.landmarks.axes}
        sensors[name] = part.model_copy(update={"inputs": inputs})
    return description.model_copy(update={"sensors": sensors})


def with_landmarks(
    description: Description, table: Table, folder: Path
) -> tuple[Table, dict[str, tuple[float, float]]]:
    """The table with the place of the landmark that each row saw, and the landmarks by name.

    Raises:
        InputError: for a landmark that is not known or has two places, and whatever else does not fit.
    """
    part = description.landmarks
    if part is None:
        return table, {}
    found = read_table(folder / part.data, decimal=description.decimal)
    ids = _names(found, part.id)
    places = np.column_stack([c.numbers(found) * to_si(c.unit, LENGTH, f"landmarks.{a}") for a, c in part.axes.items()])
    bad = np.isnan(places).any(1)
    if bad.any() or len(set(ids)) < len(ids):
        which = ids[int(np.flatnonzero(bad)[0])] if bad.any() else next(i for i in ids if ids.count(i) > 1)
        raise InputError(f"{found.path.name}: the landmark {which!r} has {'no place' if bad.any() else 'two rows'}")
    by_name = dict(zip(ids, places, strict=True))
    more: dict[str, np.ndarray] = {}
    for name, sensor in description.sensors.items():
        if sensor.landmark is None:
            continue
        seen = _names(table, sensor.landmark)
        for k, one in enumerate(seen):
            if one and one not in by_name:
                raise InputError(f"{table.path.name}, row {table.row(k)}: {unknown('landmark', one, by_name)}")
        nowhere = np.full(len(part.axes), np.nan)
        at = np.array([by_name.get(one, nowhere) for one in seen])
        more |= {f"landmark.{name}.{axis}": at[:, k] for k, axis in enumerate(part.axes)}
    shown = {name: (float(place[0]), float(place[1])) for name, place in by_name.items()}
    return replace(table, columns=table.columns.assign(**more)), shown


def _names(table: Table, column: str) -> list[str]:
    """Names as text, whole numbers without a point, "" where there is none."""
    text = table.column(column).astype("string").str.strip().fillna("")
    return [str(name).removesuffix(".0") for name in text]
