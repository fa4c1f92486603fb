"""Descriptions with one value exchanged for another: a generator of what people may write."""

import datetime
import json
import math
from collections.abc import Iterator
from typing import Any

# Of every kind that TOML has, with the ends of each.
VALUES: tuple[Any, ...] = (
    "", " ", "x", "ü\n\"'", "1 m", "-1", "nan", "1e999 m", "../x", "a" * 3000, "x.py:f", "1/0 m", "µm", "EKF",
    0, 1, -1, 2**62, 10**30, 0.0, -0.0, 0.5, -2.5, 1e308, 5e-324, math.nan, math.inf, -math.inf, True, False,
    [], [0], [1, 2], ["x"], [""], [[1.0]], [[1, 2], [3]], [[]], [True], [math.nan], [{}], [["a"]],
    {}, {"x": 1}, {"column": "t"}, {"mean": 0, "std": 1}, {"": {}}, {"x": {"y": []}},
    datetime.datetime(2024, 5, 1, tzinfo=datetime.UTC), datetime.date(2024, 5, 1), datetime.time(12, 0),
)  # fmt: skip
_GONE = object()


def written(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {written(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(written, value)) + "]"
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else f"{value}"
    return json.dumps(value)


def document(table: dict[str, Any]) -> str:
    """A table as a TOML document of inline values."""
    return "".join(f"{json.dumps(k)} = {written(v)}\n" for k, v in table.items())


def places(table: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value, inner ones after those they are in."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        yield (*above, key)
        yield from places(value, (*above, key))


def exchanged(table: Any, place: tuple[Any, ...], value: Any) -> Any:
    """A copy with another value at a place, or without it."""
    key, *rest = place
    copy = dict(table) if isinstance(table, dict) else list(table)
    if rest:
        copy[key] = exchanged(table[key], tuple(rest), value)
    elif value is _GONE:
        del copy[key]
    else:
        copy[key] = value
    return copy


def neighbours(table: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """All tables that differ in one place: another value, none, or a key more."""
    for place in places(table):
        for value in VALUES:
            yield f"{'.'.join(map(str, place))} = {str(value)[:40]!r}", exchanged(table, place, value)
        yield f"{'.'.join(map(str, place))} left out", exchanged(table, place, _GONE)
    for place in ((), *places(table)):
        inner = table
        for key in place:
            inner = inner[key]
        if isinstance(inner, dict):
            yield f"{'.'.join(map(str, place))} with a key more", exchanged(table, (*place, "extra"), 1)
