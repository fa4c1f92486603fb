"""Numbers of a line of JSON in SI: columns, units, what means that there is none, places on the earth."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import orjson

from sigmax.descriptions.local import DOWN, FARTHEST, POSITION, UP, VELOCITY, distance, frame_among
from sigmax.errors import InputError
from sigmax.files.description import Column, LocalPart
from sigmax.files.units import ANGLE, LENGTH, NUMBER, SPEED, parse_unit, quantity, to_si

_PLAIN = {int, float, type(None)}


class FeedColumn(NamedTuple):
    """A key of a line, the factor to SI, and numbers that mean none."""

    name: str
    factor: float
    missing: tuple[float, ...] = ()


def with_nan(line: bytes, error: orjson.JSONDecodeError) -> Any:
    """What a line says that has NaN in it, as Python and others write it though JSON has none.

    Raises:
        InputError: for any other line that is no JSON.
    """
    if b"NaN" in line:
        try:
            # Whole numbers of any length become floats, and infinity in the end, which is refused.
            return json.loads(line, parse_int=lambda digits: int(digits) if len(digits) < 19 else float(digits))
        except (ValueError, RecursionError):
            # The other reader knows better what is wrong.
            pass
    raise InputError(f"no JSON: {error}") from error


def feed_column(column: Column, dimension: Any, where: str) -> FeedColumn:
    """A column of a description as a key of lines.

    Raises:
        InputError: for a unit of something else.
    """
    return FeedColumn(column.column, _factor(column.unit, dimension, where), tuple(column.missing))


def _factor(unit: str, dimension: Any, where: str) -> float:
    if dimension is not None:
        return to_si(unit, dimension, where)
    return parse_unit(unit, where)[0] if unit.strip() else to_si("", NUMBER, where)


def numbers_of(row: Mapping[str, Any], wanted: Sequence[FeedColumn]) -> np.ndarray:
    """In SI, of one row; NaN where there is none.

    Raises:
        InputError: for what is no number, or beyond all measure.
    """
    return np.array([number_of(row.get(c.name), c) for c in wanted])


def column_of(rows: Sequence[Mapping[str, Any]], column: FeedColumn) -> np.ndarray:
    """In SI, of many rows: all at once where nothing is unusual, for there may be ten thousand.

    Raises:
        InputError: for what is no number, or beyond all measure.
    """
    given = [row.get(column.name) for row in rows]
    if set(map(type, given)) <= _PLAIN:
        # None becomes NaN.
        plain = np.array(given, float)
        values = np.where(np.isin(plain, column.missing), np.nan, plain) * column.factor
        if not (np.abs(values) >= 1e15).any():
            return values
    return np.array([number_of(value, column) for value in given], float)


def number_of(given: Any, column: FeedColumn) -> float:
    """In SI; NaN where there is none.

    Raises:
        InputError: for what is no number, or beyond all measure.
    """
    if given is None:
        return math.nan
    if not isinstance(given, int | float) or isinstance(given, bool):
        raise InputError(f"{column.name}: {str(given)[:50]!r} is no number")
    if given != given or given in column.missing:
        return math.nan
    value = float(given) * column.factor
    if not abs(value) < 1e15:
        raise InputError(f"{column.name}: {given} is beyond all measure")
    return value


class LocalRows:
    """Adds the columns of a table [local] to the rows of a feed.

    Raises:
        InputError: without an origin, for a feed has no first place to begin with.
    """

    def __init__(self, part: LocalPart) -> None:
        if part.origin is None:
            raise InputError('local.origin = ["52.1 deg", "4.3 deg"] is needed in a feed')
        self._frame = frame_among(part, np.empty(0), np.empty(0))
        self._within = FARTHEST if part.within is None else quantity(part.within, LENGTH, "local.within")
        wanted = [(part.latitude, ANGLE, "latitude"), (part.longitude, ANGLE, "longitude")]
        wanted += [] if part.height is None else [(part.height, LENGTH, "height")]
        if part.speed is not None and part.course is not None:
            wanted += [(part.speed, SPEED, "speed"), (part.course, ANGLE, "course")]
        self._columns = [feed_column(column, dimension, f"local.{name}") for column, dimension, name in wanted]

    def row(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """The row with metres east and north, and up and down where there are heights.

        Raises:
            InputError: for a latitude or longitude that is none.
        """
        values = numbers_of(row, self._columns)
        if abs(values[0]) > math.pi / 2 or abs(values[1]) > 2 * math.pi:
            raise InputError(f"{self._columns[0].name}, {self._columns[1].name}: this is no place on the earth")
        k = len(self._frame.origin)
        places, rest = values[None, :k], values[k:]
        far = not distance(places[:, 0], places[:, 1], self._frame.origin[:2])[0] <= self._within
        east, north, *up = self._frame.positions(places)[0].tolist()
        more = dict(zip(POSITION, (east, north), strict=True))
        if up:
            more |= {UP: up[0], DOWN: -up[0]}
        if len(rest):
            velocity = self._frame.velocity(rest[:1], rest[1:], places)[0]
            more |= dict(zip(VELOCITY, velocity.tolist(), strict=True))
        return {**row, **(dict.fromkeys(more) if far else more)}
