"""Sensors of receivers and vehicles: what they measure by NumPy and PROJ, and what filters find, on both engines."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pyproj
import pytest

import sigmax
from sigmax import motions, sensors
from sigmax.errors import InputError
from sigmax.models.earth import to_ecef
from sigmax.records import load

LIGHT, RATE = 299792458.0, 7.2921151467e-5
PLACE = np.array([4.1e6, 6.2e5, 4.8e6])
SATELLITES = np.array(
    [[1.5e7, 1.2e7, 1.8e7], [2.2e7, -9e6, 1.1e7], [9e6, 1.9e7, 1.6e7], [2.3e7, 5e6, 1.3e7], [8e6, -9e6, 2.4e7]]
)


def flight_time_range(satellite: np.ndarray, place: np.ndarray) -> float:
    """The range in the frame that turned during the flight of the signal: iterated, no formula of first order."""
    tau = 0.07
    for _ in range(10):
        a = RATE * tau
        turned = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ satellite
        tau = np.linalg.norm(turned - place) / LIGHT
    return LIGHT * tau


def test_a_pseudorange_is_the_flight_of_light_on_a_turning_earth() -> None:
    seen = sensors.pseudorange(system=4)
    for satellite in SATELLITES:
        x = np.array([*PLACE, 120.0, 7.0])
        got = [float(seen.function(x, np.array([*satellite, other]))[0]) for other in (0.0, 1.0)]
        assert got[0] == pytest.approx(flight_time_range(satellite, PLACE) + 120, abs=2e-3)
        assert got[1] - got[0] == pytest.approx(7, abs=1e-6)
        still = sensors.pseudorange(earth=False).function(x[:4], satellite)[0]
        assert float(still) == pytest.approx(np.linalg.norm(satellite - PLACE) + 120, abs=1e-6)
        # The turn is some ten metres: a law that could not tell it would be none.
        assert abs(float(still) - got[0]) > 1


def test_its_rate_is_its_derivative() -> None:
    v, w, dt = np.array([30.0, -20.0, 10.0]), np.array([-2000.0, 2500.0, 1000.0]), 1e-3
    seen = sensors.pseudorange_rate()
    for satellite in SATELLITES:
        got = seen.function(np.array([*PLACE, *v, 0.4]), np.array([*satellite, *w]))[0]
        ends = [np.linalg.norm(satellite + w * t - PLACE - v * t) for t in (-dt, dt)]
        assert float(got) == pytest.approx((ends[1] - ends[0]) / (2 * dt) + 0.4, abs=1e-4)


def test_time_differences_ranges_and_bearings_are_those_of_numpy() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        x, a, b = rng.normal(size=(3, 3)) * 100
        got = sensors.time_difference((0, 1, 2), tuple(a), tuple(b), 343.0).function(x)[0]
        want = (np.linalg.norm(x - a) - np.linalg.norm(x - b)) / 343
        assert float(got) == pytest.approx(want, rel=1e-10)
        assert float(sensors.time_difference((0, 1, 2), speed=343.0).function(x, np.array([*a, *b]))[0]) == float(got)
        distance, bearing = sensors.range_bearing().function(x, a[:2])
        back = x[:2] + distance * np.array([np.cos(x[2] + bearing), np.sin(x[2] + bearing)])
        np.testing.assert_allclose(back, a[:2], rtol=1e-10)
        of_target = sensors.vehicle_range_bearing().function(a, x)
        np.testing.assert_allclose(of_target, [distance, bearing], rtol=1e-12)


def test_azimuth_and_elevation_of_a_satellite_are_those_of_proj() -> None:
    site = 50.0, 8.0, 300.0
    up = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=topocentric +ellps=WGS84 +lat_0=50 +lon_0=8 +h_0=300"
    )
    place = to_ecef(np.array([*np.radians(site[:2]), site[2]]))
    lat, lon = np.radians(site[:2])
    # North, east, up: the azimuth is clockwise from north.
    axes = [
        [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
        [-np.sin(lon), np.cos(lon), 0],
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
    ]
    seen = sensors.azimuth_elevation(origin=tuple(place), axes=axes)
    for satellite in SATELLITES:
        east, north, height = up.transform(*satellite)
        got = np.asarray(seen.function(satellite))
        want = np.arctan2(east, north), np.arctan2(height, np.hypot(east, north))
        np.testing.assert_allclose(got, want, atol=1e-8)
    with pytest.raises(InputError, match="perpendicular"):
        sensors.azimuth_elevation(axes=np.ones((3, 3)))


SINGULAR = {
    "pseudorange": (sensors.pseudorange(), np.zeros(4), np.zeros(3)),
    "pseudorange_rate": (sensors.pseudorange_rate(), np.zeros(7), np.zeros(6)),
    "time_difference": (sensors.time_difference(), np.zeros(2), np.zeros(4)),
    "azimuth_elevation": (sensors.azimuth_elevation(), np.zeros(3), None),
    "overhead": (sensors.azimuth_elevation(), np.array([0.0, 0.0, 5.0]), None),
    "range_bearing": (sensors.range_bearing(), np.zeros(3), np.zeros(2)),
    "vehicle_range_bearing": (sensors.vehicle_range_bearing(), np.zeros(2), np.zeros(3)),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_value_and_derivatives_are_finite_where_the_textbook_divides_by_zero(name: str) -> None:
    sensor, x, u = SINGULAR[name]
    arguments = (x,) if u is None else (x, u)
    once = jax.jacfwd(sensor.function)
    value, slope, bend = jax.jit(lambda *a: (sensor.function(*a), once(*a), jax.jacfwd(once)(*a)))(*arguments)
    assert all(np.isfinite(found).all() for found in (value, slope, bend))


def receiver() -> tuple[sigmax.Model, sigmax.Gaussian, dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """A receiver at walking pace with a clock that drifts; a satellite of another system, and a pair of stations."""
    motion = motions.join(motions.constant_velocity(("x", "y", "z")), motions.constant_velocity(("clock",)))
    motion = motions.join(motion, motions.random_walk(("system",)))
    at = (0, 1, 2)
    rng, rows = np.random.default_rng(3), 60
    x = np.zeros((rows, 9))
    x[:, 3:6] = 1.0, -1.0, 0.5
    t = np.arange(rows)[:, None]
    x[:, :3] = PLACE + t * x[:, 3:6]
    x[:, 7], x[:, 8] = 2.0, 35.0
    x[:, 6] = 100 + 2.0 * t[:, 0]
    which = np.arange(rows) % 5
    other = (which == 4).astype(float)
    u = np.column_stack([SATELLITES[which], other, 0 * SATELLITES[which]])
    exact = [flight_time_range(SATELLITES[w], p[:3]) + p[6] + o * p[8] for w, o, p in zip(which, other, x, strict=True)]
    line = (SATELLITES[which] - x[:, :3]) / np.linalg.norm(SATELLITES[which] - x[:, :3], axis=1)[:, None]
    rate = x[:, 7] - (line * x[:, 3:6]).sum(1)
    z = {
        "code": np.array(exact)[:, None] + 0.5 * rng.normal(size=(rows, 1)),
        "doppler": rate[:, None] + 0.01 * rng.normal(size=(rows, 1)),
    }
    code, doppler = sensors.pseudorange(at, 6, 8), sensors.pseudorange_rate(at, (3, 4, 5), 7)
    model = sigmax.Model(
        motion=motion.function,
        state=motion.state,
        Q=np.full(9, 1e-9),
        sensor={
            "code": lambda x, u: code.function(x, u[:4]),
            "doppler": lambda x, u: doppler.function(x, jnp.concatenate([u[:3], u[4:]])),
        },
        measurement={"code": code.measurement, "doppler": doppler.measurement},
        R={"code": [0.25], "doppler": [1e-4]},
    )
    cov = np.diag([100.0, 100, 100, 4, 4, 4, 1e4, 100, 1e4])
    mean = x[0] + np.random.default_rng(4).multivariate_normal(np.zeros(9), cov)
    return model, sigmax.Gaussian(mean, cov), z, u, x


def test_position_clock_and_the_offset_of_another_system_come_out() -> None:
    model, prior, z, u, x = receiver()
    found = sigmax.run("SREKF", model, prior, z, dt=1.0, inputs=u, update_first=True)
    error = found.mean[-1] - x[-1]
    nees = error @ np.linalg.solve(found.cov[-1], error)
    assert 1 < nees < 25
    assert np.abs(error[:3]).max() < 3
    assert found.std[-1, 8] < 2


@pytest.mark.slow
def test_both_engines_compute_the_same() -> None:
    model, prior, z, u, _ = receiver()
    native, xla = (
        sigmax.run("SREKF", model, prior, z, dt=1.0, inputs=u, backend=backend, update_first=True)
        for backend in ("native", "xla")
    )
    np.testing.assert_allclose(native.mean, xla.mean, rtol=1e-9, atol=1e-6)


DESCRIPTION = """
data = "d.csv"
time = "t"
filters = ["SREKF"]

[[motion]]
kind = "constant_velocity"
axes = ["x", "y", "z"]
noise = {{ density = 1 }}

[[motion]]
kind = "constant_velocity"
axes = ["clock"]
noise = {{ density = 0.01 }}

[[motion]]
kind = "random_walk"
state = {{ heading = "rad", galileo = "m" }}
noise = {{ heading = 0.01, galileo = 0.01 }}

[sensors.a]
{sensor}
[prior]
{prior}
"""
SATELLITE = 'satellite_x = "a", satellite_y = "b", satellite_z = { column = "c", unit = "km" }'
KINDS = {
    "pseudorange": (
        'kind = "pseudorange"\nsystem = "galileo"\ncolumns = { pseudorange = "z" }\nnoise = { pseudorange = "3 m" }\n'
        f'inputs = {{ {SATELLITE}, other_system = "d" }}',
        lambda x, u: sensors.pseudorange((0, 1, 2), 6, 9).function(x, u),
        [1, 1, 1e3, 1],
    ),
    "pseudorange_rate": (
        'kind = "pseudorange_rate"\ncolumns = { pseudorange_rate = "z" }\nnoise = { pseudorange_rate = "1 m/s" }\n'
        f'inputs = {{ {SATELLITE}, satellite_vx = "d", satellite_vy = "d", '
        'satellite_vz = { column = "d", unit = "km/h" } }',
        lambda x, u: sensors.pseudorange_rate((0, 1, 2), (3, 4, 5), 7).function(x, u),
        None,
    ),
    "time_difference": (
        'kind = "time_difference"\norigin = [0, 0, 0]\nreference = ["1 km", 0, 0]\nspeed = "343 m/s"\n'
        'columns = { time_difference = { column = "z", unit = "ms" } }\nnoise = { time_difference = "1 ms" }',
        lambda x, u: sensors.time_difference((0, 1, 2), (0.0, 0, 0), (1e3, 0, 0), 343.0).function(x),
        [],
    ),
    "azimuth_elevation": (
        'kind = "azimuth_elevation"\ncolumns = { azimuth = "z", elevation = { column = "z", unit = "deg" } }\n'
        'noise = { azimuth = "1 deg", elevation = "1 deg" }',
        lambda x, u: sensors.azimuth_elevation().function(x),
        [],
    ),
    "range_bearing": (
        'kind = "range_bearing"\nat = ["x", "y"]\ncolumns = { range = "z", bearing = "z" }\n'
        'noise = { range = 1, bearing = 1 }\ninputs = { beacon_x = "a", beacon_y = "b" }',
        lambda x, u: sensors.range_bearing((0, 1), 8).function(x, u),
        [1, 1],
    ),
    "vehicle_range_bearing": (
        'kind = "vehicle_range_bearing"\nat = ["x", "y"]\ncolumns = { range = "z", bearing = "z" }\n'
        'noise = { range = 1, bearing = 1 }\ninputs = { vehicle_x = "a", vehicle_y = "b", vehicle_heading = "d" }',
        lambda x, u: sensors.vehicle_range_bearing((0, 1)).function(x, u),
        None,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_description_makes_the_same_sensor(kind: str, tmp_path: Path) -> None:
    sensor, function, scales = KINDS[kind]
    names = ["x", "y", "z", "vx", "vy", "vz", "clock", "vclock", "heading", "galileo"]
    prior = "\n".join(f"{n} = {{ mean = 1, std = 1 }}" for n in names)
    (tmp_path / "d.toml").write_text(DESCRIPTION.format(sensor=sensor, prior=prior))
    pd.DataFrame({"t": [0.0, 1], "z": [5.0, 6], "a": [2.0, 3], "b": [7.0, 8], "c": [9.0, 9], "d": [1.0, 1]}).to_csv(
        tmp_path / "d.csv", index=False
    )
    record = load(str(tmp_path / "d.toml"))
    assert list(map(str, record.model.state)) == names
    x = np.random.default_rng(1).normal(size=10) * 50
    u = np.zeros(0) if record.inputs is None else record.inputs[0, 0]
    if scales:
        np.testing.assert_allclose(u, np.array([2.0, 7, 9, 1][: len(scales)]) * scales)
    made = record.model.sensors["a"]
    got = made(x, u) if record.inputs is not None else made(x)
    np.testing.assert_allclose(got, function(x, u), rtol=1e-12)


CODE = 'columns = { pseudorange = "z" }'
WRONG = {
    "no clock": (f'kind = "pseudorange"\nclock = "klock"\n{CODE}', "sensors.a.clock.*did you mean clock"),
    "two components": (f'kind = "pseudorange"\nat = ["x", "y"]\n{CODE}', "must be 3 components"),
    "one station": (f'kind = "time_difference"\norigin = [0, 0, 0]\n{CODE}', "two stations"),
    "a clock of a radar": (f'kind = "range_azimuth"\nclock = "clock"\n{CODE}', "takes no 'clock'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    text, words = WRONG[case]
    (tmp_path / "d.toml").write_text(DESCRIPTION.format(sensor=text + "\nnoise = { pseudorange = 1 }", prior="x = 1"))
    with pytest.raises(InputError, match=words):
        load(str(tmp_path / "d.toml"))
