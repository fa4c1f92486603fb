"""Places on the Earth: against PROJ, there and back, and what is no place."""

import numpy as np
import pyproj
import pytest

import sigmax
from sigmax import earth

FROM_CENTRE = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def places(seed, count=200):
    """Anywhere, the poles and the date line among them; heights from a trench to an orbit."""
    rng = np.random.default_rng(seed)
    latitude = np.arcsin(rng.uniform(-1, 1, count))
    longitude = rng.uniform(-np.pi, np.pi, count)
    latitude[:6] = [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1e-12, 0.0, 0.5]
    longitude[4:8] = [np.pi, -np.pi, np.nextafter(np.pi, 0), 0.0]
    return np.column_stack([latitude, longitude, rng.choice([-1e4, 0.0, 100.0, 1e4, 4e5], count)])


def by_proj(found):
    latitude, longitude, height = np.moveaxis(found, -1, 0)
    return np.stack(FROM_CENTRE.transform(np.degrees(longitude), np.degrees(latitude), height), axis=-1)


@pytest.mark.parametrize("seed", range(5))
def test_coordinates_from_the_centre_are_those_of_proj(seed):
    where = places(seed)
    assert np.allclose(earth.to_ecef(where), by_proj(where), rtol=0, atol=1e-8)
    back = earth.from_ecef(earth.to_ecef(where))
    assert np.linalg.norm(by_proj(back) - by_proj(where), axis=-1).max() < 1e-7
    flat = earth.to_ecef(where[:, :2])
    assert np.array_equal(flat, earth.to_ecef(where * [1, 1, 0]))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("frame", ["enu", "ned"])
def test_a_local_frame_is_that_of_proj_and_leads_back(seed, frame):
    rng = np.random.default_rng(seed)
    origin = np.array([np.arcsin(rng.uniform(-1, 1)), rng.uniform(-np.pi, np.pi), 50.0])
    near = origin + rng.uniform(-1, 1, (50, 3)) * [0.015, 0.015, 2000.0]
    near[:, 0] = np.clip(near[:, 0], -np.pi / 2, np.pi / 2)
    latitude, longitude, height = origin
    topocentric = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={np.degrees(latitude):.15f} +lon_0={np.degrees(longitude):.15f} +h_0={height}"
    )
    want = np.stack(topocentric.transform(near[:, 1], near[:, 0], near[:, 2], radians=True), axis=-1)
    if frame == "ned":
        want = want[:, [1, 0, 2]] * [1, 1, -1]
    got = earth.to_local(near, origin, frame)
    assert np.allclose(got, want, rtol=0, atol=1e-6)
    back = earth.from_local(got, origin, frame)
    assert np.linalg.norm(by_proj(back) - by_proj(near), axis=-1).max() < 1e-7
    # In the plane alone: points of the ellipsoid.
    plane = earth.to_local(near[:, :2], origin, frame)
    again = earth.from_local(plane, origin, frame)
    assert np.linalg.norm(earth.to_ecef(again) - earth.to_ecef(near[:, :2]), axis=-1).max() < 1e-6


def test_a_velocity_is_the_difference_of_places():
    rng = np.random.default_rng(4)
    origin, h = (0.9, 3.1), 1e-3
    here = origin + rng.uniform(-0.01, 0.01, (40, 2))
    speed, course = rng.uniform(1, 300, 40), rng.uniform(-np.pi, np.pi, 40)
    ahead = pyproj.Geod(ellps="WGS84").fwd(here[:, 1], here[:, 0], course, speed * h, radians=True)
    moved = earth.to_local(np.stack([ahead[1], ahead[0]], -1), origin) - earth.to_local(here, origin)
    assert np.allclose(earth.local_velocity(speed, course, here, origin), moved / h, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: earth.to_ecef([48.1, 11.5]), "radians"),
        (lambda: earth.to_ecef([0.2]), "latitudes, longitudes"),
        (lambda: earth.to_ecef(np.zeros((3, 4))), "latitudes, longitudes"),
        (lambda: earth.from_ecef([6378.0, 0.0, 0.0]), "are these metres"),
        (lambda: earth.from_ecef([1e7, 0.0]), "three coordinates"),
        (lambda: earth.to_local([0.1, 0.2], [np.nan, 0.0]), "one place"),
        (lambda: earth.to_local([0.1, 0.2], [[0.1, 0.2]]), "one place"),
        (lambda: earth.to_local([0.1, 0.2], [0.1, 0.2], "ecef"), "enu"),
        (lambda: earth.from_local([1.0], [0.1, 0.2]), "2 or 3 coordinates"),
    ],
)
def test_what_is_no_place_is_refused(call, said):
    with pytest.raises(sigmax.InputError, match=said):
        call()


def test_missing_stays_missing():
    found = earth.to_local([[0.1, np.nan], [0.1, 0.2]], (0.1, 0.2))
    assert np.isnan(found[0]).any()
    assert np.array_equal(found[1], [0.0, 0.0])
