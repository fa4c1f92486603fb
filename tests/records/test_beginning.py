"""`prior = "from measurements"`: the state at the first rows that determine it, and the record from there on."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.records import Record, load, parse_trial, track
from tests.own_records import RADAR, write_csv

DRIFT = """
data = "drift.csv"
time = "t"
track = "name"
filters = ["EKF"]
prior = "from measurements"

[motion]
kind = "constant_velocity"
axes = ["x"]
noise = { density = "0.02 m^2/s^3" }

[sensors.gauge]
kind = "position"
columns = { x = "x" }
noise = { x = "0.5 m" }
"""
DENSITY, R = 0.02, 0.25


def drift() -> pd.DataFrame:
    """Three tracks on a line: of uneven steps, with holes, and one of two rows, too few for a number to spare."""
    rng = np.random.default_rng(5)
    rows = []
    for name, holes, T in (("a", (), 12), ("b", (1, 2, 6), 15), ("c", (), 2)):
        t = np.cumsum(rng.uniform(0.5, 2.0, T))
        x = 100 - 3 * t + 0.5 * rng.standard_normal(T)
        x[list(holes)] = np.nan
        rows += [(time, name, value) for time, value in zip(t, x, strict=True)]
    return pd.DataFrame(sorted(rows), columns=["t", "name", "x"])


def written(folder: Path, description: str = DRIFT) -> str:
    write_csv(folder / "drift.csv", drift().to_dict("list"))
    (folder / "drift.toml").write_text(description)
    return str(folder / "drift.toml")


def kalman(t: np.ndarray, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """A Kalman filter by hand that begins with next to no knowledge: what is known after each row."""
    x, P, H = np.zeros(2), np.eye(2) * 1e9, np.array([1.0, 0.0])
    known = []
    for k, value in enumerate(z):
        dt = t[k] - t[k - 1] if k else 0.0
        F = np.array([[1, dt], [0, 1]])
        x, P = F @ x, F @ P @ F.T + DENSITY * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        if np.isfinite(value):
            gain = P @ H / (H @ P @ H + R)
            x, keep = x + gain * (value - x[0]), np.eye(2) - np.outer(gain, H)
            P = keep @ P @ keep.T + R * np.outer(gain, gain)
        known.append((x, P))
    return known


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Record:
    return load(written(tmp_path_factory.mktemp("drift")))


def test_a_linear_record_goes_on_as_a_filter_that_knew_nothing(begun: Record) -> None:
    table = drift()
    result = track(begun, parse_trial("EKF")).result
    assert result is not None
    assert set(begun.tracks) == {"a", "b"}
    for b, name in enumerate(begun.tracks):
        used = {"a": 3, "b": 5}[name]
        own = table[table["name"] == name]
        known = kalman(own["t"].to_numpy(), own["x"].to_numpy())
        mean, cov = known[used - 1]
        np.testing.assert_allclose(begun.prior.mean[b], mean, rtol=1e-6)
        np.testing.assert_allclose(begun.prior.cov[b], cov, rtol=1e-5, atol=1e-7)
        assert begun.steps[b] == len(own) - used + 1
        assert abs(begun.time[b, 0] - own["t"].iloc[used - 1]) < 1e-5
        for k in range(begun.steps[b]):
            mean, cov = known[used - 1 + k]
            np.testing.assert_allclose(result.mean[b, k], mean, rtol=1e-6)
            np.testing.assert_allclose(result.cov[b, k], cov, rtol=1e-5, atol=1e-7)


def test_what_was_used_is_not_used_again_and_what_was_left_out_is_told(begun: Record) -> None:
    assert np.isnan(begun.z["gauge"][:, 0]).all()
    assert begun.update_first
    assert "3 to 5 rows" in begun.notes[-2]
    assert "1 of 3 tracks" in begun.notes[-1]
    assert "'c'" in begun.notes[-1]
    assert not any("fit badly" in doubt for doubt in begun.doubts)


def test_what_is_said_in_the_prior_counts_as_a_measurement(tmp_path: Path) -> None:
    said = '[prior]\nfrom = "measurements"\nvx = { mean = "-3 m/s", std = "0.2 m/s" }\n'
    one = load(written(tmp_path, DRIFT.replace('prior = "from measurements"', "") + said))
    (first,) = np.flatnonzero(np.array(one.tracks) == "c")
    # Of two rows a third number is to spare now: the velocity known before, at the first of them.
    own = drift().query("name == 'c'")
    dt = float(np.diff(own["t"])[0])
    F, Q = np.array([[1, dt], [0, 1]]), DENSITY * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    P = np.diag([R, 0.04])
    x, P = F @ [own["x"].iloc[0], -3.0], F @ P @ F.T + Q
    gain = P[:, 0] / (P[0, 0] + R)
    np.testing.assert_allclose(one.prior.mean[first], x + gain * (own["x"].iloc[1] - x[0]), rtol=1e-7)
    np.testing.assert_allclose(one.prior.cov[first], P - np.outer(gain, P[0]), rtol=1e-6)


@pytest.mark.slow
def test_a_course_is_found_from_any_quarter_and_a_bad_fit_is_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = []
    for name, course in (("east", 1.5), ("west", -1.6), ("back", 3.0), ("jumps", 0.3)):
        t = np.arange(6.0)
        place = np.array([300.0, -200.0]) + 12.0 * t[:, None] * [np.cos(course), np.sin(course)]
        place += rng.standard_normal(place.shape)
        if name == "jumps":
            place[1] += 400
        rows += [(time, name, *p) for time, p in zip(t, place, strict=True)]
    write_csv(
        tmp_path / "ships.csv", dict(zip(("t", "name", "x", "y"), map(list, zip(*rows, strict=True)), strict=True))
    )
    (tmp_path / "ships.toml").write_text("""
data = "ships.csv"
time = "t"
track = "name"
filters = ["EKF"]
[prior]
from = "measurements"
turn_rate = { mean = 0, std = "0.5 deg/s" }
[motion]
kind = "coordinated_turn"
noise = { position = "1 cm", speed = "5 cm/s", course = "0.1 deg", turn_rate = "0.01 deg/s" }
[sensors.gps]
kind = "position"
columns = { north = "x", east = "y" }
noise = { north = "1 m", east = "1 m" }
""")
    found = load(str(tmp_path / "ships.toml"))
    state = found.model.state
    speed, course = (found.prior.mean[:, state.index(name)] for name in ("speed", "course"))
    signed = np.where(speed < 0, np.pi, 0.0)
    off = np.angle(np.exp(1j * (course + signed - np.array([1.5, -1.6, 3.0, 0.3]))))
    assert (np.abs(off[:3]) < 0.4).all()
    assert (np.abs(np.abs(speed[:3]) - 12) < 4).all()
    assert any("fit badly" in doubt and "jumps" in doubt and "east" not in doubt for doubt in found.doubts)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ('prior = "from the measurements"', "table"),
        ('[prior]\nfrom = "gauge"', 'is "measurements"'),
        ('[prior]\nfrom = "measurements"\nposition_from = "gauge"', "drop position_from"),
        ('[prior]\nfrom = "measurements"\nvy = { mean = 0, std = 1 }', "unknown component 'vy'"),
        ('[prior]\nfrom = "measurements"\nvx = { mean = 0, std = 0 }', "std must be above 0"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, changed: str, words: str) -> None:
    top = DRIFT.replace('prior = "from measurements"', changed if changed.startswith("prior") else "")
    with pytest.raises(InputError, match=words):
        load(written(tmp_path, top if changed.startswith("prior") else top + changed))


def test_what_stays_open_is_named(tmp_path: Path) -> None:
    radar = RADAR[: RADAR.index("[prior]")].replace("[motion]", 'prior = "from measurements"\n[motion]', 1)
    one_way = radar.replace('kind = "range_azimuth"', 'kind = "range_only"').replace(
        'azimuth = { column = "azimuth_deg", unit = "deg" } }', "}"
    )
    one_way = one_way.replace(', azimuth = "0.2 deg"', "").replace('unit = "km" }, }', 'unit = "km" } }')
    write_csv(tmp_path / "radar.csv", {"t": [0.0, 1, 2, 3], "aircraft": list("aaaa"), "range_km": [5.0, 5.1, 5.2, 5.3]})
    (tmp_path / "radar.toml").write_text(one_way)
    with pytest.raises(InputError, match=r"prior = 'from measurements'.*NAME"):
        load(str(tmp_path / "radar.toml"))


def test_modes_are_refused(tmp_path: Path) -> None:
    modes = DRIFT.replace('columns = { x = "x" }', 'at = ["x"]\ncolumns = { x = "x" }')
    modes = modes.replace("[motion]", '[modes.calm]\nsojourn = "60 s"\n[modes.calm.motion]', 1)
    modes += '[modes.wild]\nsojourn = "60 s"\n[modes.wild.motion]\nkind = "constant_velocity"\n'
    modes += 'axes = ["x"]\nnoise = { density = "2 m^2/s^3" }\n'
    with pytest.raises(InputError, match="one mode alone"):
        load(written(tmp_path, modes))


def test_the_prior_of_any_record_can_be_replaced() -> None:
    """A record that a program made: one sensor without a name, a prior that is wrong, and a bias that widens."""
    from sigmax.records.beginning import from_measurements

    motion = sigmax.motions.constant_velocity(("x",))
    t, rng = np.arange(8.0), np.random.default_rng(2)
    z = (5 + 2 * t + 0.5 * rng.standard_normal(8))[None, :, None]
    bias = sigmax.Bias(sensor=[[1.0]], prior=sigmax.Gaussian([1.0], [[9.0]]), names=("offset",))
    model = sigmax.Model(motion=motion, sensor=lambda x: x[:1], Q=motion.noise(DENSITY), R=[R], bias=bias)
    made = Record(
        name="made", title="", model=model, prior=sigmax.Gaussian([[1e3, 0.0]], np.eye(2)), tracks=("one",),
        time=t[None], steps=np.array([8]), z=z, dt=np.diff(t, prepend=0.0)[None], inputs=None,
        truth=np.full((1, 8, 2), np.nan), position=(0,), dimensions=(), trials=(parse_trial("EKF"),),
    )  # fmt: skip
    found = from_measurements(made, np.array([[1e3, 0.0]]))
    mean, cov = kalman(t, z[0, :, 0] - 1.0)[2]
    np.testing.assert_allclose(found.prior.mean[0], mean, rtol=1e-6)
    np.testing.assert_allclose(found.prior.cov[0], cov + np.diag([9.0, 0.0]), rtol=1e-5, atol=1e-7)
    assert found.z.shape == (1, 6, 1)


def test_bounds_of_a_description_hold_and_are_checked(tmp_path: Path) -> None:
    known = DRIFT.replace('prior = "from measurements"', "")
    known += "[prior]\nx = { mean = 100, std = 1 }\nvx = { mean = -3, std = 1 }\n[bounds]\n"
    bounded = load(written(tmp_path, known + 'vx = { low = "-9 km/h", high = 0 }\n'))
    (constraint,) = bounded.model.constraints
    assert constraint.low == (-2.5,)
    assert constraint.high == (0.0,)
    result = track(bounded, parse_trial("EKF")).result
    assert result is not None
    # The first row is where the prior stands; every prediction after it keeps the bounds.
    assert (result.mean[:, 5:, 1] > -2.6).all()
    for line, words in {
        "vy = { low = 0 }": "unknown component 'vy'",
        "vx = { low = 1, high = 0 }": "bounds.vx: a constraint lies between",
        "vx = { }": "bounds.vx: a constraint has bounds",
        'vx = { low = "3 m" }': "speed",
    }.items():
        with pytest.raises(InputError, match=words):
            load(written(tmp_path, known + line))
