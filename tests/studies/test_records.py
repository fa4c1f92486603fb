"""Studies of the model of a record: with its own times, inputs and gaps."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

import sigmax
from sigmax import InputError
from sigmax.cli.app import app
from sigmax.records import load
from sigmax.reports.comparison import Word, standings
from sigmax.studies import compare, load_studies
from sigmax.studies.simulate import draw
from tests.own_records import write_csv, write_radar
from tests.studies.problems import P0, F, Q, R, linear

MOVED = """
data = "moved.csv"
time = "t"
filters = ["EKF", "SRCKFB"]

[motion]
kind = "own.py:pushed"
noise = "own.py:shaken"
state = { place = "m" }
inputs = { push = { column = "push", unit = "m/s" } }

[sensors.rod]
kind = "own.py:seen"
measurement = { z = "m" }
columns = { z = { column = "z", unit = "m" } }
noise = { z = "0.1 m" }

[prior]
place = { mean = 0, std = "1 m" }
"""
OWN = """
import jax.numpy as jnp


def pushed(x, dt, u):
    return x + dt * u


def shaken(dt):
    return jnp.ones((1, 1)) * 1e-12


def seen(x):
    return x
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_radar(tmp_path)
    return tmp_path


def test_a_record_is_a_study_with_its_own_times_and_gaps(folder):
    (study,) = load_studies("radar.toml")
    record = load("radar.toml")
    assert (study.name, study.steps, list(study.filters)) == ("radar-study", 30, ["EKF"])
    np.testing.assert_array_equal(study.elapsed, record.dt[0])
    drawn = draw(study, 1, 0)
    for sensor, z in drawn.z.items():
        theirs = record.z[sensor] if isinstance(record.z, dict) else record.z
        assert (np.isnan(z) == np.isnan(theirs[0])).all()
    (other,) = load_studies("radar.toml", {"track": "B2", "steps": "15"})
    assert other.steps == 15
    np.testing.assert_array_equal(other.prior.mean, record.prior.mean[1])
    done = CliRunner().invoke(app, ["compare", "radar.toml", "--runs", "64", "--set", "steps=12", "--out", "out"])
    assert done.exit_code == 0, done.output
    assert "64 runs are too few" in " ".join(done.output.split())
    for options, message in (
        ({"steps": "31"}, "track A1 has 30 rows"),
        ({"track": "C3"}, "unknown track 'C3'"),
        ({"stepps": "3"}, "no option 'stepps'; its options are: steps (0), track ()"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            load_studies("radar.toml", options)


def test_every_row_has_its_own_inputs(folder):
    """Truth follows the pushes of the rows, one after another, and so do the filters."""
    (folder / "own.py").write_text(OWN)
    (folder / "moved.toml").write_text(MOVED)
    push = [3.0 * (-1) ** k * (k + 1) for k in range(20)]
    times = np.cumsum([0.5 + 0.1 * (k % 3) for k in range(20)]).tolist()
    write_csv(folder / "moved.csv", {"t": times, "push": push, "z": [0.0] * 20})
    (study,) = load_studies("moved.toml")
    np.testing.assert_allclose(study.inputs[:, 0], push)
    drawn = draw(study, 1, 0)
    ways = np.concatenate([[0.0], np.diff(times)]) * push
    np.testing.assert_allclose(drawn.truth[..., 0] - drawn.start, np.broadcast_to(ways.cumsum(), (256, 20)), atol=1e-3)
    assert [s.word for s in standings(compare(study, runs=1000))] == [Word.SOUND] * 2
    # The same where a description of a study names the record as its model.
    (folder / "study.toml").write_text('model = "moved.toml"\nsteps = 10\nruns = 50\ndetection = 0.5\n')
    (short,) = load_studies("study.toml")
    np.testing.assert_allclose(short.inputs[:, 0], push[:10])
    assert (short.runs, short.detection, short.name) == (50, 0.5, "study")
    (folder / "long.toml").write_text('model = "moved.toml"\nsteps = 21\n')
    with pytest.raises(InputError, match=re.escape("long.toml: long: track")):
        load_studies("long.toml")


def test_the_bound_counts_what_is_measured():
    there = np.arange(12)[:, None] % 3 != 1
    c = compare(linear(measured={"": there}), ["EKF"], runs=10)
    P, exact = P0, []
    for seen in there[:, 0]:
        P = F @ P @ F.T + Q
        if seen:
            P = P - P[:, :1] @ P[:1] / (P[0, 0] + R)
        exact.append(np.sqrt(np.diag(P)))
    np.testing.assert_allclose(c.bound, exact, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.einsum("tii->ti", c.measures["EKF"].claimed)), exact, rtol=1e-9)
    with pytest.raises(InputError, match=r"measured must have the shape \(12, m\)"):
        linear(measured={"": there[:5]})
    with pytest.raises(InputError, match="unknown sensor 'rod'"):
        linear(measured={"rod": there})
    assert isinstance(sigmax.compare(linear(detection=0.0), ["EKF"], runs=10).bound, np.ndarray)
