"""A user's own record: what the files say is what the filters get."""

import math
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.descriptions.motion import KINDS as MOTIONS
from sigmax.descriptions.sensor import KINDS as SENSORS
from sigmax.errors import InputError
from sigmax.files.units import (
    ANGLE,
)
from sigmax.records import check, load, parse_trial, track
from tests.own_records import RADAR, radar_table, tracked_radar, write_csv, write_radar
from tests.test_receivers import KINDS as RECEIVERS


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
    from sigmax.descriptions.sensor import Sensing, first_position
    from sigmax.models import sensors

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


@pytest.mark.parametrize(("unit", "told"), [("s", ""), ("ms", ""), ("us", "us"), ("ns", "")])
def test_counts_since_1970_are_dates_by_their_size(
    tmp_path: Path, radar: sigmax.records.Record, unit: str, told: str
) -> None:
    table = pd.read_csv(write_radar(tmp_path).with_name("radar.csv"))
    per_second = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}[unit]
    begins = pd.Timestamp("2024-05-01T12:00:00Z")
    table["t"] = [f"{(begins.value // 10**9 + t) * per_second:.0f}" for t in table["t"].astype(int)]
    table.to_csv(tmp_path / "radar.csv", index=False)
    time = f'{{ column = "t", unit = "{told}" }}' if told else '"t"'
    (tmp_path / "other.toml").write_text(RADAR.replace('time = "t"', f"time = {time}"))
    other = load(str(tmp_path / "other.toml"))
    np.testing.assert_allclose(other.time, radar.time, atol=1e-6)
    assert other.epoch == begins
    assert any(f"count since 1970 in {unit}" in doubt for doubt in other.doubts) == (not told)


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


@pytest.mark.filterwarnings("ignore::sigmax.errors.FoldingWarning")
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


# Those of receivers and vehicles are described in their own tests.
@pytest.mark.parametrize("kind", [kind for kind in SENSORS if kind not in RECEIVERS])
def test_every_sensor_can_be_described(kind: str, tmp_path: Path) -> None:
    write_csv(tmp_path / "d.csv", {name: [0.0, 1.0] for name in ("t", "a", "b", "c", "d")})
    columns, noise, extra = {
        "position": ('x = "a", y = "b"', 'x = "1 m", y = "1 m"', ""),
        "velocity": (
            'vx = { column = "a", unit = "kn" }, vy = { column = "b", unit = "km/h" }',
            'vx = "1 kn", vy = 1',
            "",
        ),
        "relative_position": (
            'x = "a", y = "b"',
            'x = "1 m", y = "1 m"',
            'inputs = { platform_x = "c", platform_y = "d" }',
        ),
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


def test_a_sensor_says_how_it_corrects(tmp_path: Path) -> None:
    """Every filter of the record takes it, unless it says so itself; a filter by hand gives the same."""
    robust = ROVER.replace('kind = "bearing"', 'kind = "bearing"\nupdate = "student(2)"')
    record = load(str(write_rover(tmp_path, robust)))
    chosen, model, prior = record.of_trial(parse_trial("SRCKFB"))
    assert str(chosen.update) == "mast: student(2)"
    outcome = track(record, parse_trial("SRCKFB"))
    by_hand = sigmax.run(
        sigmax.get("SRCKFB", update={"mast": sigmax.robust("student", dof=2)}),
        model,
        prior,
        record.z,
        dt=record.dt,
        inputs=record.inputs,
        update_first=True,
    )
    np.testing.assert_array_equal(outcome.result.mean, by_hand.mean)
    with pytest.warns(DeprecationWarning, match="of_trial"):
        assert record.told(parse_trial("SRCKFB"))[0] == chosen
    assert record.of_trial(parse_trial("SRCKFB:update=once"))[0].update == sigmax.once
    with pytest.raises(sigmax.InputError, match=r"sensors\.mast\.update.*did you mean student"):
        load(str(write_rover(tmp_path, robust.replace("student(2)", "stundent"))))


def test_a_fixed_component_stays(radar: sigmax.records.Record) -> None:
    trial = parse_trial("EKF:fixed=vnorth,fixed=veast")
    prior = radar.of_trial(trial)[2]
    assert (prior.cov[:, 2:] == 0).all()
    assert (prior.cov[:, :, 2:] == 0).all()
    np.testing.assert_array_equal(prior.cov[:, :2, :2], radar.prior.cov[:, :2, :2])
    assert radar.label(trial) == "EKF, vnorth fixed at 0, veast fixed at 0"
