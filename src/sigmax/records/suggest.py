"""A first description for a file of data, made from the names of its columns."""

import re
from pathlib import Path

import pandas as pd

from sigmax.errors import InputError
from sigmax.records.table import Table, read_table

_TIME = re.compile(r"^(t|time|timestamp|date|datetime|seconds?|utc)(\b|_|$)", re.IGNORECASE)
_TRACK = re.compile(r"^(track|id|target|object|mmsi|icao)", re.IGNORECASE)


def description_for(path: Path) -> str:
    """A minimal TOML: constant velocity, a position seen in the two columns most likely to be one.

    Raises:
        InputError: where the file cannot be read or has fewer than three columns.
    """
    table = read_table(path)
    names = [str(name) for name in table.columns]
    if len(names) < 3:
        raise InputError(f"{path.name} has the columns {', '.join(names)}; a time and two measured ones are the least")
    time = next((n for n in names if _TIME.match(n)), names[0])
    track = next((n for n in names if _TRACK.match(n) and n != time), None)
    rest = [n for n in names if n not in (time, track) and _is_number(table, n)]
    rest = rest if len(rest) > 1 else [n for n in names if n != time]
    x = next((n for n in rest if re.match(r"^(x|e|east)", n, re.IGNORECASE)), rest[0])
    y = next(
        (n for n in rest if re.match(r"^(y|n|north)", n, re.IGNORECASE) and n != x), next(n for n in rest if n != x)
    )
    by_track = f"track = {_quoted(track)}\n" if track else ""
    return f"""data = {_quoted(path.name)}
time = {_quoted(time)}
{by_track}filters = ["EKF", "SRCKFB"]

[motion]
kind = "constant_velocity"
noise = {{ density = "1 m^2/s^3" }}

[sensors.position]
kind = "position"
columns = {{ x = {{ column = {_quoted(x)}, unit = "m" }}, y = {{ column = {_quoted(y)}, unit = "m" }} }}
noise = {{ x = "1 m", y = "1 m" }}

[prior]
position_from = "position"
vx = {{ mean = 0, std = "10 m/s" }}
vy = {{ mean = 0, std = "10 m/s" }}
"""


def _is_number(table: Table, name: str) -> bool:
    try:
        return bool(pd.notna(table.numbers(name)).any())
    except InputError:
        return False


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
