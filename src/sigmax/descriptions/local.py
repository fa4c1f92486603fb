"""The table [local] of a description: latitude, longitude and height become columns in metres."""

import math
from dataclasses import replace

import numpy as np

from sigmax.descriptions.described_model import DescribedModel
from sigmax.errors import InputError
from sigmax.files.description import Column, Description, LocalPart
from sigmax.files.frame import Frame, Placed
from sigmax.files.table import Table
from sigmax.files.units import ANGLE, LENGTH, SPEED, quantity, to_si

POSITION = ("local.east", "local.north")
UP, DOWN = "local.up", "local.down"
VELOCITY = ("local.velocity_east", "local.velocity_north")
# Columns that this table makes.
MADE = {*POSITION, UP, DOWN, *VELOCITY}
# Beyond it the plane shortens lengths by more than a hundredth.
FARTHEST, _EARTH = 900e3, 6371e3


def with_local(table: Table, part: LocalPart | None, frame: Frame | None = None) -> Table:
    """The table with the columns local.east and local.north, and those of height and velocity where described.

    Without a frame it is the one that is described.

    Raises:
        InputError: for latitudes and longitudes that are none, or lie too far from the origin for one plane.
    """
    if part is None:
        return table
    latitude, longitude = (_angles(table, getattr(part, name), name) for name in ("latitude", "longitude"))
    if frame is None:
        frame = frame_of(part, table)
    numbers = [latitude, longitude]
    if part.height is not None:
        numbers.append(part.height.numbers(table) * to_si(part.height.unit, LENGTH, "local.height"))
    places = np.stack(numbers, axis=-1)
    place = frame.positions(places)
    far = distance(latitude, longitude, frame.origin)
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
    more = dict(zip(POSITION, place.T, strict=False))
    if part.height is not None:
        more |= {UP: place[:, 2], DOWN: -place[:, 2]}
    if (part.speed is None) != (part.course is None):
        raise InputError("local: speed and course belong together; give both or none")
    if part.speed is not None and part.course is not None:
        speed = part.speed.numbers(table) * to_si(part.speed.unit, SPEED, "local.speed")
        course = part.course.numbers(table) * to_si(part.course.unit, ANGLE, "local.course")
        velocity = frame.velocity(speed, course, places)
        velocity[far > within] = np.nan
        more |= dict(zip(VELOCITY, velocity.T, strict=True))
    return replace(table, columns=table.columns.assign(**more))


def local_columns(part: LocalPart | None) -> set[str]:
    """The columns of the file that it takes."""
    if part is None:
        return set()
    given = (part.latitude, part.longitude, part.height, part.speed, part.course)
    return {c.column for c in given if c is not None}


def frame_of(part: LocalPart, table: Table) -> Frame:
    """The frame of the columns that it makes.

    Raises:
        InputError: for a frame that is not known, and where there is no origin.
    """
    latitude, longitude = (_angles(table, getattr(part, name), name) for name in ("latitude", "longitude"))
    return frame_among(part, latitude, longitude)


def frame_among(part: LocalPart, latitude: np.ndarray, longitude: np.ndarray) -> Frame:
    """The frame at the origin that is described, or at the first of these places (rad).

    Raises:
        InputError: as `frame_of`.
    """
    if part.frame not in ("plane", "utm"):
        raise InputError(f'local.frame is "plane" or "utm"; it is {part.frame!r}')
    origin = origin_of(part, latitude, longitude)
    if part.height is None:
        return Frame(origin[:2], part.frame == "utm")
    return Frame(origin if len(origin) == 3 else (*origin, 0.0), part.frame == "utm")


def placed(description: Description, built: DescribedModel, frame: Frame | None) -> Placed | None:
    """Which components of the state are what [local] makes, by a sensor of positions; None where there are none.

    Raises:
        InputError: for heights that no sensor measures.
    """
    if frame is None:
        return None
    state = [str(name) for name in built.model.state]
    for name, sensing in built.sensings.items():
        if sensing.kind != "position":
            continue
        columns = {k: c.column for k, c in description.sensors[name].columns.items()}
        # Of another table they are called NAME.local.east.
        by_column = {c[c.find("local.") :]: state.index(str(k)) for k, c in columns.items() if "local." in c}
        if not all(column in by_column for column in POSITION):
            continue
        third = next((column for column in (UP, DOWN) if column in by_column), None)
        if len(frame.origin) == 3 and third is None:
            raise InputError(
                f"local.height is given, and sensors.{name} measures neither {UP} nor {DOWN}: a third axis of the "
                "motion takes it; without one drop local.height, and places are those on the ground"
            )
        at = [by_column[column] for column in (*POSITION, third) if column is not None]
        return Placed(frame, tuple(at), third == DOWN)
    return None


def origin_of(part: LocalPart, latitude: np.ndarray, longitude: np.ndarray) -> tuple[float, ...]:
    """The origin that is described, rad and m, or the first place in the data, on the ellipsoid.

    Raises:
        InputError: where there is none.
    """
    if part.origin is not None:
        if len(part.origin) not in (2, 3):
            raise InputError(f"local.origin is a latitude and a longitude, and a height if wanted; it is {part.origin}")
        lat, lon = (quantity(v, ANGLE, "local.origin") for v in part.origin[:2])
        if abs(lat) > math.pi / 2 or abs(lon) > 2 * math.pi:
            raise InputError(f'local.origin is no place: {part.origin}; degrees are written "52.1 deg"')
        return lat, lon, *(quantity(v, LENGTH, "local.origin") for v in part.origin[2:])
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


def distance(latitude: np.ndarray, longitude: np.ndarray, origin: tuple[float, ...]) -> np.ndarray:
    """Metres on the ground from the origin to places (T,), to a hundredth."""
    at = np.sin(latitude) * math.sin(origin[0])
    at += np.cos(latitude) * math.cos(origin[0]) * np.cos(longitude - origin[1])
    return _EARTH * np.arccos(np.clip(at, -1, 1))
