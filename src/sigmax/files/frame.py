"""Where metres of a record lie on the Earth: a plane at an origin, or the grid of UTM."""

import importlib.util
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.models.earth import from_local, local_velocity, to_local

if TYPE_CHECKING:
    from pyproj import Proj


# Of a plane, m: sideways, and below.
_LOST, _DEEPEST = 3e6, -3e5


class Frame(NamedTuple):
    """Metres east and north, and up where there are heights, of places (latitude and longitude in radians).

    Attributes:
        origin: latitude, longitude, rad, and a height above the ellipsoid, m, where there are heights.
        utm: whether metres are those of the zone of UTM in which the origin lies, and heights their own.
    """

    origin: tuple[float, ...]
    utm: bool = False

    def positions(self, places: np.ndarray) -> np.ndarray:
        """Metres (…, k) of places (…, k), k 2 or 3."""
        if not self.utm:
            return to_local(places, self.origin)
        east, north = self._grid()(places[..., 1], places[..., 0], radians=True)
        plane = np.stack([east, north], axis=-1)
        plane = np.where(np.isnan(places[..., :1] + places[..., 1:2]), np.nan, plane)
        return np.concatenate([plane, places[..., 2:]], axis=-1)

    def places(self, positions: np.ndarray) -> np.ndarray:
        """The places (…, k) of metres (…, k)."""
        if not self.utm:
            return from_local(positions, self.origin)
        longitude, latitude = self._grid()(positions[..., 0], positions[..., 1], inverse=True, radians=True)
        plane = np.stack([latitude, longitude], axis=-1)
        return np.concatenate([np.where(np.isfinite(plane), plane, np.nan), positions[..., 2:]], axis=-1)

    def velocity(self, speed: np.ndarray, course: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Metres east and north in a second (T, 2) of a speed over ground on a course from true north."""
        if not self.utm:
            return local_velocity(speed, course, places[..., :2], self.origin[:2])
        known = np.isfinite(places[..., 0]) & np.isfinite(places[..., 1])
        latitude, longitude = (np.where(known, places[..., k], self.origin[k]) for k in (0, 1))
        factors = self._grid().get_factors(longitude, latitude, radians=True)
        # On the grid a course turns by the convergence of its north, and lengths are scaled alike in all directions.
        turned = course - np.radians(factors.meridian_convergence)
        along = np.stack([np.sin(turned), np.cos(turned)], axis=-1)
        return np.where(known[..., None], along * (speed * factors.meridional_scale)[..., None], np.nan)

    @property
    def name(self) -> str:
        """In words."""
        if not self.utm:
            return "metres east and north in the plane at the origin"
        return f"UTM, zone {_zone(self.origin[1])}{'N' if self.origin[0] >= 0 else 'S'}"

    def _grid(self) -> "Proj":
        if importlib.util.find_spec("pyproj") is None:
            raise InputError('local.frame = "utm" takes pyproj; install it with: pip install "sigmax[logs]"')
        from pyproj import Proj

        return Proj(proj="utm", zone=_zone(self.origin[1]), south=self.origin[0] < 0, ellps="WGS84")


class Placed(NamedTuple):
    """Which components of a state lie on the Earth.

    Attributes:
        frame: in which.
        at: the components east and north, and the third where there is one.
        down: whether the third counts downwards.
    """

    frame: Frame
    at: tuple[int, ...]
    down: bool = False

    def places(self, mean: np.ndarray) -> np.ndarray:
        """Latitude, longitude, rad, and height, m, (…, k) of states (…, n); NaN where a filter lost its way."""
        positions = np.array(mean[..., list(self.at)], float)
        if self.down:
            positions[..., 2] *= -1
        if not self.frame.utm:
            lost = (np.abs(positions) > _LOST).any(-1) | (positions[..., 2:] < _DEEPEST).any(-1)
            positions[lost] = np.nan
        return self.frame.places(positions)

    def columns(self, mean: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """By name, what tables of results have, and its unit: latitude and longitude in degrees, height in m."""
        places = self.places(mean)
        angles = {name: (np.degrees(places[..., k]), "deg") for k, name in enumerate(("latitude", "longitude"))}
        return angles | ({"height": (places[..., 2], "m")} if len(self.at) == 3 else {})


def _zone(longitude: float) -> int:
    return int(math.degrees(longitude) + 180) % 360 // 6 + 1
