"""Places on the Earth (WGS 84) as metres in a local level frame, or from the Earth's centre, and back.

A place is latitude and longitude in radians, and a height in m above the ellipsoid where there is a third number.
"""

import math
from typing import Any

import numpy as np

from sigmax.errors import InputError

__all__ = ["from_ecef", "from_local", "local_velocity", "to_ecef", "to_local"]

# Semi-major axis and flattening: NIMA TR8350.2, table 3.1.
_A, _F = 6378137.0, 1 / 298.257223563
_B, _E2 = _A * (1 - _F), _F * (2 - _F)
# Nearer to the centre a place has no height of its own, and numbers are more likely in km.
_DEEPEST = 6e6
# Axes of a frame: rows of (east, north, up) and their signs.
_FRAMES = {"enu": ([0, 1, 2], [1.0, 1.0, 1.0]), "ned": ([1, 0, 2], [1.0, 1.0, -1.0])}


def to_ecef(places: Any) -> np.ndarray:
    """Coordinates (…, 3), m, from the Earth's centre (ECEF) of places (…, 2) or (…, 3).

    Raises:
        InputError: for latitudes beyond a quarter turn, such as degrees, and other shapes.
    """
    places = _places(places)
    latitude, longitude = places[..., 0], places[..., 1]
    height = places[..., 2] if places.shape[-1] == 3 else 0.0
    s, c = np.sin(latitude), np.cos(latitude)
    normal = _A / np.sqrt(1 - _E2 * s**2)
    level = (normal + height) * c
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), (normal * (1 - _E2) + height) * s], axis=-1)


def from_ecef(positions: Any) -> np.ndarray:
    """The places (…, 3) of coordinates (…, 3), m, from the Earth's centre; to a few nanometres.

    Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (1976), iterated.

    Raises:
        InputError: for positions hundreds of kilometres below the ground, such as those in km, and other shapes.
    """
    positions = np.asarray(positions, float)
    if positions.ndim == 0 or positions.shape[-1] != 3:
        raise InputError(f"positions from the Earth's centre have three coordinates; their shape is {positions.shape}")
    radius = np.linalg.norm(positions, axis=-1)
    if (radius < _DEEPEST).any():
        raise InputError(
            f"a position lies {np.nanmin(radius):.6g} m from the Earth's centre, deep in it: are these metres?"
        )
    x, y, z = np.moveaxis(positions, -1, 0)
    level = np.hypot(x, y)
    reduced = np.arctan2(z * (1 - _F), level * (1 - _E2))
    for _ in range(4):
        latitude = np.arctan2(z + _E2 / (1 - _E2) * _B * np.sin(reduced) ** 3, level - _E2 * _A * np.cos(reduced) ** 3)
        reduced = np.arctan2((1 - _F) * np.sin(latitude), np.cos(latitude))
    s, c = np.sin(latitude), np.cos(latitude)
    height = level * c + z * s - _A * np.sqrt(1 - _E2 * s**2)
    return np.stack([latitude, np.arctan2(y, x), height], axis=-1)


def to_local(places: Any, origin: Any, frame: str = "enu") -> np.ndarray:
    """Positions, m, in the frame whose plane touches the ellipsoid at the origin, or its height above; exact.

    Places (…, 3) become east, north, up (…, 3), or north, east, down in the frame "ned". Places (…, 2) are points of
    the ellipsoid, and their positions (…, 2) in the plane have no third coordinate.

    Raises:
        InputError: for latitudes beyond a quarter turn, such as degrees, other shapes and other frames.
    """
    places, order, sign = _places(places), *_frame(frame)
    origin = _origin(origin)
    moved = (to_ecef(places) - to_ecef(origin)) @ axes(origin[:2]).T
    return (moved[..., order] * sign)[..., : places.shape[-1]]


def from_local(positions: Any, origin: Any, frame: str = "enu") -> np.ndarray:
    """The places (…, 3) of positions (…, 3) in the frame at an origin; those (…, 2) of points of its plane (…, 2).

    A point of the plane stands for the point of the ellipsoid below it; where there is none, it is NaN.

    Raises:
        InputError: for other shapes and frames, and for positions that are deep below the ground.
    """
    positions, (order, sign) = np.asarray(positions, float), _frame(frame)
    origin = _origin(origin)
    if positions.ndim == 0 or positions.shape[-1] not in (2, 3):
        raise InputError(f"positions in a local frame have 2 or 3 coordinates; their shape is {positions.shape}")
    turn = axes(origin[:2])
    if positions.shape[-1] == 3:
        moved = (positions * sign)[..., order] @ turn
        return from_ecef(to_ecef(origin) + moved)
    moved = positions[..., order[:2]] @ turn[:2]
    foot, scale, up = to_ecef(origin[:2]), np.array([_A, _A, _B]), turn[2] / np.array([_A, _A, _B])
    # How far below the plane the ellipsoid is: (foot + moved + u·up) on it; the plane touches it at the foot.
    away = moved / scale
    a, b, c = up @ up, (foot / scale + away) @ up, (away * away).sum(-1)
    with np.errstate(invalid="ignore"):
        u = -c / (b + np.sqrt(b * b - a * c))
    return from_ecef(foot + moved + u[..., None] * turn[2])[..., :2]


def local_velocity(speed: Any, course: Any, places: Any, origin: Any) -> np.ndarray:
    """Velocities (T, 2), m/s, east and north in the plane at an origin, of a speed on a course over the ellipsoid.

    Args:
        speed: over ground, m/s (T,).
        course: from true north, clockwise, rad (T,).
        places: where it moves (T, 2).
        origin: of the plane.
    """
    at = axes(_places(places)[..., :2])
    velocity = (speed * np.sin(course))[:, None] * at[..., 0, :] + (speed * np.cos(course))[:, None] * at[..., 1, :]
    return velocity @ axes(_origin(origin)[:2])[:2].T


def axes(places: np.ndarray) -> np.ndarray:
    """The directions east, north and up (…, 3, 3) at places (…, 2), from the Earth's centre."""
    s, c = np.sin(places[..., 0]), np.cos(places[..., 0])
    sl, cl = np.sin(places[..., 1]), np.cos(places[..., 1])
    east = np.stack([-sl, cl, np.zeros_like(sl)], axis=-1)
    north = np.stack([-s * cl, -s * sl, c], axis=-1)
    return np.stack([east, north, np.stack([c * cl, c * sl, s], axis=-1)], axis=-2)


def _places(given: Any) -> np.ndarray:
    places = np.asarray(given, float)
    if places.ndim == 0 or places.shape[-1] not in (2, 3):
        raise InputError(
            f"places are latitudes, longitudes, and heights if any, along the last axis; their shape is {places.shape}"
        )
    # A quarter turn that was degrees has its own rounding.
    for k, (what, most) in enumerate((("latitude", math.pi / 2), ("longitude", 2 * math.pi))):
        beyond = np.abs(places[..., k]) > most * (1 + 1e-9)
        if beyond.any():
            first = places[..., k][beyond].flat[0]
            raise InputError(
                f"a {what} is in radians, between {-most:.4g} and {most:.4g}; one is {first:g}: "
                "use numpy.radians, and write the latitude first"
            )
    return places


def _origin(given: Any) -> np.ndarray:
    origin = _places(given)
    if origin.ndim != 1 or not np.isfinite(origin).all():
        raise InputError(f"the origin is one place: a latitude, a longitude, and a height if wanted; it is {given!r}")
    return origin


def _frame(frame: str) -> tuple[list[int], np.ndarray]:
    if frame not in _FRAMES:
        raise InputError(f'a local frame is "enu" (east, north, up) or "ned" (north, east, down); it is {frame!r}')
    order, sign = _FRAMES[frame]
    return order, np.array(sign)
