"""Elevation maps: matplotlib's sample of the Jacksboro fault, an .npz like it, or a GeoTIFF."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.models import Elevation

# Metres of a degree of latitude, and of longitude at the equator.
_NORTH, _EAST = 111_132.95, 111_319.49
_SAMPLE = "jacksboro_fault_dem.npz"
_WANTED = ("elevation", "dx", "dy", "ymin", "ymax")


def elevation(name: str, method: str = "bicubic") -> Elevation:
    """A map by its name, "jacksboro", or by the path of an .npz or a GeoTIFF; x east and z north from its corner.

    Raises:
        InputError: where it cannot be found or read, or is no map.
    """
    if name.casefold() == "jacksboro":
        return _degrees(_sample(), method)
    path = Path(name)
    if not path.is_file():
        raise InputError(f"{name} is no map: give jacksboro, or the path of an .npz or of a GeoTIFF")
    if path.suffix.casefold() == ".npz":
        return _degrees(path, method)
    return _geotiff(path, method)


def _sample() -> Path:
    # Found, not imported: only the file is wanted.
    package = importlib.util.find_spec("matplotlib")
    places = package.submodule_search_locations if package is not None else None
    path = Path(places[0]) / "mpl-data" / "sample_data" / _SAMPLE if places else None
    if path is None or not path.is_file():
        raise InputError(
            f"the map jacksboro is {_SAMPLE} of the package matplotlib: this one has none; give the path of a map"
        )
    return path


def _degrees(path: Path, method: str) -> Elevation:
    """Heights on a grid of degrees, the first row in the north, as in matplotlib's sample."""
    try:
        with np.load(path) as found:
            data = {key: np.asarray(found[key], float) for key in _WANTED}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path} is not a map: it should hold {', '.join(_WANTED)} ({error})") from error
    # In the sample ymin and ymax are swapped.
    latitude = float(data["ymin"] + data["ymax"]) / 2
    return Elevation(data["elevation"][::-1], _metres(float(data["dx"]), float(data["dy"]), latitude), method=method)


def _metres(across: float, along: float, latitude: float) -> tuple[float, float]:
    return across * _EAST * float(np.cos(np.radians(latitude))), along * _NORTH


def _geotiff(path: Path, method: str) -> Elevation:
    try:
        import rasterio
    except ImportError as error:
        raise InputError(f"{path}: GeoTIFF needs the package rasterio: pip install 'sigmax[geotiff]'") from error
    try:
        with rasterio.open(path) as source:
            heights = source.read(1, masked=True).astype(float).filled(np.nan)
            transform, crs, bounds = source.transform, source.crs, source.bounds
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path} cannot be read as a GeoTIFF: {error}") from error
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        raise InputError(f"{path} is turned or mirrored; bring it to north up first (gdalwarp)")
    spacing: tuple[Any, Any] = (transform.a, -transform.e)
    if crs is not None and crs.is_geographic:
        spacing = _metres(*spacing, (bounds.top + bounds.bottom) / 2)
    return Elevation(heights[::-1], (float(spacing[0]), float(spacing[1])), method=method)
