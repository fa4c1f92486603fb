"""Which columns of a table measure positions, as tables of a description: places on the earth, polar or plane ones."""

import math
import re
from typing import NamedTuple

import numpy as np

from sigmax.descriptions.local import FARTHEST, POSITION, VELOCITY, distance, origin_of, with_local
from sigmax.errors import InputError
from sigmax.files.description import Column, LocalPart
from sigmax.files.table import Table, grouped_hint, is_grouped
from sigmax.files.units import ANGLE, LENGTH, is_unit_of, to_si
from sigmax.proposals.accuracies import accuracies
from sigmax.proposals.roles import TimeRole, base_and_unit, has_numbers, named
from sigmax.proposals.speed_and_course import speed_and_course

# What the Automatic Identification System sends where it does not know: ITU-R M.1371, table 48.
_UNKNOWN = {"latitude": 91.0, "longitude": 181.0, "speed": 102.3, "course": 360.0}
_BEACONS = r"(range|rng|dist(ance)?|d|r|tof|anchor|beacon|uwb)_?[a-z]?\d+(_(range|dist(ance)?))?|range|dist(ance)?"


class Seen(NamedTuple):
    """What measures positions: tables of the TOML, the state it needs, and places (T, 2) to judge tracks by.

    Without a prior of the position it comes from the sensor. A guess rests on no name; what is accurate says in each
    row how accurate it is.
    """

    tables: str
    axes: tuple[str, str]
    place: np.ndarray
    remarks: tuple[str, ...]
    columns: tuple[str, ...]
    sensor: str
    prior: str = ""
    guess: bool = False
    accurate: bool = False


def geodetic(table: Table, clock: np.ndarray, time: TimeRole, track: str | None) -> Seen | None:
    """Latitude and longitude, with speed and course where they agree with them; None where there are none.

    Raises:
        InputError: where they are not in degrees.
    """
    taken = (time.column, track)
    found = [named(table, role, taken) for role in ("latitude", "longitude")]
    if not found[0] or not found[1]:
        return None
    lat, lon = (_degrees(table, names[0], role) for names, role in zip(found, ("latitude", "longitude"), strict=True))
    part, remarks = _local(table, lat, lon)
    place = with_local(table, part).columns[list(POSITION)].to_numpy(float)
    used = [lat.column, lon.column]
    velocity, said = speed_and_course(table, clock, part, place, track, (*taken, *used))
    noise, accurate = accuracies(table, ("east", "north"), place, (*taken, *used))
    sensors = _position("report", ("east", "north"), tuple(map(quoted, POSITION)), "10 m", noise)
    used += [column.column for column in noise]
    if velocity is not None:
        part = part.model_copy(update=dict(zip(("speed", "course"), velocity, strict=True)))
        used += [column.column for column in velocity]
        sensors += (
            '\n[sensors.velocity]\nkind = "velocity"\n'
            f"columns = {{ veast = {quoted(VELOCITY[0])}, vnorth = {quoted(VELOCITY[1])} }}\n"
            'noise = { veast = "1 m/s", vnorth = "1 m/s" }\n'
        )
    told = (*remarks, said, accurate)
    shown = f"{_shown(part)}\n{sensors}"
    return Seen(shown, ("east", "north"), place, told, tuple(used), "report", accurate=bool(noise))


def _local(table: Table, lat: Column, lon: Column) -> tuple[LocalPart, list[str]]:
    """The plane at the first place, or where most are in the middle of them, and what is said of it."""
    latitude, longitude = (c.numbers(table) * to_si(c.unit, ANGLE, c.column) for c in (lat, lon))
    origin, which = origin_of(LocalPart(latitude=lat, longitude=lon), latitude, longitude), "the first place"
    if np.nanmedian(distance(latitude, longitude, origin)) > FARTHEST:
        origin, which = (float(np.nanmedian(latitude)), float(np.nanmedian(longitude))), "the median of all places"
    shown = [f"{math.degrees(v):.7f} deg" for v in origin]
    far = int((distance(latitude, longitude, origin) > FARTHEST).sum())
    within = f"{FARTHEST / 1e3:.0f} km" if far else None
    remarks = [
        f"{lat.column!r} and {lon.column!r} are taken for latitude and longitude in {lat.unit}: they become metres "
        f"east and north of {which}, {shown[0]}, {shown[1]} (WGS84)."
    ]
    if far:
        remarks.append(
            f"{far} of {len(table)} rows lie farther than {within} from there, too far for one plane, and count as not "
            "measured; split the file by region if they are meant."
        )
    return LocalPart(latitude=lat, longitude=lon, origin=list(shown), within=within), remarks


def _shown(part: LocalPart) -> str:
    """The table [local] as TOML."""
    lines = ["[local]", f"latitude = {column_toml(part.latitude)}", f"longitude = {column_toml(part.longitude)}"]
    lines += [f"origin = [{', '.join(map(quoted, part.origin))}]"] if part.origin else []
    lines += [f"within = {quoted(part.within)}"] if part.within else []
    lines += [f"speed = {column_toml(part.speed)}"] if part.speed else []
    lines += [f"course = {column_toml(part.course)}"] if part.course else []
    return "\n".join(lines) + "\n"


def _degrees(table: Table, name: str, role: str) -> Column:
    """A column of latitudes or longitudes, with its unit and what means that there is none.

    Raises:
        InputError: where the numbers are of neither unit.
    """
    values = table.numbers(name)
    unknown = _UNKNOWN[role]
    missing = [unknown] if (values == unknown).any() else []
    most = float(np.nanmax(np.abs(np.where(values == unknown, 0, values))))
    if most > (90 if role == "latitude" else 360):
        raise InputError(
            f"{table.path.name}: {name!r} goes up to {most:.10g}, which is no {role} in degrees; convert it first "
            "(52°30.5' are 52.5083 degrees, 525083333 in units of 1e-7 degrees are 52.5083333)"
        )
    return Column(
        column=name, unit=base_and_unit(name)[1] if base_and_unit(name)[1] == "rad" else "deg", missing=missing
    )


def polar(table: Table, time: TimeRole, track: str | None) -> Seen | None:
    """Range and azimuth of a radar; None where there are none."""
    ranges, azimuths = (named(table, role, (time.column, track)) for role in ("range", "azimuth"))
    if not ranges or not azimuths:
        return None
    reach, angle = ranges[0], azimuths[0]
    told = base_and_unit(reach)[1], base_and_unit(angle)[1]
    length = told[0] if is_unit_of(told[0], LENGTH) else "m"
    values = table.numbers(angle)
    turn = told[1] if is_unit_of(told[1], ANGLE) else "deg" if np.nanmax(np.abs(values)) > 6.4 else "rad"
    r, a = table.numbers(reach) * to_si(length, LENGTH, reach), values * to_si(turn, ANGLE, angle)
    shown = [column_toml(Column(column=n, unit=u)) for n, u in ((reach, length), (angle, turn))]
    columns = f"range = {shown[0]}, azimuth = {shown[1]}"
    tables = (
        f'[sensors.radar]\nkind = "range_azimuth"\ncolumns = {{ {columns} }}\n'
        'noise = { range = "50 m", azimuth = "0.5 deg" }\n'
    )
    remark = (
        f"{reach!r} in {length} and {angle!r} in {turn} are taken for range and azimuth, clockwise from north, of a "
        "radar at the origin."
    )
    if not is_unit_of(told[1], ANGLE) and turn == "rad":
        remark += f" {angle!r} never exceeds 2π, but may be in degrees all the same: see to its unit."
    place = np.column_stack([r * np.cos(a), r * np.sin(a)])
    return Seen(tables, ("north", "east"), place, (remark,), (reach, angle), "radar")


def plane(table: Table, time: TimeRole, track: str | None) -> Seen:
    """Two coordinates by their names, else the first two columns of numbers.

    Raises:
        InputError: where there are no two columns of numbers.
    """
    taken = (time.column, track)
    found = [named(table, role, taken) for role in ("x", "y")]
    remark = ""
    if found[0] and found[1]:
        x, y = found[0][0], found[1][0]
    else:
        rest = [n for n in table.names if n not in taken and has_numbers(table, n)]
        ranges = [n for n in rest if re.fullmatch(_BEACONS, base_and_unit(n)[0])]
        if ranges:
            columns = f"columns = {{ range = {quoted(ranges[0])} }}"
            what = "looks like a distance to a beacon" if len(ranges) == 1 else "look like distances to beacons"
            raise InputError(
                f"{table.path.name}: {', '.join(map(repr, ranges))} {what}. Where these stand is not in the table, so "
                "that there is no proposal; describe each as a sensor: [sensors.first] "
                f'kind = "range_only", origin = ["1 m", "2 m"], {columns}, noise = {{ range = "30 cm" }}'
            )
        if len(rest) < 2:
            raise InputError(
                f"{table.path.name}: beside the time {time.column!r} two columns of numbers are the least; it has "
                f"{', '.join(rest) or 'none'}{_thousands(table, taken)}"
            )
        x, y = rest[:2]
        remark = f"No columns are called x and y: {x!r} and {y!r} are taken for a position. See to it."
    told = [base_and_unit(name)[1] for name in (x, y)]
    units = [unit if is_unit_of(unit, LENGTH) else "m" for unit in told]
    place = np.column_stack([table.numbers(n) * to_si(u, LENGTH, n) for n, u in zip((x, y), units, strict=True)])
    shown = tuple(column_toml(Column(column=n, unit=u)) for n, u in zip((x, y), units, strict=True))
    words = remark or f"{x!r} and {y!r} are taken for a position in {units[0]}."
    noise, accurate = accuracies(table, ("x", "y"), place, (*taken, x, y))
    sensor = _position("position", ("x", "y"), shown, "1 m", noise)
    used = (x, y, *(column.column for column in noise))
    return Seen(
        sensor, ("x", "y"), place, (words, accurate), used, "position", guess=bool(remark), accurate=bool(noise)
    )


def _thousands(table: Table, but: tuple[str | None, ...]) -> str:
    """A hint at numbers with a sign between thousands, quoted, as no number has one here."""
    for name in table.names:
        text = table.column(name).astype("string").str.strip() if name not in but else None
        found = None if text is None else next((v for v in text.dropna() if is_grouped(v)), None)
        if found is not None:
            return f"; {name!r} has {found!r}{grouped_hint(found)}"
    return ""


def _position(
    name: str, axes: tuple[str, str], columns: tuple[str, ...], guess: str, noise: tuple[Column, ...] = ()
) -> str:
    x, y = axes
    of_x, of_y = (column_toml(noise[0]), column_toml(noise[-1])) if noise else (quoted(guess), quoted(guess))
    return (
        f'[sensors.{name}]\nkind = "position"\ncolumns = {{ {x} = {columns[0]}, {y} = {columns[1]} }}\n'
        f"noise = {{ {x} = {of_x}, {y} = {of_y} }}\n"
    )


def column_toml(column: Column) -> str:
    """A column with its unit as TOML has it."""
    missing = f", missing = {column.missing[0]:g}" if column.missing else ""
    return f'{{ column = {quoted(column.column)}, unit = "{column.unit}"{missing} }}'


def quoted(text: str) -> str:
    """A text as TOML has it."""
    escaped = "".join(
        f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else f"\\{c}" if c in '"\\' else c for c in text
    )
    return f'"{escaped}"'
