"""Records: units, tables, descriptions, the built-in runs."""

import math
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.records import check, load, parse_trial, track
from sigmax.records.motion import KINDS as MOTIONS
from sigmax.records.sensor import KINDS as SENSORS
from sigmax.records.table import read_table
from sigmax.records.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    TURN_RATE,
    Dimension,
    parse_unit,
    quantity,
)
from tests.own_records import RADAR, radar_table, tracked_radar, write_csv, write_radar


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("50 m", LENGTH, 50),
        ("0.05 km", LENGTH, 50),
        ("10ft", LENGTH, 3.048),
        ("2 nmi", LENGTH, 3704),
        ("180 deg", ANGLE, math.pi),
        ("90 °/s", TURN_RATE, math.pi / 2),
        ("36 km/h", SPEED, 10),
        ("1 kn", SPEED, 1852 / 3600),
        ("1.5e3 ms", TIME, 1.5),
        ("2 g", ACCELERATION, 19.6133),
        ("3 km^2/h^3", Dimension(2, -3), 3e6 / 3600**3),
        ("5 m²/s³", Dimension(2, -3), 5),
        ("7 %", NUMBER, 0.07),
        (4, LENGTH, 4),
        ("-.5", LENGTH, -0.5),
    ],
)
def test_quantities_come_in_si(text: object, dimension: Dimension, value: float) -> None:
    assert quantity(text, dimension, "here") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension", "words"),
    [
        ("5 m", ANGLE, "the unit 'm' does not fit; this is an angle"),
        ("5 deg/s", ANGLE, "does not fit"),
        ("5 kmm", LENGTH, "unknown unit 'kmm'; did you mean .*km"),
        ("fast", SPEED, "not a number with a unit"),
        (True, SPEED, "not a number"),
        ([1.0], SPEED, "not a number"),
        (float("nan"), LENGTH, "not finite"),
    ],
)
def test_quantities_that_do_not_fit_are_refused(text: object, dimension: Dimension, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")) as refused:
        quantity(text, dimension, "prior.x.std")
    assert str(refused.value).startswith("prior.x.std: ")


def test_symbols_of_units_are_read_back() -> None:
    for dimension in (LENGTH, TIME, ANGLE, SPEED, ACCELERATION, TURN_RATE, Dimension(2, -3), Dimension(0, -2)):
        assert parse_unit(dimension.symbol, "here") == (1.0, dimension)


def test_trials_are_parsed() -> None:
    trial = parse_trial(" SRUKFB:alpha=0.45, beta=2,kappa=-2,fixed=range_scale ")
    assert trial.filter == sigmax.get("SRUKFB", alpha=0.45, beta=2, kappa=-2)
    assert trial.fixed == ("range_scale",)
    assert parse_trial("CIF:information=paper").filter.form.name == "information, as printed"
    for text, words in {
        "EKG": "did you mean .*EKF",
        "EKF:alpha=1": "no parameter 'alpha'",
        "UKF:alpha": "parameter=value",
        "UKF:alpha=1,alpha=2": "alpha twice",
        "UKF:alpha=one": "one",
        "": "unknown filter",
    }.items():
        with pytest.raises(InputError, match=words):
            parse_trial(text)


@pytest.fixture
def radar() -> sigmax.records.Record:
    return tracked_radar()[0]


def test_tracks_are_laid_out_in_si_and_padded(radar: sigmax.records.Record) -> None:
    table = pd.DataFrame(radar_table())
    assert radar.tracks == ("A1", "B2")
    assert radar.steps.tolist() == [30, 20]
    assert radar.position == (0, 1)
    for k, name in enumerate(radar.tracks):
        mine = table[table["aircraft"] == name]
        T = len(mine)
        np.testing.assert_allclose(radar.time[k, :T], mine["t"])
        np.testing.assert_allclose(radar.dt[k, :T], np.r_[0, np.full(T - 1, 2.0)])
        np.testing.assert_allclose(radar.z["radar"][k, 1:T, 0], mine["range_km"][1:] * 1e3, atol=1e-3)
        np.testing.assert_allclose(radar.z["radar"][k, 1:T, 1], np.radians(mine["azimuth_deg"][1:]), atol=1e-7)
        np.testing.assert_allclose(radar.truth[k, :T, 1], mine["east_km"] * 1e3, atol=1e-3)
    assert np.isnan(radar.truth[..., 2:]).all()
    assert np.isnan(radar.z["radar"][1, 20:]).all()
    assert (radar.dt[1, 20:] == 0).all()
    assert [d.symbol for d in radar.dimensions] == ["m", "m", "m/s", "m/s"]


def test_the_first_measurement_becomes_the_prior_and_counts_once(radar: sigmax.records.Record) -> None:
    table = radar_table()
    distance, azimuth = table["range_km"][0] * 1e3, math.radians(table["azimuth_deg"][0])
    place = [distance * math.cos(azimuth), distance * math.sin(azimuth)]
    np.testing.assert_allclose(radar.prior.mean[0], [*place, 0, 0], atol=1e-2)
    assert np.isnan(radar.z["radar"][0, 0]).all()
    # The covariance is that of the inverse of the sensor, by its derivative.
    J = np.linalg.inv(jax.jacfwd(radar.model.sensors["radar"])(radar.prior.mean[0])[:, :2])
    R = np.diag([30.0**2, math.radians(0.2) ** 2])
    np.testing.assert_allclose(radar.prior.cov[0, :2, :2], J @ R @ J.T, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.diag(radar.prior.cov[0])[2:], 100.0**2)


def test_a_track_is_the_same_alone_and_in_company(radar: sigmax.records.Record) -> None:
    together = tracked_radar()[1]
    assert together.failure == ""
    k, T = 1, 20
    prior = sigmax.Gaussian(radar.prior.mean[k], radar.prior.cov[k])
    z = {"radar": radar.z["radar"][k, :T]}
    alone = sigmax.run("EKF", radar.model, prior, z, dt=radar.dt[k, :T])
    np.testing.assert_allclose(together.result.mean[k, :T], alone.mean, rtol=1e-9)
    np.testing.assert_allclose(together.result.log_likelihood[k], alone.log_likelihood, rtol=1e-9)
    error = together.result.errors(radar.truth)[radar.real][:, :2]
    assert np.sqrt((error**2).sum(1).mean()) < 60


def test_three_dimensional_first_position() -> None:
    from sigmax.models import sensors
    from sigmax.records.sensor import Sensing, first_position

    made = sensors.range_azimuth((0, 1, 2), (10.0, 20.0, 30.0))
    variances = np.array([4.0, 1e-4, 4e-4])
    sensing = Sensing(made, variances, {}, {}, (0, 1, 2), (10.0, 20.0, 30.0), "range_azimuth")
    x = np.array([110.0, -180.0, 90.0])
    place, cov = first_position(sensing, np.asarray(made.function(x))[None])
    np.testing.assert_allclose(place[0], x, rtol=1e-12)
    J = np.linalg.inv(jax.jacfwd(made.function)(x))
    np.testing.assert_allclose(cov[0], J @ np.diag(variances) @ J.T, rtol=1e-9)


def test_parquet_timestamps_and_other_units_mean_the_same(tmp_path: Path, radar: sigmax.records.Record) -> None:
    table = pd.read_csv(write_radar(tmp_path).with_name("radar.csv"))
    table["when"] = pd.Timestamp("2024-05-01T12:00:00Z") + pd.to_timedelta(table["t"], unit="s")
    table.to_parquet(tmp_path / "radar.parquet")
    table["when"] = table["when"].map(lambda moment: moment.isoformat())
    table["t"] = table["t"] / 60
    table.to_csv(tmp_path / "stamped.csv", index=False, sep=";")
    by_text = RADAR.replace("radar.csv", "stamped.csv")
    for description in (
        RADAR.replace("radar.csv", "radar.parquet").replace('time = "t"', 'time = "when"'),
        by_text.replace('time = "t"', 'time = "when"'),
        by_text.replace('time = "t"', 'time = { column = "t", unit = "min" }'),
    ):
        (tmp_path / "other.toml").write_text(description)
        other = load(str(tmp_path / "other.toml"))
        np.testing.assert_allclose(other.time, radar.time, atol=1e-9)
        np.testing.assert_allclose(other.z["radar"], radar.z["radar"], rtol=1e-12)
        assert other.epoch == (pd.Timestamp("2024-05-01T12:00:00Z") if "when" in description else None)


ROVER = """
data = "rover.csv"
time = "t"
filters = ["EKF"]

[[motion]]
kind = "unicycle"
noise = { position = 0.05, heading = "1 deg" }
inputs = { speed = "v", turn_rate = { column = "w", unit = "deg/s" } }

[[motion]]
kind = "random_walk"
state = { range_scale = "1" }
noise = { range_scale = 0 }

[sensors.beacon]
kind = "range_only"
scale = "range_scale"
columns = { range = "r" }
noise = { range = 0.3 }
inputs = { beacon_x = "bx", beacon_y = "by" }

[sensors.mast]
kind = "bearing"
origin = ["1 km", -20]
columns = { bearing = { column = "b", unit = "deg" } }
noise = { bearing = "1 deg" }

[prior]
x = { mean = 0, std = 1 }
y = { mean = 0, std = 1 }
heading = { mean = "90 deg", std = "5 deg" }
range_scale = { mean = 1, std = "10 %" }
"""


def write_rover(folder: Path, description: str = ROVER) -> Path:
    """Odometry every second, one beacon every third row, a bearing every second; empty elsewhere."""
    columns: dict[str, list] = {name: [] for name in ("t", "v", "w", "r", "bx", "by", "b")}
    for k in range(12):
        beacon = k % 3 == 1
        row = (float(k), 1.5 if k % 4 != 3 else math.nan, 2.0, *((30.0 + k, 10.0, 25.0) if beacon else (math.nan,) * 3))
        for name, value in zip(columns, (*row, 91.0 + k if k % 2 else math.nan), strict=True):
            columns[name].append(value)
    write_csv(folder / "rover.csv", columns)
    (folder / "rover.toml").write_text(description)
    return folder / "rover.toml"


def test_inputs_and_sensors_at_their_own_rates(tmp_path: Path) -> None:
    record = load(str(write_rover(tmp_path)))
    assert record.model.state == ("x", "y", "heading", "range_scale")
    assert record.model.angular == (False, False, True, False)
    assert (~np.isnan(record.z["beacon"][0, :, 0])).nonzero()[0].tolist() == [1, 4, 7, 10]
    assert (~np.isnan(record.z["mast"][0, :, 0])).nonzero()[0].tolist() == [1, 3, 5, 7, 9, 11]
    # A speed that is not given holds the one before.
    np.testing.assert_allclose(record.inputs[0, :, 0], 1.5)
    np.testing.assert_allclose(record.inputs[0, :, 1], math.radians(2))
    np.testing.assert_allclose(record.inputs[0, 1:, 2:], [[10, 25]] * 11)
    np.testing.assert_allclose(record.prior.mean[0], [0, 0, math.pi / 2, 1])
    assert record.landmarks == {"mast": (1000.0, -20.0)}
    x, u = np.array([1.0, 2.0, 0.3, 1.07]), np.array([1.5, 0.1, 10.0, 25.0])
    np.testing.assert_allclose(record.model.sensors["beacon"](x, u), 1.07 * math.hypot(9, 23))
    moved = sigmax.motions.unicycle().function(x[:3], 0.5, u[:2])
    np.testing.assert_allclose(record.model.motion(x, 0.5, u), [*moved, 1.07])
    check(record, record.trials)


def test_own_functions_are_the_built_in_ones(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import jax.numpy as jnp\n"
        "from sigmax import motions\n"
        "def motion(x, dt, u):\n"
        "    return motions.unicycle().function(x, dt, u)\n"
        "def beacon(x, u):\n"
        "    return jnp.stack([jnp.hypot(x[0] - u[0], x[1] - u[1])])\n"
        "def noise(x, u):\n"
        "    return jnp.stack([0.3**2 + 0 * u[0]])\n"
    )
    builtin = ROVER.replace('scale = "range_scale"\n', "")
    builtin = builtin.replace(
        '[[motion]]\nkind = "random_walk"\nstate = { range_scale = "1" }\nnoise = { range_scale = 0 }\n', ""
    )
    builtin = builtin.replace('range_scale = { mean = 1, std = "10 %" }\n', "")
    own = builtin.replace('kind = "unicycle"', 'kind = "mine.py:motion"\nstate = { x = "m", y = "m", heading = "rad" }')
    own = own.replace("{ position = 0.05, heading", "{ x = 0.05, y = 0.05, heading")
    own = own.replace('kind = "range_only"', 'kind = "mine.py:beacon"\nmeasurement = { range = "m" }')
    own = own.replace("{ range = 0.3 }", '"mine.py:noise"')
    x, u = np.array([1.0, 2.0, 0.3]), np.array([1.5, 0.1, 10.0, 25.0])
    values = []
    for description in (builtin, own):
        record = load(str(write_rover(tmp_path, description)))
        check(record, record.trials)
        assert record.model.angular == (False, False, True)
        R = record.model.R["beacon"]
        variances = R(x, u) if callable(R) else R.entries
        values.append([record.model.motion(x, 0.5, u), record.model.sensors["beacon"](x, u), variances, record.inputs])
    for mine, theirs in zip(*values, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-12)


@pytest.mark.parametrize("kind", MOTIONS)
def test_every_motion_can_be_described(kind: str, tmp_path: Path) -> None:
    noise = {
        "constant_velocity": '{ density = "1 m^2/s^3" }',
        "constant_acceleration": '{ density = "1 m^2/s^5" }',
        "singer": '{ acceleration = "1 m/s^2" }\ntau = "20 s"',
        "coordinated_turn": '{ position = "1 m", speed = "1 kn", course = "1 deg", turn_rate = "1 deg/s" }',
        "coordinated_turn_cartesian": '{ acceleration = "1 m^2/s^3", turn_rate = "1 deg/s" }',
        "unicycle": '{ position = "1 m", heading = "1 deg" }\ninputs = { speed = "v", turn_rate = "w" }',
        "random_walk": '{ x = "1 m", y = "1 m" }\nstate = { x = "m", y = "m" }',
    }[kind]
    write_csv(
        tmp_path / "d.csv", {"t": [0.0, 1.0], "px": [1.0, 2.0], "py": [3.0, 5.0], "v": [1.0, 1.0], "w": [0.1, 0.1]}
    )
    names = ("north", "east") if kind == "coordinated_turn" else ("x", "y")
    state = {
        "constant_velocity": "v",
        "constant_acceleration": "va",
        "singer": "va",
        "coordinated_turn_cartesian": "v",
    }.get(kind, "")
    rest = [f"{p}{a}" for p in state for a in "xy"]
    rest += {"coordinated_turn": ["speed", "course", "turn_rate"], "coordinated_turn_cartesian": ["turn_rate"]}.get(
        kind, []
    )
    rest += ["heading"] if kind == "unicycle" else []
    prior = "\n".join(f"{name} = {{ mean = 0, std = 1 }}" for name in rest)
    (tmp_path / "d.toml").write_text(
        f'data = "d.csv"\ntime = "t"\n[motion]\nkind = "{kind}"\nnoise = {noise}\n'
        f'[sensors.gps]\nkind = "position"\nat = ["{names[0]}", "{names[1]}"]\n'
        f'columns = {{ {names[0]} = "px", {names[1]} = "py" }}\n'
        f'noise = {{ {names[0]} = 1, {names[1]} = 1 }}\n[prior]\nposition_from = "gps"\n{prior}\n'
    )
    record = load(str(tmp_path / "d.toml"))
    check(record, record.trials)
    assert len(record.dimensions) == record.model.size
    for name, dimension in zip(record.model.state, record.dimensions, strict=True):
        assert (dimension == ANGLE) == isinstance(name, sigmax.angle)
    np.testing.assert_allclose(record.prior.mean[0, :2], [1, 3])


@pytest.mark.parametrize("kind", SENSORS)
def test_every_sensor_can_be_described(kind: str, tmp_path: Path) -> None:
    write_csv(tmp_path / "d.csv", {name: [0.0, 1.0] for name in ("t", "a", "b", "c", "d")})
    columns, noise, extra = {
        "position": ('x = "a", y = "b"', 'x = "1 m", y = "1 m"', ""),
        "range_only": ('range = "a"', "range = 1", "origin = [1, 2]"),
        "bearing": ('bearing = { column = "a", unit = "deg" }', 'bearing = "1 deg"', ""),
        "camera_bearing": (
            'bearing = "a"',
            'bearing = "1 mrad"',
            'inputs = { camera_x = "b", camera_y = "c", camera_heading = { column = "d", unit = "deg" } }',
        ),
        "range_azimuth": (
            'range = "a", azimuth = "b", radial_velocity = { column = "c", unit = "km/h" }',
            'range = 1, azimuth = 0.1, radial_velocity = "1 km/h"',
            "radial_velocity = true",
        ),
    }[kind]
    (tmp_path / "d.toml").write_text(
        f'data = "d.csv"\ntime = "t"\n[motion]\nkind = "constant_velocity"\nnoise = {{ density = 1 }}\n'
        f'[sensors.s]\nkind = "{kind}"\ncolumns = {{ {columns} }}\nnoise = {{ {noise} }}\n{extra}\n[prior]\n'
        + "\n".join(f"{name} = {{ mean = 1, std = 1 }}" for name in ("x", "y", "vx", "vy"))
    )
    record = load(str(tmp_path / "d.toml"))
    check(record, record.trials)
    assert record.z["s"].shape[:2] == (1, 2)


def changed(old: str, new: str, text: str = RADAR) -> str:
    assert old in text
    return text.replace(old, new)


BAD_DESCRIPTIONS = {
    "no toml": ("data = radar", "Invalid value .at line 1"),
    "a missing key": (changed('time = "t"\n', ""), "needs the key 'time'"),
    "a missing table": (changed("[prior]", "[other]"), "unknown key 'other'"),
    "an unknown key": (changed("columns =", "colums ="), "sensors.radar: unknown key 'colums'; did you mean columns"),
    "a key of another kind": (
        changed('track = "aircraft"', "track = 3"),
        "track: this must be text in quotes; it is 3",
    ),
    "no table where one belongs": (changed("[sensors.radar]", "[sensors]"), "sensors.kind: must be a table of keys"),
    "an unknown motion": (
        changed("constant_velocity", "constant_velosity"),
        "motion.kind: unknown motion.*constant_velocity",
    ),
    "an unknown sensor": (
        changed("range_azimuth", "range_azimut"),
        "sensors.radar.kind: unknown sensor.*range_azimuth",
    ),
    "an unknown filter": (changed('["EKF"]', '["SRCKF", "SRCKFX"]'), "unknown filter 'SRCKFX'; did you mean .*SRCKF"),
    "an unknown component": (
        changed("[truth]\nnorth", "[truth]\nnorht"),
        "truth: unknown component 'norht'; did you mean north",
    ),
    "a missing column": (
        changed("range_km", "range_kn"),
        "radar.csv: unknown column 'range_kn'; did you mean range_km",
    ),
    "a unit that does not fit": (
        changed('unit = "deg"', 'unit = "m"'),
        "azimuth: the unit 'm' does not fit; this is an angle",
    ),
    "noise that does not fit": (changed('"0.2 deg"', '"0.2 m"'), "noise.azimuth: the unit 'm' does not fit"),
    "noise that misses": (changed('range = "30 m", ', ""), "sensors.radar.noise needs 'range', a length"),
    "negative noise": (changed('"30 m"', '"-30 m"'), "must not be negative"),
    "an asymmetric covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[4, 1], [0, 4]]"),
        "radar.*symmetric",
    ),
    "an indefinite covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[1, 2], [2, 1]]"),
        "semidefinite",
    ),
    "a ragged covariance": (
        changed('{ range = "30 m", azimuth = "0.2 deg" }', "[[1, 2], [2]]"),
        "array of real numbers",
    ),
    "NaN in the prior": (
        changed('mean = 0, std = "360 km/h"', "mean = nan, std = 1"),
        "prior.vnorth.mean: nan is not finite",
    ),
    "half a prior": (changed('mean = 0, std = "360 km/h"', "mean = 0"), "prior.vnorth must be { mean = …, std = … }"),
    "a prior that misses": (
        changed('position_from = "radar"\n', ""),
        "prior needs 'north'.*or position_from = a sensor",
    ),
    "a prior given twice": (changed("[prior]", "[prior]\nnorth = { mean = 0, std = 1 }"), "given twice"),
    "an unknown function": (
        changed('"constant_velocity"\naxes = ["north", "east"]', '"my.py:f"\nstate = { x = "m" }'),
        "no file.*my.py",
    ),
    "an option of another": (
        changed('kind = "constant_velocity"', 'kind = "constant_velocity"\ntau = 3'),
        "takes no 'tau'",
    ),
    "no filter": (changed('["EKF"]', "[]"), "filters: this must not be empty"),
    "inputs that nobody takes": (
        changed("[sensors.radar]", '[motion.inputs]\nv = "t"\n[sensors.radar]'),
        "nothing here takes inputs",
    ),
}


@pytest.mark.parametrize("case", BAD_DESCRIPTIONS)
def test_a_description_that_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    description, words = BAD_DESCRIPTIONS[case]
    with pytest.raises(InputError, match=f"(?s)^radar.toml.*{words}") as refused:
        load(str(write_radar(tmp_path, description)))
    assert "Traceback" not in str(refused.value)


def _lines(change: object) -> object:
    def spoil(path: Path) -> None:
        lines = path.read_text().splitlines()
        path.write_text("\n".join(change(lines)) + "\n")

    return spoil


def _field(row: int, column: int, value: str) -> object:
    """Replace a field; rows are counted as a reader does, the header being 1."""

    def change(lines: list[str]) -> list[str]:
        fields = lines[row - 1].split(",")
        fields[column] = value
        return [*lines[: row - 1], ",".join(fields), *lines[row:]]

    return _lines(change)


BAD_TABLES = {
    "missing": (Path.unlink, "there is no file"),
    "empty": (lambda path: path.write_text(""), "radar.csv is empty"),
    "without rows": (_lines(lambda lines: lines[:1]), "no rows of data"),
    "cut off": (lambda path: path.write_text(path.read_text()[:-25]), "cut off: Row #51: Expected 6 columns, got [45]"),
    "ragged": (_lines(lambda lines: [*lines[:5], lines[5] + ",1", *lines[6:]]), "Row #6: Expected 6 columns, got 7"),
    "twice the same column": (_lines(lambda lines: [lines[0].replace("north_km", "t"), *lines[1:]]), "two columns 't'"),
    "no text": (lambda path: path.write_bytes(b"\xff\xfe\x00t"), "UTF-8"),
    "text for a number": (_field(7, 2, "far"), "row 7: column 'range_km' has 'far' where a number belongs"),
    "infinity": (_field(7, 3, "inf"), "row 7: column 'azimuth_deg' has 'inf' which is not finite"),
    "no time": (_field(4, 0, ""), "row 4: column 't' has nothing where a time belongs"),
    "text for a time": (_field(4, 0, "noon"), "row 4: column 't' has 'noon'"),
    "no track": (_field(3, 1, ""), "row 3: the column 'aircraft' does not say which track"),
    "time backwards": (_field(8, 0, "1.0"), "backwards of the track 'A1' from row 6 .4 s. to row 8 .1 s."),
    "no measurement at all": (
        _lines(
            lambda lines: [lines[0], *(",".join([*x.split(",")[:2], "", "", *x.split(",")[4:]]) for x in lines[1:])]
        ),
        "the track 'A1' has no whole measurement",
    ),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_table_that_does_not_fit_is_refused(case: str, tmp_path: Path) -> None:
    spoil, words = BAD_TABLES[case]
    path = write_radar(tmp_path)
    spoil(tmp_path / "radar.csv")
    with pytest.raises(InputError, match=words):
        load(str(path))


def test_a_parquet_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    pd.DataFrame(radar_table()).to_parquet(tmp_path / "radar.parquet")
    whole = (tmp_path / "radar.parquet").read_bytes()
    for size in (0, 3, len(whole) // 2, len(whole) - 1):
        (tmp_path / "radar.parquet").write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"radar.parquet is not a whole Parquet file"):
            read_table(tmp_path / "radar.parquet")
    pd.DataFrame({"t": ["a", "b"], "ok": [True, False]}).to_parquet(tmp_path / "radar.parquet")
    table = read_table(tmp_path / "radar.parquet")
    with pytest.raises(InputError, match="row 1: column 't' has 'a'"):
        table.numbers("t")
    with pytest.raises(InputError, match="'ok' holds bool"):
        table.numbers("ok")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("def other(x, dt): return x", "unknown function of mine.py 'motion'; known: other"),
        ("def motion(x, dt) return x", "mine.py, line 1"),
        ("import does_not_exist", "mine.py fails at line 1: ModuleNotFoundError"),
        ("raise SystemExit(3)", "mine.py fails at line 1: SystemExit"),
        ("def motion(x): return x", "must take 2 or 3 positional arguments"),
        ("def motion(x, dt, u): return x", "takes inputs u; name their columns"),
        ("def motion(x, dt):\n    return x[:1]", "motion must return the 2 components"),
        ("def motion(x, dt):\n    return x / nonsense", "NameError: name 'nonsense'.*line 2"),
    ],
)
def test_a_function_that_does_not_fit_is_refused(code: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(code)
    description = changed(
        'kind = "constant_velocity"\naxes = ["north", "east"]',
        'kind = "mine.py:motion"\nstate = { north = "m", east = "m" }',
    )
    description = description.replace('{ density = "0.5 m^2/s^3" }', '{ north = "1 m", east = "1 m" }')
    description = description.replace(
        'vnorth = { mean = 0, std = "360 km/h" }\nveast = { mean = 0, std = "100 m/s" }\n', ""
    )
    path = write_radar(tmp_path, description)

    def load_and_check() -> None:
        record = load(str(path))
        check(record, record.trials)

    with pytest.raises(InputError, match=f"(?s){words}"):
        load_and_check()


def test_what_cannot_work_is_refused_before_it_runs(radar: sigmax.records.Record) -> None:
    for trial, words in {
        "KF": "KF: KF is for linear models",
        "UKF:kappa=-9": "alpha²",
        "EKF:fixed=vnort": "unknown component 'vnort'; did you mean .*vnorth",
        "EIF:fixed=vnorth": "information filter needs a prior",
    }.items():
        with pytest.raises(InputError, match=words):
            check(radar, (parse_trial(trial),))


def test_a_fixed_component_stays(radar: sigmax.records.Record) -> None:
    trial = parse_trial("EKF:fixed=vnorth,fixed=veast")
    prior = radar.prior_for(trial)
    assert (prior.cov[:, 2:] == 0).all()
    assert (prior.cov[:, :, 2:] == 0).all()
    np.testing.assert_array_equal(prior.cov[:, :2, :2], radar.prior.cov[:, :2, :2])
    assert radar.label(trial) == "EKF, vnorth fixed at 0, veast fixed at 0"


def test_tracks_of_very_different_length_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sigmax.records.own._ROOM", 0)
    monkeypatch.setattr("sigmax.records.own._PADDING", 1)
    with pytest.raises(InputError, match="put the long tracks into a file of their own"):
        load(str(write_radar(tmp_path)))


@pytest.fixture(scope="session", params=[1, 2])
def plaza(request: pytest.FixtureRequest) -> tuple[int, sigmax.records.Record]:
    pytest.importorskip("scipy")
    try:
        return request.param, load(f"plaza{request.param}")
    except InputError as error:
        pytest.skip(str(error))


def test_plaza_as_it_is_known(plaza: tuple[int, sigmax.records.Record]) -> None:
    """Ranges about 7 % too long at every beacon; odometry that agrees with the heading of the truth."""
    _, record = plaza
    heard = ~np.isnan(record.z[0, :, 0])
    beacons = record.inputs[0, heard, 2:]
    ratio = record.z[0, heard, 0] / np.linalg.norm(record.truth[0, heard, :2] - beacons, axis=1)
    assert len(record.landmarks) == 4
    for place in record.landmarks.values():
        assert np.median(ratio[(beacons == place).all(1)]) == pytest.approx(1.07, abs=0.015)
    x, y, heading = record.truth[0, :, :3].T
    # The way along the heading, over a second or so, is what odometry says it is.
    stride = 20
    along = np.diff(x[::stride]) * np.cos(heading[:-stride:stride]) + np.diff(y[::stride]) * np.sin(
        heading[:-stride:stride]
    )
    driven = np.diff(np.cumsum(record.inputs[0, :, 0] * record.dt[0])[::stride])
    assert np.corrcoef(along, driven[: len(along)])[0, 1] > 0.95
    assert (record.dt >= 0).all()
    assert record.time[0, -1] == pytest.approx(record.dt.sum())


def test_plaza_with_the_scale_as_a_state_and_without(plaza: tuple[int, sigmax.records.Record]) -> None:
    run, record = plaza
    scores = {}
    for name in ("EKF", "EKF:fixed=range_scale"):
        outcome = track(record, parse_trial(name))
        assert outcome.failure == ""
        assert outcome.result.ok.all()
        scores[name] = sigmax.reports.score(record, outcome)
    found, fixed = scores.values()
    assert found.rmse_position_m <= {1: 0.35, 2: 0.45}[run]
    assert found.mean_nis == pytest.approx(1.0, abs=0.1)
    assert found.constants["range_scale"][0] == pytest.approx(1.070, abs=0.002)
    assert fixed.rmse_position_m > 3
    assert fixed.mean_nis > 10
    assert fixed.constants["range_scale"] == (1.0, 0.0)


def test_plaza_without_its_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'sigmax\[plaza\]'"):
        load("plaza1")
