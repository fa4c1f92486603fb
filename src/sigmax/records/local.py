"""The table [local] of a description: latitude and longitude become columns in metres east and north."""

import math
from dataclasses import replace

import numpy as np

from sigmax.errors import InputError
from sigmax.models.earth import local_velocity, to_local
from sigmax.records.description import Column, LocalPart
from sigmax.records.table import Table
from sigmax.records.units import ANGLE, LENGTH, SPEED, quantity, to_si

POSITION = ("local.east", "local.north")
VELOCITY = ("local.velocity_east", "local.velocity_north")
# Beyond it the plane shortens lengths by more than a hundredth.
FARTHEST, _EARTH = 900e3, 6371e3


def with_local(table: Table, part: LocalPart | None) -> Table:
    """The table with the columns local.east and local.north, and those of the velocity where a speed is described.

    Raises:
        InputError: for latitudes and longitudes that are none, or lie too far from the origin for one plane.
    """
    if part is None:
        return table
    numbers = {name: _angles(table, getattr(part, name), name) for name in ("latitude", "longitude")}
    latitude, longitude = numbers.values()
    origin = origin_of(part, latitude, longitude)
    places = np.stack([latitude, longitude], axis=-1)
    place = to_local(places, origin)
    far = distance(latitude, longitude, origin)
    within = FARTHEST if part.within is None else quantity(part.within, LENGTH, "local.within")
    if not 0 < within <= FARTHEST:
        raise InputError(
            f"local.within is a length up to {FARTHEST / 1e3:.0f} km, for one plane; it is {part.within!r}"
        )
    if part.within is None and (far > FARTHEST).any():
        index = int(np.nanargmax(far))
        raise InputError(
            f"local: row {table.row(index)} of {table.path.name} lies {far[index] / 1e3:.0f} km from the origin, too "
            f'far for one plane; split the file by region, or write within = "{FARTHEST / 1e3:.0f} km" in [local], and '
            "what is farther away counts as not measured"
        )
    place[far > within] = np.nan
    more = dict(zip(POSITION, place.T, strict=True))
    if (part.speed is None) != (part.course is None):
        raise InputError("local: speed and course belong together; give both or none")
    if part.speed is not None and part.course is not None:
        speed = part.speed.numbers(table) * to_si(part.speed.unit, SPEED, "local.speed")
        course = part.course.numbers(table) * to_si(part.course.unit, ANGLE, "local.course")
        velocity = local_velocity(speed, course, places, origin)
        velocity[far > within] = np.nan
        more |= dict(zip(VELOCITY, velocity.T, strict=True))
    return replace(table, columns=table.columns.assign(**more))


def local_columns(part: LocalPart | None) -> set[str]:
    """The columns of the file that it takes."""
    if part is None:
        return set()
    return {c.column for c in (part.latitude, part.longitude, part.speed, part.course) if c is not None}


def origin_of(part: LocalPart, latitude: np.ndarray, longitude: np.ndarray) -> tuple[float, float]:
    """The origin that is described, or the first place in the data; rad.

    Raises:
        InputError: where there is none.
    """
    if part.origin is not None:
        if len(part.origin) != 2:
            raise InputError(f"local.origin is a latitude and a longitude; it is {part.origin}")
        lat, lon = (quantity(v, ANGLE, "local.origin") for v in part.origin)
        if abs(lat) > math.pi / 2 or abs(lon) > 2 * math.pi:
            raise InputError(f'local.origin is no place: {part.origin}; degrees are written "52.1 deg"')
        return lat, lon
    whole = np.flatnonzero(~np.isnan(latitude) & ~np.isnan(longitude))
    if not len(whole):
        raise InputError("local: no row has a latitude and a longitude")
    return float(latitude[whole[0]]), float(longitude[whole[0]])


def _angles(table: Table, column: Column, name: str) -> np.ndarray:
    factor = to_si(column.unit, ANGLE, f"local.{name}")
    values = column.numbers(table) * factor
    most = math.pi / 2 if name == "latitude" else 2 * math.pi
    # A full turn in text has its own rounding.
    beyond = np.abs(values) > most * (1 + 1e-9)
    if beyond.any():
        index = int(np.flatnonzero(beyond)[0])
        given = values[index] / factor
        hint = (
            'if these are degrees, add unit = "deg"' if factor == 1.0 else f"if it means none, add missing = {given:g}"
        )
        raise InputError(
            f"local.{name}: {table.path.name}, row {table.row(index)}: {given:g} {column.unit or 'rad'} is no {name}; "
            f"{hint}"
        )
    return values


def distance(latitude: np.ndarray, longitude: np.ndarray, origin: tuple[float, float]) -> np.ndarray:
    """Metres on the ground from the origin to places (T,), to a hundredth."""
    at = np.sin(latitude) * math.sin(origin[0])
    at += np.cos(latitude) * math.cos(origin[0]) * np.cos(longitude - origin[1])
    return _EARTH * np.arccos(np.clip(at, -1, 1))
