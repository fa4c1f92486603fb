"""Elevation maps: matplotlib's sample of the Jacksboro fault, an .npz like it, or a GeoTIFF."""

import importlib.util
import warnings
import zipfile
import zlib
from pathlib import Path

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
        with path.open("rb") as file, np.load(file) as found:
            data = {key: np.asarray(found[key], float) for key in _WANTED}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path} is not a map: it should hold {', '.join(_WANTED)} ({error})") from error
    # In the sample ymin and ymax are swapped.
    latitude = float(data["ymin"] + data["ymax"]) / 2
    return Elevation(data["elevation"][::-1], _metres(float(data["dx"]), float(data["dy"]), latitude), method=method)


def _metres(across: float, along: float, latitude: float) -> tuple[float, float]:
    return across * _EAST * float(np.cos(np.radians(latitude))), along * _NORTH


def _geotiff(path: Path, method: str) -> Elevation:
    """The first band of a GeoTIFF, its rows and columns along the axes of its coordinates, whichever way they run."""
    try:
        import rasterio
    except ImportError as error:
        raise InputError(f"{path}: GeoTIFF needs the package rasterio: pip install 'sigmax[geotiff]'") from error
    try:
        # What has no place is refused below, in words of ours.
        with warnings.catch_warnings(), rasterio.open(path) as source:
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            heights = source.read(1, masked=True).astype(float) * source.scales[0] + source.offsets[0]
            transform, crs = source.transform, source.crs
            unit = 1.0 if crs is None else float(crs.units_factor[1])
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path} cannot be read as a GeoTIFF: {error}") from error
    if crs is None:
        raise InputError(f"{path} does not say where it lies: give it a coordinate system (gdal_edit -a_srs EPSG:…)")
    if transform.b or transform.d:
        raise InputError(f"{path} is turned against its coordinates; bring it to north up first (gdalwarp)")
    rising = heights.filled(np.nan)[:: -1 if transform.e < 0 else 1, :: -1 if transform.a < 0 else 1]
    # Of a geographic system the unit is an angle, in radians; of a projected one a length, in metres.
    across, along = abs(transform.a) * unit, abs(transform.e) * unit
    if crs.is_geographic:
        latitude = (transform.f + transform.e * len(rising) / 2) * unit
        across, along = _metres(*(float(np.degrees(angle)) for angle in (across, along, latitude)))
    return Elevation(rising, (float(across), float(along)), method=method)
