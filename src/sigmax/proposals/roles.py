"""Which column of a table is the time, which tells tracks apart, which are positions: by names and by numbers."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pandas as pd

from sigmax.errors import InputError
from sigmax.files.table import Table
from sigmax.proposals.column_meanings import epoch_unit, labels_of

_UNITS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **{name: name for name in ("km", "cm", "mm", "ft", "nmi", "rad", "deg", "ms", "us", "ns", "s", "min", "kn")},
    **dict.fromkeys(("feet", "foot"), "ft"),
    **dict.fromkeys(("degree", "degrees"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("kt", "kts", "knot", "knots"), "kn"),
    **dict.fromkeys(("kmh", "kph"), "km/h"),
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("msec", "millis", "milliseconds"), "ms"),
    "mps": "m/s",
    "nm": "nmi",
    "mph": "mph",
}
_NAMES = {
    "time": r"(base|gps|utc|unix|sample|elapsed|measurement|record|rx|server)?_?"
    r"(date_?time|time_?stamp|time|date|epoch|t|ts|utc|seconds?)(_(utc|gps|stamp|unix|epoch|of.*))?",
    "latitude": r"(.*_)?lat(itude)?",
    "longitude": r"(.*_)?(lon|lng|long|longitude)",
    "x": r"(pos(ition)?_?)?(x|east|easting|e)(_?pos(ition)?)?|p_?x|local_x|utm_(x|e|east|easting)|"
    r"(.*_)?(position|point|translation)_x",
    "y": r"(pos(ition)?_?)?(y|north|northing|n)(_?pos(ition)?)?|p_?y|local_y|utm_(y|n|north|northing)|"
    r"(.*_)?(position|point|translation)_y",
    "speed": r"sog|(ground_?)?(speed|velocity|spd)(_over_ground)?|gs|vel",
    "course": r"cog|course(_over_ground)?|track(_?angle)?|true_track|(true_)?heading|hdg|trk",
    "range": r"(slant_|measured_)?(range|rng|rho|dist(ance)?)|r",
    "azimuth": r"az(im(uth)?)?|bearing|brg|theta",
}
# In this order: what names a target in the world before what a program called it.
_TRACKS = (
    r"mmsi|icao_?24|icao(_address)?|hex(_?ident)?|mode_?s",
    r"(track|target|object|obj|vessel|ship|tag|device|vehicle|aircraft|flight|agent|sensor_track|traj(ectory)?)"
    r"_?(id|no|nr|num|number|idx|index|ident|identifier|name)",
    r"id|uid|uuid|imo|ident|identifier",
    r"call_?sign|flight|tag|device|aircraft|vehicle|vessel|ship|target|object|track|traj(ectory)?|tail|registration",
    r"name",
)
_FORMATS = (
    "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%d-%m-%Y %H:%M:%S",
    "%d/%m/%Y %H:%M", "%m/%d/%Y %H:%M", "%d.%m.%Y %H:%M", "%m/%d/%Y %I:%M:%S %p", "%a %b %d %H:%M:%S %Y",
    "%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f",
    "%Y%m%d %H:%M:%S", "%H:%M:%S", "%H:%M:%S.%f",
)  # fmt: skip


class TimeRole(NamedTuple):
    """The column of times, its unit where it counts, its format where dates are not written as in ISO 8601."""

    column: str
    unit: str
    format: str
    remark: str


def base_and_unit(name: str) -> tuple[str, str]:
    """A name in small letters with underscores, without the unit that it ends with, and that unit."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name.strip().lstrip("#").strip())
    plain = re.sub(r"(?<=_)m_s$", "mps", parted.casefold().replace("m/s", "mps").replace("km/h", "kmh"))
    words = [word for word in re.split(r"[^a-z0-9]+", plain) if word]
    if len(words) > 1 and words[-1] in _UNITS:
        return "_".join(words[:-1]), _UNITS[words[-1]]
    return "_".join(words), ""


def named(table: Table, role: str, but: Iterable[str | None] = ()) -> list[str]:
    """The columns of numbers whose name fits a role, best first."""
    found = [c for c in table.names if c not in but and re.fullmatch(_NAMES[role], base_and_unit(c)[0])]
    numbers = [c for c in found if has_numbers(table, c)]
    # A heading is where the bow points; a course is where the target goes.
    return sorted(numbers, key=lambda c: (base_and_unit(c)[0].startswith(("heading", "hdg", "true_h")), len(c) > 20))


def has_numbers(table: Table, name: str) -> bool:
    """Whether a column holds numbers, at least one."""
    try:
        return bool(np.isfinite(table.numbers(name)).any())
    except InputError:
        return False


def time_of(table: Table) -> TimeRole:
    """The column of the time.

    Raises:
        InputError: where none looks like one.
    """
    for name in table.names:
        if re.fullmatch(_NAMES["time"], base_and_unit(name)[0]) and (found := _time(table, name)) is not None:
            return found
    first = table.names[0]
    found = _time(table, first)
    if found is None:
        raise InputError(f"{table.path.name}: none of the columns {', '.join(table.names)} looks like a time")
    remark = f"No column is called time; the first, {first!r}, is taken for it."
    return found._replace(remark=" ".join(filter(None, [remark, found.remark])))


def _time(table: Table, name: str) -> TimeRole | None:
    series = table.column(name)
    if pd.api.types.is_datetime64_any_dtype(series) or pd.api.types.is_timedelta64_dtype(series):
        return TimeRole(name, "", "", "")
    if has_numbers(table, name):
        largest = float(np.nanmax(np.abs(table.numbers(name))))
        named_unit = base_and_unit(name)[1]
        unit = named_unit if named_unit in ("ms", "us", "ns", "s", "min") else ""
        if not unit and largest > 1e8:
            unit = epoch_unit(largest)
            return TimeRole(name, unit, "", f"{name!r} is taken for a count since 1970 in {unit}, by its size.")
        return TimeRole(name, unit or "s", "", "" if unit else f"{name!r} is taken to count seconds.")
    text = series.astype("string").str.strip()
    if pd.to_datetime(text, errors="coerce", utc=True, format="ISO8601").notna().all():
        return TimeRole(name, "", "", "")
    fit = [f for f in _FORMATS if pd.to_datetime(text, errors="coerce", utc=True, format=f).notna().all()]
    if not fit:
        return None
    first, *others = fit
    twin = first.replace("%d/%m", "%m/%d")
    unsure = twin in others and first != twin
    remark = f"Dates are read as {first}; they could as well be {twin}: see to it." if unsure else ""
    return TimeRole(name, "", first, remark)


def track_of(table: Table, but: Iterable[str | None]) -> str | None:
    """The column that tells tracks apart by its name; None where there is none."""
    for pattern in _TRACKS:
        for name in table.names:
            if name in but or not re.fullmatch(pattern, base_and_unit(name)[0]):
                continue
            labels = labels_of(table, name)
            distinct = labels.nunique()
            # What is different in every row numbers rows; what has fractions measures.
            if labels.isna().any() or distinct == 0 or (distinct == len(labels) > 3) or _has_fractions(table, name):
                continue
            return name
    return None


def _has_fractions(table: Table, name: str) -> bool:
    try:
        values = table.numbers(name)
    except InputError:
        return False
    return bool((values[np.isfinite(values)] % 1 != 0).any())
