"""A table without a description gets one that runs, is right about tracks, times, places and units, and says so."""

import datetime
import gzip
import itertools
import math
import re
import tomllib
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.files.read_table import read_table
from sigmax.models.earth import local_velocity, to_local
from sigmax.proposals.suggest import propose
from sigmax.records import load
from tests.test_cli import cli

START = datetime.datetime(2024, 5, 1, 12, tzinfo=datetime.UTC)
SEMI_MAJOR, SQUARED_ECCENTRICITY = 6378137.0, 0.00669437999014
HOME = (37.8, -122.4)


def radii(latitude: float) -> tuple[float, float]:
    """Radii of curvature in the meridian and across it: the judge of a plane near its origin."""
    w = 1 - SQUARED_ECCENTRICITY * math.sin(latitude) ** 2
    return SEMI_MAJOR * (1 - SQUARED_ECCENTRICITY) / w**1.5, SEMI_MAJOR / math.sqrt(w)


@pytest.mark.parametrize(
    "place", [(0.0, 0.0), (52.1, 4.3), (-33.9, 151.2), (89.0, 10.0), (37.8, 179.9999), (-89.9, -120.0)]
)
def test_a_step_on_the_ellipsoid_is_as_long_as_its_curvature_says(place: tuple[float, float]) -> None:
    lat, lon = map(math.radians, place)
    step = 1e-6
    meridian, across = radii(lat)
    found = to_local(np.stack([[lat + step, lat], [lon, lon + step]], -1), (lat, lon))
    np.testing.assert_allclose(found, [[0, meridian * step], [across * math.cos(lat) * step, 0]], rtol=1e-5, atol=2e-5)
    # Over the line where longitudes jump.
    np.testing.assert_allclose(
        to_local(np.stack([[lat], [lon - math.copysign(2 * math.pi, lon) + step]], -1), (lat, lon))[0],
        found[1],
        atol=1e-6,
    )


def test_a_velocity_is_the_change_of_the_position() -> None:
    rng = np.random.default_rng(1)
    origin = tuple(map(math.radians, HOME))
    for _ in range(50):
        lat, lon = origin[0] + rng.uniform(-0.05, 0.05), origin[1] + rng.uniform(-0.05, 0.05)
        course, dt = rng.uniform(0, 2 * math.pi), 1e-2
        meridian, across = radii(lat)
        later = lat + 20 * math.cos(course) * dt / meridian, lon + 20 * math.sin(course) * dt / across / math.cos(lat)
        both = to_local(np.stack([[lat, later[0]], [lon, later[1]]], -1), origin)
        said = local_velocity(np.array([20.0]), np.array([course]), np.array([[lat, lon]]), origin)
        np.testing.assert_allclose(said[0], (both[1] - both[0]) / dt, atol=1e-4)


def world(steps: int = 12, dt: float = 10.0) -> pd.DataFrame:
    """Two ships in turn, in plain terms: seconds, a name, degrees, metres, m/s, radians."""
    rows = []
    for k, (name, north, east, speed, course) in itertools.product(
        range(steps), ((366999001, 0.0, 0.0, 8.0, 0.6), (366999002, 3000.0, -5000.0, 12.0, 2.5))
    ):
        t = k * dt + (name % 2)
        x, y = east + speed * t * math.sin(course), north + speed * t * math.cos(course)
        meridian, across = radii(math.radians(HOME[0]))
        lat = HOME[0] + math.degrees(y / meridian)
        lon = HOME[1] + math.degrees(x / across / math.cos(math.radians(HOME[0])))
        rows.append((t, name, lat, lon, x, y, speed, math.degrees(course)))
    return pd.DataFrame(rows, columns=["t", "id", "lat", "lon", "x", "y", "speed", "course"])


def at(w: pd.DataFrame, form: str) -> list[str]:
    return [(START + datetime.timedelta(seconds=t)).strftime(form) for t in w.t]


def epoch(scale: float) -> Callable[[pd.DataFrame], Any]:
    return lambda w: ((START.timestamp() + w.t) * scale).round().astype("int64")


KNOT = 1852 / 3600
TIMES: dict[str, Callable[[pd.DataFrame], Any]] = {
    "BaseDateTime": lambda w: at(w, "%Y-%m-%dT%H:%M:%S"),
    "timestamp": epoch(1e3),
    "time": epoch(1),
    "ts": epoch(1e6),
    "epoch": epoch(1e9),
    "utc_time": lambda w: at(w, "%Y-%m-%dT%H:%M:%SZ"),
    "DateTime": lambda w: at(w, "%Y-%m-%d %H:%M:%S+02:00"),
    "# Timestamp": lambda w: at(w.assign(t=w.t + 86400 * 20), "%d/%m/%Y %H:%M:%S"),
    "time_ms": lambda w: (w.t * 1000).astype(int),
    "t": lambda w: w.t,
}
IDS = ("MMSI", "icao24", "track_id", "TrackID", "id", "callsign", "vessel_name", "Object ID", "hex", "target")
PLACES = (
    ("LAT", "LON"),
    ("Latitude", "Longitude"),
    ("lat", "lng"),
    ("latitude_deg", "longitude_deg"),
    ("gps_lat", "gps_lon"),
)
SPEEDS = {"SOG": KNOT, "speed_kmh": 1 / 3.6, "groundspeed": KNOT, "velocity": 1.0, "speed": 1 / 3.6}
COURSES = ("COG", "heading", "track", "course_over_ground", "true_track")
HEADERS = [
    (time, IDS[i % len(IDS)], PLACES[i % len(PLACES)], [*SPEEDS][i % len(SPEEDS)], COURSES[(i * 3) % len(COURSES)])
    for i, time in enumerate([*TIMES, *TIMES])
]


def written(path: Path, table: pd.DataFrame, **options: Any) -> Path:
    table.to_csv(path, index=False, **options)
    return path


def described(path: Path) -> tuple[sigmax.records.Record, tuple[str, ...]]:
    """The record that the proposal for a table describes, and what is said of it."""
    toml, remarks = propose(path)
    beside = path.with_name("proposal.toml")
    beside.write_text(toml, encoding="utf-8")
    return load(str(beside)), remarks


@pytest.mark.parametrize("header", HEADERS, ids=lambda h: f"{h[0]}-{h[1]}")
def test_places_on_the_earth_become_metres_and_each_name_a_track(header: Any, tmp_path: Path) -> None:
    """AIS, ADS-B and GPS logs in many hands: the positions, speeds and times that come out are those of the world."""
    time, name, (lat, lon), speed, course = header
    w = world()
    columns = {
        name: w.id, time: TIMES[time](w), lat: w.lat, lon: w.lon, speed: w.speed / SPEEDS[speed], course: w.course
    }  # fmt: skip
    record, remarks = described(written(tmp_path / "log.csv", pd.DataFrame(columns)))
    assert record.tracks == tuple(map(str, w.id.unique()))
    for k, (_, own) in enumerate(w.groupby("id", sort=False)):
        np.testing.assert_allclose(record.time[k] - record.time[0, 0], own.t - w.t[0], atol=2e-6)
        moved = own[["x", "y"]].to_numpy()[1:] - w[["x", "y"]].to_numpy()[0]
        np.testing.assert_allclose(record.z["report"][k, 1:], moved, atol=2)
        a = np.radians(own.course)
        velocity = np.column_stack([own.speed * np.sin(a), own.speed * np.cos(a)])
        np.testing.assert_allclose(record.z["velocity"][k], velocity, atol=0.05)
    told = " ".join(remarks)
    assert f"{w.lat[0]:.7f}" in told
    assert f"{w.lon[0]:.7f}" in told
    assert f"{name!r} tells 2 tracks apart" in told


def plane(w: pd.DataFrame) -> pd.DataFrame:
    return pd.DataFrame({"time": w.t, "id": w.id, "x": w.x.round(3), "y": w.y.round(3)})


RADARS = [
    ("time", "range_km", "azimuth_deg", 1e-3, "deg"),
    ("t", "range", "bearing", 1.0, "deg"),
    ("Timestamp", "slant_range_m", "az_rad", 1.0, "rad"),
    ("utc", "rho", "theta", 1.0, "rad"),
    ("time_s", "Range_nmi", "Azimuth", 1 / 1852, "deg"),
]


@pytest.mark.parametrize("header", RADARS, ids=lambda h: h[1])
def test_range_and_azimuth_become_a_radar(header: tuple[str, str, str, float, str], tmp_path: Path) -> None:
    time, reach, angle, scale, turn = header
    w = world()
    w[["x", "y"]] += [20e3, 9e3]
    azimuth = np.arctan2(w.x, w.y)
    columns = {time: w.t, "track_no": w.id, reach: np.hypot(w.x, w.y) * scale,
               angle: np.degrees(azimuth) if turn == "deg" else azimuth}  # fmt: skip
    record, remarks = described(written(tmp_path / "plots.csv", pd.DataFrame(columns)))
    assert record.tracks == tuple(map(str, w.id.unique()))
    own = w[w.id == 366999002].iloc[1:]
    np.testing.assert_allclose(record.z["radar"][1, 1:, 0], np.hypot(own.x, own.y), rtol=1e-9)
    np.testing.assert_allclose(record.z["radar"][1, 1:, 1], np.arctan2(own.x, own.y), rtol=1e-9)
    np.testing.assert_allclose(record.prior.mean[1, :2], w[["y", "x"]].iloc[1], rtol=1e-9)
    assert any("radar" in remark for remark in remarks)


BEACONS = [("d1", "d2", "d3"), ("range_0", "range_1"), ("anchor1_range", "anchor2_range"), ("dist_a1_m", "dist_a2_m")]


@pytest.mark.parametrize("names", BEACONS, ids=lambda n: n[0])
def test_distances_to_beacons_are_not_taken_for_a_position(names: tuple[str, ...], tmp_path: Path) -> None:
    table = pd.DataFrame({"time": np.arange(5.0)} | {name: 5 + np.arange(5.0) for name in names})
    with pytest.raises(InputError, match=r'look like distances to beacons.*kind = "range_only"'):
        propose(written(tmp_path / "uwb.csv", table))


PLACED = [("range", "ax", "ay"), ("range_m", "anchor_x", "anchor_y"), ("dist", "BeaconX", "BeaconY"),
          ("r", "station_pos_x_m", "station_pos_y_m"), ("distance", "bs_east", "bs_north")]  # fmt: skip


@pytest.mark.parametrize("names", PLACED, ids=lambda n: n[1])
def test_distances_with_the_places_of_their_beacons_become_a_sensor_that_finds_the_target(
    names: tuple[str, str, str], tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(120) * 0.25
    which = np.arange(120) % 4
    at = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])[which]
    truth = np.column_stack([8 + 0.4 * t, 5 + 0.2 * t])
    measured = np.linalg.norm(truth - at, axis=1) + 0.1 * rng.standard_normal(120)
    table = pd.DataFrame({"t": t, "anchor": which, names[1]: at[:, 0], names[2]: at[:, 1], names[0]: measured})
    record, remarks = described(written(tmp_path / "uwb.csv", table))
    assert record.tracks == ("1",)
    assert any("distance to a beacon" in remark for remark in remarks)
    outcome = sigmax.records.track(record, record.trials[0])
    error = np.asarray(outcome.result.mean)[0, :, :2] - truth
    assert np.linalg.norm(error[60:], axis=1).max() < 1.0


def test_accelerations_are_no_places_of_beacons(tmp_path: Path) -> None:
    t = np.arange(20.0)
    measured = pd.DataFrame({"t": t, "range": 100 + t, "ax": np.sin(t), "ay": np.cos(t)})
    with pytest.raises(InputError, match="'range' looks like a distance to a beacon"):
        propose(written(tmp_path / "d.csv", measured))
    record, _ = described(written(tmp_path / "d.csv", measured.assign(bearing_deg=t)))
    assert set(record.z) == {"radar"}


FORMATS: dict[str, Callable[[Path, pd.DataFrame], Path]] = {
    "comma": lambda folder, t: written(folder / "d.csv", t),
    "semicolon": lambda folder, t: written(folder / "d.csv", t, sep=";"),
    "tab": lambda folder, t: written(folder / "d.tsv", t, sep="\t"),
    "text": lambda folder, t: written(folder / "d.txt", t, sep="\t"),
    "bar": lambda folder, t: written(folder / "d.csv", t, sep="|"),
    "windows": lambda folder, t: written(folder / "d.csv", t, lineterminator="\r\n"),
    "mark": lambda folder, t: written(folder / "d.csv", t, encoding="utf-8-sig"),
    "quotes": lambda folder, t: written(folder / "d.csv", t, quoting=1),
    "packed": lambda folder, t: written(folder / "d.csv.gz", t),
    "comma for a point": lambda folder, t: written(folder / "d.csv", t, sep=";", decimal=","),
    "of Excel": lambda folder, t: excel(folder / "d.csv", t),
    "Parquet": lambda folder, t: parquet(folder / "d.parquet", t),
    "Parquet by time": lambda folder, t: parquet(folder / "d.parquet", t.set_index("time")),
    "Parquet by categories": lambda folder, t: parquet(
        folder / "d.parquet", t.astype({"id": "category", "x": "category"})
    ),
    "Parquet with nullable numbers": lambda folder, t: parquet(folder / "d.parquet", t.convert_dtypes()),
    "Parquet of text": lambda folder, t: parquet(folder / "d.parquet", t.astype(str)),
}


def excel(path: Path, table: pd.DataFrame) -> Path:
    text = table.to_csv(index=False, sep=";", decimal=",", lineterminator="\r\n")
    path.write_bytes(b"\xef\xbb\xbfsep=;\r\n" + text.encode())
    return path


def parquet(path: Path, table: pd.DataFrame) -> Path:
    table.to_parquet(path)
    return path


@pytest.mark.parametrize("form", FORMATS)
def test_however_a_table_is_written_it_says_the_same(form: str, tmp_path: Path) -> None:
    w = world()
    record, _ = described(FORMATS[form](tmp_path, plane(w)))
    assert record.tracks == tuple(map(str, w.id.unique()))
    for k, (_, own) in enumerate(w.groupby("id", sort=False)):
        np.testing.assert_allclose(record.z["position"][k, 1:], own[["x", "y"]][1:], atol=1e-3)
        np.testing.assert_allclose(record.time[k], own.t)


EMPTY = ("", "NaN", "nan", "NA", "N/A", "null", "None", "<NA>", "#N/A", "-", " ")


@pytest.mark.parametrize("empty", EMPTY)
def test_whatever_stands_for_nothing_is_missing(empty: str, tmp_path: Path) -> None:
    table = plane(world()).astype(str)
    table.loc[6, ["x", "y"]] = empty
    record, _ = described(written(tmp_path / "d.csv", table))
    assert np.isnan(record.z["position"][0, 3]).all()
    assert np.isnan(record.z["position"]).sum() == 6  # and the two that begin the tracks


NOTHINGS: dict[str, Callable[[], Any]] = {
    "None among objects": lambda: pd.array([1.5, None, 3.5, 4.5], dtype=object),
    "NA among integers": lambda: pd.array([1, pd.NA, 3, 4], dtype="Int64"),
    "NA among floats": lambda: pd.array([1.5, pd.NA, 3.5, 4.5], dtype="Float64"),
    "NaN": lambda: np.array([1.5, np.nan, 3.5, 4.5]),
    "None among decimals": lambda: pd.array([Decimal("1.5"), None, Decimal("3.5"), Decimal("4.5")], dtype=object),
    "None among text": lambda: pd.array(["1.5", None, "3.5", "4.5"], dtype=object),
    "NA among categories": lambda: pd.Categorical([1.5, None, 3.5, 4.5]),
    "floats of half length": lambda: np.array([1.5, np.nan, 3.5, 4.5], np.float16),
    "a mask": lambda: np.ma.masked_equal([1.5, -9999.0, 3.5, 4.5], -9999.0).filled(np.nan),
}


@pytest.mark.parametrize("case", NOTHINGS)
def test_whatever_stands_for_nothing_in_parquet_is_missing(case: str, tmp_path: Path) -> None:
    pd.DataFrame({"t": range(4), "x": NOTHINGS[case](), "y": range(4)}).to_parquet(tmp_path / "d.parquet")
    x = read_table(tmp_path / "d.parquet").numbers("x")
    assert np.isnan(x).tolist() == [False, True, False, False]
    assert x[2] in (3.0, 3.5)


def test_what_the_automatic_identification_system_sends_for_nothing_is_missing(tmp_path: Path) -> None:
    w = world()
    table = pd.DataFrame({"MMSI": w.id, "BaseDateTime": TIMES["BaseDateTime"](w), "LAT": w.lat, "LON": w.lon,
                          "SOG": w.speed / KNOT, "COG": w.course})  # fmt: skip
    table.loc[4, ["LAT", "LON"]] = [91.0, 181.0]
    table.loc[8, "SOG"] = 102.3
    table.loc[10, "COG"] = 360.0
    record, _ = described(written(tmp_path / "ais.csv", table))
    assert np.isnan(record.z["report"][0, 2]).all()
    assert np.isnan(record.z["velocity"][0, [2, 4, 5]]).all()
    assert np.isnan(record.z["velocity"]).sum() == 6


@pytest.mark.parametrize("degrees", [0.0, 3.0, 5.2, 90.0, 359.0])
@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("speed", ["SOG", "speed_kmh"])
def test_units_are_those_of_the_names_unless_positions_contradict(
    degrees: float, unit: str, speed: str, tmp_path: Path
) -> None:
    """A course that never exceeds 2π is in degrees all the same; one in radians is found, and said to be a doubt."""
    t, a, pace = np.arange(30) * 10.0, np.radians(degrees + np.linspace(-0.3, 0.3, 30)) % (2 * math.pi), 7.0
    a = a if degrees else np.zeros(30)
    meridian, across = radii(math.radians(HOME[0]))
    north, east = (np.concatenate([[0], np.cumsum(pace * 10 * f(a[:-1]))]) for f in (np.cos, np.sin))
    table = pd.DataFrame({"MMSI": 366999001, "BaseDateTime": at(pd.DataFrame({"t": t}), "%Y-%m-%dT%H:%M:%S"),
                          "LAT": HOME[0] + np.degrees(north / meridian),
                          "LON": HOME[1] + np.degrees(east / across / math.cos(math.radians(HOME[0]))),
                          speed: pace / SPEEDS[speed], "COG": np.degrees(a) if unit == "deg" else a})  # fmt: skip
    record, remarks = described(written(tmp_path / "ais.csv", table))
    velocity = pace * np.column_stack([np.sin(a), np.cos(a)])
    np.testing.assert_allclose(record.z["velocity"][0], velocity, atol=0.05)
    said = " ".join(remarks)
    told = "'COG' in deg" if unit == "deg" or degrees == 0 else "'COG' in rad"
    assert told in said
    assert ("positions change as if it were in rad" in said) == ("in rad" in told)


def test_two_ships_are_never_merged_silently(tmp_path: Path) -> None:
    """Their column is found by its name, or because paths hang together so; without any column it is a doubt."""
    table = plane(world())
    for name in ("MMSI", "zzz", "Column 7"):
        record, remarks = described(written(tmp_path / "d.csv", table.rename(columns={"id": name})))
        assert len(record.tracks) == 2
        assert any(repr(name) in remark for remark in remarks)
    record, _ = described(written(tmp_path / "d.csv", table[["time", "x", "y"]]))
    toml = (tmp_path / "proposal.toml").read_text()
    assert len(record.tracks) == 1
    tighter = "\n".join('vx = { mean = 0, std = "4 m/s" }' if line.startswith("vx") else
                        'vy = { mean = 0, std = "4 m/s" }' if line.startswith("vy") else line
                        for line in toml.splitlines())  # fmt: skip
    written(tmp_path / "d.csv", table)
    (tmp_path / "mine.toml").write_text(tighter)
    (doubt,) = (d for d in load(str(tmp_path / "mine.toml")).doubts if "several tracks" in d)
    assert 'track = "id"' in doubt


@pytest.mark.parametrize("seed", range(6))
def test_any_order_of_rows_gives_the_same_tracks(seed: int, tmp_path: Path) -> None:
    table = plane(world()).sample(frac=1, random_state=seed)
    record, remarks = described(written(tmp_path / "d.csv", table))
    order = [record.tracks.index(str(name)) for name in (366999001, 366999002)]
    np.testing.assert_allclose(np.diff(record.time), 10.0)
    assert any("sort = true" in remark for remark in remarks)
    np.testing.assert_allclose(record.z["position"][order[0], 1:, 0], world()[world().id == 366999001].x[1:], atol=1e-3)


# Without dates nothing tells of which day a second track is that comes after days of the first.
CLOCKS = [
    *(("%H:%M:%S", dt, order) for dt in (1.0, 60.0) for order in ("one track", "in turn", "one after another")),
    *(("%H:%M:%S.%f", 0.75, order) for order in ("one track", "one after another")),
    *(("%H:%M:%S", dt, order) for dt in (3600.0, 7200.0) for order in ("one track", "in turn")),
]


@pytest.mark.parametrize(("form", "dt", "tracks"), CLOCKS)
def test_a_clock_without_a_date_goes_on_past_midnight(form: str, dt: float, tracks: str, tmp_path: Path) -> None:
    """Rows keep their order, no time is lost, and it is said; the judge knows the date that the file leaves out."""
    seconds = np.arange(60) * dt
    w = pd.DataFrame({"s": seconds, "x": 3 * seconds, "y": -2 * seconds})
    names = ("1",) if tracks == "one track" else ("7", "8")
    parts = [w.assign(id=name, y=w.y + 1e4 * k) for k, name in enumerate(names)]
    w = pd.concat(parts).reset_index(drop=True)
    w = w.sort_values("s", kind="stable") if tracks == "in turn" else w
    begin = datetime.datetime(2024, 5, 1, 23, 59, 30)
    w["time"] = [(begin + datetime.timedelta(seconds=s)).strftime(form) for s in w.s]
    record, remarks = described(written(tmp_path / "d.csv", w[["time", *(["id"] if len(names) > 1 else []), "x", "y"]]))
    assert record.tracks == names
    for k in range(len(names)):
        np.testing.assert_allclose(record.time[k] - record.time[0, 0], seconds, atol=1e-6)
        np.testing.assert_allclose(record.z["position"][k, 1:, 0], 3 * seconds[1:], atol=1e-6)
    for said in (remarks, record.doubts):
        assert any("has no date and passes midnight" in one for one in said)
    assert not any("order" in one for one in remarks)


def test_a_clock_that_falls_by_hours_is_not_sorted_and_a_late_row_is(tmp_path: Path) -> None:
    rows = [f"{h:02d}:00:{s:02d},{s}.5,2.5" for h in (18, 8) for s in range(10)]
    (tmp_path / "d.csv").write_text("\n".join(["time,x,y", *rows]))
    toml, remarks = propose(tmp_path / "d.csv")
    assert "sort" not in toml
    assert any("may be out of order, or of another day" in one for one in remarks)
    rows = [f"12:00:{s:02d},{s}.5,2.5" for s in (0, 1, 3, 2, 4, 5)]
    (tmp_path / "d.csv").write_text("\n".join(["time,x,y", *rows]))
    record, _ = described(tmp_path / "d.csv")
    np.testing.assert_allclose(record.time[0], np.arange(6))
    table = pd.DataFrame({"seconds": (86370 + np.arange(60.0)) % 86400, "x": np.arange(60.0), "y": 1.0})
    toml, remarks = propose(written(tmp_path / "d.csv", table))
    assert "sort" not in toml
    assert any("counts from midnight" in one for one in remarks)


def test_equal_times_throughout_are_a_doubt(tmp_path: Path) -> None:
    table = pd.DataFrame({"time": 5.0, "x": np.arange(20.0), "y": np.arange(20.0) ** 2})
    record, remarks = described(written(tmp_path / "d.csv", table))
    assert any("No time passes from row to row" in one for one in remarks)
    assert any("No time passes from row to row" in one for one in record.doubts)


RADAR = """
data = "d.csv"
time = {time}
[motion]
kind = "constant_velocity"
noise = {{ density = 0.1 }}
[sensors.radar]
kind = "range_azimuth"
columns = {{ range = "r", azimuth = {azimuth} }}
noise = {{ range = 5, azimuth = 0.01 }}
[sensors.gps]
kind = "position"
columns = {{ x = "x", y = "y" }}
noise = {{ x = 1, y = 1 }}
[prior]
x = {{ mean = 0, std = 100 }}
y = {{ mean = 0, std = 100 }}
vx = {{ mean = 0, std = 10 }}
vy = {{ mean = 0, std = 10 }}
"""
DOUBTS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str, str]] = {
    "degrees": (lambda d: d.assign(az=np.degrees(d.az)), "unit = \"deg\"", "radar.columns.azimuth is read in radians"),
    "milliseconds by size": (lambda d: d.assign(t=1.7e12 + d.t * 1e3), "unit = \"ms\"", "since 1970 in ms"),
    "milliseconds by pace": (lambda d: d.assign(t=d.t * 1e6), "unit of the time", "targets move at"),
    "microseconds by size": (lambda d: d.assign(t=1.7e15 + d.t * 1e6), "unit = \"us\"", "since 1970 in us"),
    "rows twice": (lambda d: pd.concat([d, d.iloc[[3, 5]]]).sort_values("t"), "remove them", "2 rows say the same"),
    "a number for none": (lambda d: d.assign(r=d.r.where(d.index % 4 > 0, -9999)), "missing = -9999", "-9999 in 5"),
}  # fmt: skip


def test_a_radar_alone_tells_by_its_pace_that_time_is_in_milliseconds(tmp_path: Path) -> None:
    t = np.arange(0.0, 200.0, 10.0)
    x, y = 5000 + 30 * t, 3000 - 40 * t
    polar = {"r": np.hypot(x, y), "az": np.arctan2(y, x)}
    text = RADAR.format(time='"t"', azimuth='"az"')
    (tmp_path / "d.toml").write_text(text[: text.index("[sensors.gps]")] + text[text.index("[prior]") :])
    for scale, told in ((1.0, False), (1e5, True)):
        written(tmp_path / "d.csv", pd.DataFrame({"t": t * scale} | polar))
        assert any("unit of the time" in doubt for doubt in load(str(tmp_path / "d.toml")).doubts) == told


@pytest.mark.parametrize("case", [None, *DOUBTS])
def test_what_looks_meant_otherwise_is_a_doubt_with_a_remedy(case: str | None, tmp_path: Path) -> None:
    t = np.arange(0.0, 200.0, 10.0)
    x, y = 50 + 3 * t, 30 - 4 * t
    good = pd.DataFrame({"t": t, "x": x, "y": y, "r": np.hypot(x, y), "az": np.arctan2(y, x)})
    change, remedy, words = (lambda d: d, "", "") if case is None else DOUBTS[case]
    written(tmp_path / "d.csv", change(good))
    (tmp_path / "d.toml").write_text(RADAR.format(time='"t"', azimuth='"az"'))
    doubts = load(str(tmp_path / "d.toml")).doubts
    if case is None:
        assert doubts == ()
    else:
        assert any(words in d and remedy in d for d in doubts), doubts


def test_a_decimal_comma_is_named_and_the_remedy_works(tmp_path: Path) -> None:
    table = plane(world()).astype(str).apply(lambda c: c.str.replace(".", ","))
    written(tmp_path / "d.csv", table, sep=";")
    assert any("decimal comma" in remark for remark in propose(tmp_path / "d.csv").remarks)
    (tmp_path / "d.toml").write_text(propose(tmp_path / "d.csv").toml.replace('decimal = ","\n', ""))
    with pytest.raises(InputError, match=r'has \'.*,\d\'.*write decimal = ","'):
        load(str(tmp_path / "d.toml"))
    # A point between thousands is no silent decimal point.
    table.loc[3, "x"] = "1.234,5"
    written(tmp_path / "d.csv", table, sep=";")
    (tmp_path / "d.toml").write_text('decimal = ","\n' + (tmp_path / "d.toml").read_text())
    with pytest.raises(InputError, match=r"has '1\.234,5' where a number belongs"):
        load(str(tmp_path / "d.toml"))


GROUPED = ("1.234,5", "1,234.5", "1.234.567", "1,234,567", "12.345.678,25", "1'234.5", "1 234,5", "-1.234,5")


@pytest.mark.parametrize("text", GROUPED)
def test_a_sign_between_thousands_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_text("time;x;y\n" + "\n".join(f"{k};{text};{text}" for k in range(4)))
    with pytest.raises(InputError, match=f"{text!r}.*no sign may stand between thousands") as refused:
        propose(tmp_path / "d.csv")
    assert ("decimal comma" in str(refused.value)) == (text[-2] == "," or text[-3] == ",")
    plain = re.search("write (.*) for it", str(refused.value))[1].replace(",", ".")
    assert float(plain) in (1234.5, 1234567.0, 12345678.25, -1234.5)


REFUSED = {
    "one distance": (b"time,range\n1,2\n2,3\n", "a time and two"),
    "one distance and a name": (b"time,anchor,range\n1,a,2\n2,b,3\n", "'range' looks like a distance to a beacon"),
    "nothing": (b"", "is empty"),
    "a header alone": (b"time,x,y\r\n", "no rows of data"),
    "no header": (b"1,2,3\n2,3,4\n", "needs a header line"),
    "bytes": (bytes(range(256)) * 20, "no text"),
    "zeros": (b"\0" * 100, "no text"),
    "UTF-16": ("time,x,y\n1,2,3\n".encode("utf-16"), "UTF-8"),
    "a letter of Windows": ("time,x,y,Länge\n1,2,3,4\n".encode("cp1252"), "UTF-8"),
    "a letter of Windows below": ("time,x,y,note\n1,2,3,Länge\n".encode("cp1252"), "UTF-8"),
    "two columns": (b"t,x\n1,2\n", "are the least"),
    "text alone": (b"a,b,c\nx,y,z\n", "looks like a time"),
    "one number": (b"t,a,b\n1,x,y\n", "two columns of numbers"),
    "a quotation mark": (b't,x,y\n1,"2,3\n4,5,6\n', "ragged|quotation"),
    "degrees and minutes": (b"time,id,lat,lon\n1,7,5230.123,412.5\n2,7,5230.2,413.5\n", "no latitude in degrees"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_table_that_gives_no_proposal_is_refused_in_words(case: str, tmp_path: Path) -> None:
    content, words = REFUSED[case]
    (tmp_path / "d.csv").write_bytes(content)
    with pytest.raises(InputError, match=words):
        propose(tmp_path / "d.csv")
    (tmp_path / "d.csv.gz").write_bytes(gzip.compress(content))
    with pytest.raises(InputError, match=words):
        propose(tmp_path / "d.csv.gz")
    (tmp_path / "d.csv.gz").write_bytes(gzip.compress(content * 50 + b"1")[:-12])
    with pytest.raises(InputError):
        propose(tmp_path / "d.csv.gz")


def test_what_is_redirected_is_the_proposal_and_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The explanations go to standard error, so that a file of the output is a description."""
    monkeypatch.chdir(tmp_path)
    w = world()
    ships = pd.DataFrame({"MMSI": w.id, "BaseDateTime": TIMES["BaseDateTime"](w), "LAT": w.lat, "LON": w.lon})
    written(tmp_path / "my ships'.csv", ships)
    assert cli("track", "my ships'.csv") == 2
    told = capsys.readouterr()
    assert tomllib.loads(told.out)["track"] == "MMSI"
    assert "37.8" in told.err
    (tmp_path / "ships.toml").write_text(told.out)
    assert cli("track", "ships.toml", "-f", "EKF", "--out", "out") == 0
    estimates = pd.read_parquet("out/estimates.parquet")
    assert sorted(estimates["track"].unique()) == ["366999001", "366999002"]
    fit = estimates[estimates["track"] == "366999002"].iloc[-1]
    np.testing.assert_allclose(fit[["east", "north"]].astype(float), w.iloc[-1][["x", "y"]].astype(float), atol=15)
    written(tmp_path / "odd.csv", ships.rename(columns={"LAT": 'lat\n"<script>'}))
    (tmp_path / "odd.toml").write_text(propose(tmp_path / "odd.csv").toml)
    assert len(load("odd.toml").tracks) == 2


def test_a_place_too_far_or_no_place_is_refused_with_a_remedy(tmp_path: Path) -> None:
    w = world()
    table = pd.DataFrame({"mmsi": w.id, "time": w.t, "lat": w.lat, "lon": w.lon})
    path = written(tmp_path / "d.csv", table)
    toml = propose(path).toml
    table.loc[5, "lat"] = -37.8
    written(path, table)
    (tmp_path / "d.toml").write_text(toml)
    with pytest.raises(InputError, match=r"row 7 of d.csv lies \d+ km from the origin.*within = "):
        load(str(tmp_path / "d.toml"))
    (tmp_path / "d.toml").write_text(toml.replace("[local]", '[local]\nwithin = "900 km"'))
    assert np.isnan(load(str(tmp_path / "d.toml")).z["report"]).sum() == 6
    # What the proposal for such a file says by itself.
    record, remarks = described(path)
    assert np.isnan(record.z["report"]).sum() == 6
    assert any("1 of 24 rows" in remark for remark in remarks)
    (tmp_path / "d.toml").write_text(toml.replace('column = "lat", unit = "deg"', 'column = "lat"'))
    with pytest.raises(InputError, match='no latitude; if these are degrees, add unit = "deg"'):
        load(str(tmp_path / "d.toml"))


@pytest.mark.parametrize("name", ["SolentAIS_20160112_130211", "OpenSky_Plane_States", "UAV_Rot"])
def test_real_logs_get_proposals_that_hold(name: str, tmp_path: Path) -> None:
    """A harbour's AIS, aircraft over Britain, a drone: a track for each name, positions that move as speeds say."""
    source = Path(__file__).parents[3] / "shared" / "data" / "stonesoup" / f"{name}.csv.gz"
    if not source.exists():
        pytest.skip(f"the data set {source.name} is not there")
    path = tmp_path / source.name
    path.write_bytes(source.read_bytes())
    record, _ = described(path)
    table = pd.read_csv(source)
    names = {"MMSI", "icao24"} & set(table.columns)
    assert len(record.tracks) == (table[names.pop()].nunique() if names else 1)
    assert "velocity" in record.z
