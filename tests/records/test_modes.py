"""Modes of a description: from TOML to the report."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sigmax
from sigmax.records import load
from tests.test_cli import cli

DESCRIPTION = """
data = "turns.csv"
time = "t"
filters = ["SRCKFB"]
truth = { x = "te", y = "tn" }

[modes.straight]
motion = { kind = "constant_velocity", noise = { density = "1 m2/s3" } }
sojourn = "50 s"

[modes.turn]
motion = { kind = "coordinated_turn_cartesian", noise = { acceleration = "1 m2/s3", turn_rate = "0.02 rad/s" } }
sojourn = "12 s"

[sensors.radar]
kind = "position"
columns = { x = "e", y = "n" }
noise = { x = "30 m", y = "30 m" }

[prior]
position_from = "radar"
vx = { mean = 0, std = "200 m/s" }
vy = { mean = 0, std = "200 m/s" }
turn_rate = { mean = 0, std = "0.1 rad/s" }
"""
SINGLE = {"straight": ("constant_velocity", 'density = "1 m2/s3"'), "turn": ("coordinated_turn_cartesian", None)}


def described(folder: Path, text: str = DESCRIPTION) -> str:
    """A target that turns now and then, and its description."""
    rng, turning, w = np.random.default_rng(0), False, 0.0
    x, v, rows = np.zeros(2), np.array([200.0, 50.0]), []
    for k in range(300):
        if rng.random() < (1 / 12 if turning else 1 / 50):
            turning, w = not turning, rng.choice([-0.08, 0.08])
        if turning:
            v = v @ [[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]]
        x = x + v
        rows.append([k + 1, *(x + rng.normal(size=2) * 30), *x])
    pd.DataFrame(rows, columns=["t", "e", "n", "te", "tn"]).to_csv(folder / "turns.csv", index=False)
    (folder / "turns.toml").write_text(text)
    return str(folder / "turns.toml")


def alone(mode: str) -> str:
    """The description with one of the modes for its motion."""
    head, rest = DESCRIPTION.split("[modes.straight]\n")
    straight, rest = rest.split("[modes.turn]\n")
    turn, rest = rest.split("[sensors.radar]")
    motion = (straight if mode == "straight" else turn).splitlines()[0]
    rest = rest if mode == "turn" else rest.replace('turn_rate = { mean = 0, std = "0.1 rad/s" }\n', "")
    return f"{head}{motion}\n[sensors.radar]{rest}"


def summary(folder: Path, text: str) -> dict:
    folder.mkdir()
    assert cli("track", described(folder, text), "--out", str(folder / "out")) == 0
    return json.loads((folder / "out/summary.json").read_text())["filters"]["SRCKFB"]


@pytest.mark.slow
def test_taking_turns_is_better_than_each_mode(tmp_path: Path) -> None:
    both, straight, turn = (
        summary(tmp_path / name, text)
        for name, text in (("both", DESCRIPTION), ("straight", alone("straight")), ("turn", alone("turn")))
    )
    assert both["grade"] == "consistent"
    assert straight["grade"] == "too optimistic"
    assert both["rmse_position_m"] < 0.9 * min(straight["rmse_position_m"], turn["rmse_position_m"])
    assert set(both["modes"]) == {"straight", "turn"}
    assert np.isclose(sum(both["modes"].values()), 1)
    estimates = pd.read_parquet(tmp_path / "both/out/estimates.parquet")
    assert np.allclose(estimates.probability_straight + estimates.probability_turn, 1)
    page = (tmp_path / "both/out/report.html").read_text()
    assert "Which mode" in page
    assert "noise of the motion in turn, per second" in page


def test_it_is_the_model_that_python_builds(tmp_path: Path) -> None:
    record = load(described(tmp_path))
    assert record.model.state == ("x", "y", "vx", "vy", "turn_rate")
    assert np.allclose(record.model.sojourn, [50, 12])
    assert np.allclose(record.model.initial, [50 / 62, 12 / 62])
    assert np.allclose(record.model.entry[0][1:], [0, 0.01])
    result = sigmax.run("SRCKFB", record.model, record.prior, record.z, dt=record.dt[:, 1:], update_first=True)
    assert result.ok.all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('sojourn = "12 s"', 'sojourn = "0 s"', "modes.turn.sojourn must be above 0"),
        ('sojourn = "12 s"', 'sojourn = "12 m"', "modes.turn.sojourn"),
        ('sojourn = "12 s"\n', "", "needs the key 'sojourn'"),
        ("[modes.straight]", '[motion]\nkind = "singer"\nnoise = 1\n[modes.straight]', "both say how it moves"),
        ("turn_rate = { mean = 0", "turnrate = { mean = 0", "so it comes into a mode"),
        ('sojourn = "12 s"', 'sojourn = "12 s"\nprobability = 0.7', "no entry for the modes"),
        ('sojourn = "12 s"', 'sojourn = "12 s"\nfilter = "XKF"', "XKF"),
        ('kind = "constant_velocity"', 'kind = "constant_speed"', "modes.straight.motion.kind"),
        ('density = "1 m2/s3"', 'densty = "1 m2/s3"', "modes.straight.motion.noise"),
    ],
)
def test_what_is_wrong_in_a_description_of_modes(old, new, words, tmp_path, capsys) -> None:
    assert old in DESCRIPTION
    assert cli("track", described(tmp_path, DESCRIPTION.replace(old, new)), "--out", str(tmp_path / "out")) == 2
    assert words in capsys.readouterr().err.replace("\n", " ")
