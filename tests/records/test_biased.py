"""A bias in a description: what it means, what it refuses, and where it comes out."""

import json
import math
import re

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.records import check, find_model, load, parse_trial, track
from sigmax.reports import score, write
from sigmax.studies.load import load_studies
from tests.own_records import write_csv

BOAT = """
data = "boat.csv"
time = "t"
filters = ["EKF"]

[motion]
kind = "constant_velocity"
noise = { density = "0.01 m^2/s^3" }

[sensors.radar]
kind = "range_azimuth"
columns = { range = "range", azimuth = { column = "azimuth", unit = "deg" } }
noise = { range = "3 m", azimuth = "0.2 deg" }

[sensors.gps]
kind = "position"
columns = { x = "gps_x", y = "gps_y" }
noise = { x = "10 m", y = "10 m" }

[bias.north]
offset = { radar = "azimuth" }
mean = "0.1 deg"
std = "2 deg"
noise = "0.001 deg"

[bias.scale]
scale = { radar = "range" }
std = "5 %"

[bias.current]
drift = "x"
std = "1 m/s"

[prior]
position_from = "radar"
vx = { mean = 0, std = "5 m/s" }
vy = { mean = 0, std = "5 m/s" }

[truth]
x = "x"
y = "y"
"""


def written(folder, text=BOAT):
    rng = np.random.default_rng(4)
    x, rows = np.array([400.0, 300.0, 3.0, -4.0]), []
    for k in range(60):
        x = x + np.r_[x[2] + 0.5, x[3], 0.1 * rng.standard_normal(2)]
        seen = np.hypot(*x[:2]) * 1.02 + 3 * rng.standard_normal()
        angle = math.degrees(math.atan2(x[1], x[0])) + 0.8 + 0.2 * rng.standard_normal()
        fix = x[:2] + 10 * rng.standard_normal(2) if k % 5 == 0 else [math.nan] * 2
        rows.append((float(k), seen, angle, *fix, *x[:2]))
    names = ("t", "range", "azimuth", "gps_x", "gps_y", "x", "y")
    write_csv(folder / "boat.csv", {name: [row[i] for row in rows] for i, name in enumerate(names)})
    (folder / "boat.toml").write_text(text)
    return str(folder / "boat.toml")


def test_a_described_bias_is_the_one_of_the_model(tmp_path):
    """An offset of the azimuth, a scale of the range, and a current: F, B, Q and prior as one writes them in Python."""
    record = load(written(tmp_path))
    bias, degree = record.model.bias, math.pi / 180
    assert bias.names == ("north", "scale", "current")
    assert np.allclose(bias.prior.mean, [0.1 * degree, 0, 0])
    assert np.allclose(bias.prior.cov, np.diag(np.square([2 * degree, 0.05, 1.0])))
    assert [d.symbol for d in record.bias_dimensions] == ["rad", "", "m/s"]
    x = jnp.array([30.0, 40.0, 1.0, 2.0])
    assert np.allclose(bias.sensor["radar"](x), [[0, 50, 0], [1, 0, 0]])
    assert "gps" not in bias.sensor
    assert np.allclose(bias.motion(jnp.array(3.0)), [[0, 0, 3.0], *np.zeros((3, 3))])

    def scaled(x):
        return jnp.zeros((2, 3)).at[0, 1].set(jnp.hypot(x[0], x[1])).at[1, 0].set(1.0)

    by_hand = sigmax.Model(
        motion=record.model.motion,
        state=record.model.state,
        sensor=record.model.sensors,
        measurement=record.model.measurement,
        Q=record.model.Q,
        R={"radar": [9.0, (0.2 * degree) ** 2], "gps": [100.0, 100.0]},
        bias=sigmax.Bias(
            motion=lambda dt: jnp.zeros((4, 3)).at[0, 2].set(dt),
            sensor={"radar": scaled},
            Q=np.square([0.001 * degree, 0, 0]),
            prior=bias.prior,
        ),
    )
    told = track(record, record.trials[0]).result
    hand = sigmax.run("EKF", by_hand, record.prior, record.z, dt=record.dt)
    assert np.allclose(told.mean, hand.mean, rtol=1e-9)
    assert np.allclose(told.bias_mean, hand.bias_mean, rtol=1e-9, atol=1e-12)
    off = (told.bias_mean[0, -1] - [0.8 * degree, 0.02, 0.5]) / told.bias_std[0, -1]
    assert np.abs(off).max() < 3


def test_a_position_from_a_biased_sensor_is_as_uncertain_as_its_bias(tmp_path):
    record = load(written(tmp_path))
    place, cov = record.prior.mean[0, :2], record.prior.cov[0, :2, :2]
    seen = pd.read_csv(tmp_path / "boat.csv").iloc[0]
    angle = math.radians(seen["azimuth"] - 0.1)
    assert np.allclose(place, seen["range"] * np.array([math.cos(angle), math.sin(angle)]), rtol=1e-9)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    assert along @ cov @ along == pytest.approx(9 + (0.05 * seen["range"]) ** 2)
    assert across @ cov @ across == pytest.approx(seen["range"] ** 2 * math.radians(1) ** 2 * (4 + 0.04))
    assert any("bias of radar" in note for note in record.notes)


def test_what_was_found_is_in_all_the_files(tmp_path):
    record = load(written(tmp_path))
    trials = [parse_trial(t) for t in ("EKF", "EKF:fixed=north,fixed=scale")]
    check(record, tuple(trials))
    outcomes = [track(record, trial) for trial in trials]
    scores = [score(record, outcome) for outcome in outcomes]
    assert scores[1].label == "EKF, north fixed at 0.00174533, scale fixed at 0"
    assert scores[1].constants["scale"] == (0.0, 0.0)
    assert scores[0].rmse_position_m < scores[1].rmse_position_m
    write(tmp_path / "out", record, outcomes, scores)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["units"]["north"] == "rad"
    assert set(summary["filters"]["EKF"]["constants"]) == {"north", "scale", "current"}
    table = pd.read_parquet(tmp_path / "out" / "estimates.parquet")
    last = table[table["filter"] == "EKF"].iloc[-1]
    assert last["north"] == pytest.approx(outcomes[0].result.bias_mean[0, -1, 0])
    assert last["north_std"] == pytest.approx(outcomes[0].result.bias_std[0, -1, 0])
    page = (tmp_path / "out" / "report.html").read_text()
    for words in ("prior of the bias", "noise of the bias", "current = "):
        assert words in page
    with pytest.raises(InputError, match="unknown component 'nort'; did you mean north"):
        check(record, (parse_trial("EKF:fixed=nort"),))


def test_studies_and_exports_know_it(tmp_path):
    """The description is a model like any other: drawn from in a study, found by export."""
    task = find_model(written(tmp_path))
    assert task.model.biases == 3
    (tmp_path / "study.toml").write_text('model = "boat.toml"\nsteps = 20\nruns = 64\nfilters = ["EKF"]\n')
    (study,) = load_studies(str(tmp_path / "study.toml"))
    assert study.model.state[-3:] == ("north", "scale", "current")
    done = sigmax.compare(study, particles=0)
    assert not done.failures
    assert done.measures["EKF"].rmse.value.shape == (20, 7)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[bias.north]", "[bias.vx]", "bias.vx: the state has a component of this name"),
        ('offset = { radar = "azimuth" }', "", "bias.north acts on nothing; give offset"),
        ('radar = "azimuth" }', 'rader = "azimuth" }', "bias.north.offset: unknown sensor 'rader'; did you mean radar"),
        ('offset = { radar = "azimuth" }', 'offset = { radar = "azimut" }', "unknown component 'azimut'"),
        (
            'offset = { radar = "azimuth" }',
            'offset = { radar = ["azimuth", "range"] }',
            "one quantity, but .* an angle",
        ),
        ('scale = { radar = "range" }', 'scale = { radar = "azimuth" }', "an angle, which has no scale"),
        ('drift = "x"', 'drift = "z"', "bias.current.drift: unknown component 'z'"),
        ('std = "2 deg"', 'std = "2 m"', "bias.north.std: the unit 'm' does not fit; this is an angle"),
        ('std = "1 m/s"', 'std = "-1 m/s"', "must not be negative"),
        ('std = "1 m/s"', "", r"\[bias.current\] needs the key 'std'"),
        ('drift = "x"', 'drfit = "x"', "bias.current: unknown key 'drfit'; did you mean drift"),
        ('drift = "x"', "drift = 3", "bias.current.drift.0: this must be text"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, old, new, words):
    assert old in BOAT
    with pytest.raises(InputError, match=words):
        load(written(tmp_path, BOAT.replace(old, new, 1)))


@pytest.mark.parametrize("name", ["time", "ok", "x_std", "current_truth"])
def test_a_bias_is_not_called_as_another_column_of_the_estimates(tmp_path, name):
    """It would take its place: a bias called time and there is no time any more."""
    with pytest.raises(InputError, match=rf"bias\.{name}: another column"):
        load(written(tmp_path, BOAT.replace("[bias.north]", f"[bias.{name}]")))


def test_a_tracker_takes_no_bias(tmp_path):
    text = re.sub(r"\[prior\]\n.*?\n\n", "", BOAT, flags=re.S)
    text += '[tracking]\nmax_speed = "20 m/s"\n[tracking.sensors.radar]\ndetection = 0.9\nclutter = 1e-6\n'
    with pytest.raises(InputError, match="does not go with"):
        sigmax.records.load_plots(written(tmp_path, text))
