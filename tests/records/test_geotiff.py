"""GeoTIFF maps: written by rasterio in many ways, read as the same heights."""

import builtins

import numpy as np
import pytest

import sigmax
from sigmax.records.maps import elevation
from sigmax.records.terrain import LARGEST, flight, middle, terrain

rasterio = pytest.importorskip("rasterio", reason="the extra geotiff is not installed")

ROWS, COLUMNS = 30, 40
NORTH_UP = np.round(600 + 90 * np.sin(np.arange(ROWS) / 5)[:, None] * np.cos(np.arange(COLUMNS) / 7), 1)
# A cell is a pixel; the first and the last centre lie half a pixel inside.
UTM, SPACING = "EPSG:32632", (250.0, 200.0)


def written(path, heights=NORTH_UP, crs=UTM, transform=None, **more):
    """A GeoTIFF of these heights, the first row in the north where no other transform is given."""
    dx, dy = SPACING
    chosen = rasterio.Affine(dx, 0, 500_000, 0, -dy, 5_300_000) if transform is None else transform
    given = {"count": 1, "dtype": heights.dtype.name, "nodata": None} | more
    scale = given.pop("scale", None)
    with rasterio.open(
        path, "w", driver="GTiff", height=len(heights), width=heights.shape[1], crs=crs, transform=chosen, **given
    ) as file:
        for band in range(given["count"]):
            file.write(heights + 1000 * band, band + 1)
        if scale is not None:
            file.scales, file.offsets = (scale[0],), (scale[1],)
    return str(path)


def test_a_projected_map_has_its_own_metres_and_its_first_row_in_the_south(tmp_path):
    ground = elevation(written(tmp_path / "utm.tif"), "bilinear")
    assert ground.spacing == SPACING
    np.testing.assert_array_equal(ground.heights, NORTH_UP[::-1])
    (x0, x1), (z0, z1) = ground.extent
    assert (x1 - x0, z1 - z0) == ((COLUMNS - 1) * SPACING[0], (ROWS - 1) * SPACING[1])
    assert float(ground(x0, z1)) == NORTH_UP[0, 0]
    assert float(ground(x1, z0)) == NORTH_UP[-1, -1]


@pytest.mark.parametrize(
    ("rows", "columns"), [(1, 1), (-1, -1), (1, -1)], ids=["south up", "east left", "both the other way"]
)
def test_rows_and_columns_may_run_either_way(tmp_path, rows, columns):
    dx, dy = SPACING
    left = 500_000 + (COLUMNS * dx if columns < 0 else 0)
    top = 5_300_000 - (ROWS * dy if rows > 0 else 0)
    turned = np.ascontiguousarray(NORTH_UP[::-rows, ::columns])
    with_transform = rasterio.Affine(columns * dx, 0, left, 0, rows * dy, top)
    made = elevation(written(tmp_path / "map.tif", turned, transform=with_transform), "bilinear")
    assert made.spacing == SPACING
    np.testing.assert_array_equal(made.heights, NORTH_UP[::-1])


def test_degrees_become_metres_at_the_middle_latitude(tmp_path):
    step = 1 / 1200
    transform = rasterio.Affine(step, 0, 11.0, 0, -step, 60.0 + ROWS * step / 2)
    ground = elevation(written(tmp_path / "wgs.tif", crs="EPSG:4326", transform=transform))
    # A minute of latitude is a nautical mile, and half of it of longitude at 60°.
    assert ground.spacing == pytest.approx((1852 / 20 / 2, 1852 / 20), rel=3e-3)


def test_feet_are_not_taken_for_metres(tmp_path):
    ground = elevation(written(tmp_path / "feet.tif", crs="EPSG:2263"))
    assert ground.spacing == pytest.approx([0.3048006 * s for s in SPACING])


def test_scale_and_offset_and_the_first_of_several_bands_are_read(tmp_path):
    counts = np.arange(ROWS * COLUMNS, dtype=np.int16).reshape(ROWS, COLUMNS)
    ground = elevation(written(tmp_path / "scaled.tif", counts, count=2))
    np.testing.assert_array_equal(ground.heights, counts[::-1])
    ground = elevation(written(tmp_path / "scaled.tif", counts, scale=(0.25, -100.0)))
    np.testing.assert_array_equal(ground.heights, counts[::-1] * 0.25 - 100)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_what_has_no_data_and_what_lies_beyond_the_map_is_nan_and_a_fault_at_most(tmp_path, method):
    holed = NORTH_UP.copy()
    holed[12:18, 5:15] = -9999
    ground = elevation(written(tmp_path / "holed.tif", holed, nodata=-9999), method)
    assert np.isnan(ground.heights).sum() == 60
    assert np.nanmin(ground.heights) > 0
    (x0, x1), (z0, z1) = ground.extent
    inside = float(ground(x0 + 9 * SPACING[0], z0 + 14 * SPACING[1]))
    assert np.isnan(inside)
    assert np.isnan(np.asarray(ground(np.array([x0 - 1.0, x1 + 1.0]), np.array([z0, z1])))).all()
    assert np.isfinite(float(ground(x0 + 25 * SPACING[0], z0 + 14 * SPACING[1])))
    made = terrain(ground, "holed")
    # Where the truth has no height, there is no measurement; where only the estimate has none, a fault.
    missing = np.isnan(made.z[0, :, 0])
    assert 0 < missing.sum() < made.z.shape[1] / 2
    found = sigmax.run("CKF", made.model, made.prior, made.z, dt=made.dt, inputs=made.inputs)
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.cov).all()
    assert set(np.unique(found.fault)) <= {0, sigmax.running.Fault.SENSOR_NOT_FINITE}
    assert (found.fault[0] == 0)[missing].all()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"transform": rasterio.Affine(250, 30, 5e5, 30, -200, 5e6)}, "turned against"),
        ({"crs": None}, "where it lies"),
    ],
)
def test_maps_that_do_not_lie_along_their_coordinates_are_refused(tmp_path, more, said):
    with pytest.raises(sigmax.InputError, match=said):
        elevation(written(tmp_path / "map.tif", **more))


def test_what_is_no_geotiff_and_what_has_no_heights_are_refused(tmp_path):
    (tmp_path / "text.tif").write_text("heights")
    with pytest.raises(sigmax.InputError, match="cannot be read as a GeoTIFF"):
        elevation(str(tmp_path / "text.tif"))
    empty = elevation(written(tmp_path / "empty.tif", np.full((5, 5), -1.0), nodata=-1.0))
    with pytest.raises(sigmax.InputError, match="all of them are missing"):
        flight(empty)
    with pytest.raises(sigmax.InputError, match="too small for a flight"):
        flight(elevation(written(tmp_path / "small.tif", transform=rasterio.Affine(0.1, 0, 0, 0, -0.1, 0))))


def test_without_rasterio_the_extra_is_named(tmp_path, monkeypatch):
    path = written(tmp_path / "map.tif")
    real = builtins.__import__

    def without(name, *given, **more):
        if name == "rasterio":
            raise ImportError(name)
        return real(name, *given, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(sigmax.InputError, match=r"pip install 'sigmax\[geotiff\]'"):
        elevation(path)


def test_of_a_large_map_the_middle_is_flown_over(tmp_path):
    ground = sigmax.models.Elevation(np.add.outer(np.arange(301.0), np.zeros(101)), (250.0, 250.0), (1000.0, -500.0))
    part = middle(ground)
    (x0, x1), (z0, z1) = part.extent
    assert (x0, x1) == (1000.0, 1000.0 + 100 * 250.0)
    assert LARGEST - 500 <= z1 - z0 <= LARGEST
    assert (z0 + z1) / 2 == pytest.approx(-500 + 150 * 250.0, abs=250)
    x, z = np.array([[5000.0, 9000.0], [z0 + 10, z1 - 10]])
    np.testing.assert_allclose(part(x, z), ground(x, z), atol=1e-9)
