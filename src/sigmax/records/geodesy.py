"""Latitude and longitude on WGS84 as metres east and north in the plane that touches the ellipsoid at a point."""

import numpy as np

# Semi-major axis and flattening: NIMA TR8350.2, table 3.1.
_A, _F = 6378137.0, 1 / 298.257223563
_E2 = _F * (2 - _F)


def east_north(latitude: np.ndarray, longitude: np.ndarray, origin: tuple[float, float]) -> np.ndarray:
    """Positions (T, 2), m, of points on the ellipsoid, projected on the plane that touches it at the origin; exact.

    Args:
        latitude: geodetic, rad (T,).
        longitude: rad (T,).
        origin: latitude and longitude of the point of the plane, rad.
    """
    away = _geocentric(latitude, longitude) - _geocentric(*map(np.asarray, origin))
    return away @ _axes(*map(np.asarray, origin)).T


def velocity_east_north(
    speed: np.ndarray, course: np.ndarray, latitude: np.ndarray, longitude: np.ndarray, origin: tuple[float, float]
) -> np.ndarray:
    """Velocities (T, 2), m/s, in the same plane, of points that move at a course over the ellipsoid.

    Args:
        speed: over ground, m/s (T,).
        course: from true north, clockwise, rad (T,).
        latitude: where the points are, rad (T,).
        longitude: rad (T,).
        origin: of the plane, rad.
    """
    at = _axes(latitude, longitude)
    velocity = (speed * np.sin(course))[:, None] * at[..., 0, :] + (speed * np.cos(course))[:, None] * at[..., 1, :]
    return velocity @ _axes(*map(np.asarray, origin)).T


def _geocentric(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Coordinates (…, 3), m, of points on the ellipsoid, from its centre."""
    s, c = np.sin(latitude), np.cos(latitude)
    normal = _A / np.sqrt(1 - _E2 * s**2)
    return np.stack([normal * c * np.cos(longitude), normal * c * np.sin(longitude), normal * (1 - _E2) * s], axis=-1)


def _axes(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """The directions east and north (…, 2, 3) at points."""
    s, c, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    east = np.stack([-sl, cl, np.zeros_like(sl)], axis=-1)
    north = np.stack([-s * cl, -s * sl, c], axis=-1)
    return np.stack([east, north], axis=-2)
