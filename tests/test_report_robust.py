"""Reports of robust filters: one is looked for where tails are heavy, and what it did not take in full is shown."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from sigmax.records import Outcome, load, parse_trial, robust_trial, track
from sigmax.reports import Grade, grade, score
from tests.browser import opened
from tests.test_cli import cli

DESCRIPTION = """
data = "r.csv"
time = "time"
filters = ["SRCKFB"]

[motion]
kind = "constant_velocity"
axes = ["x", "y"]
noise = { density = "0.01 m^2/s^3" }

[sensors.gps]
kind = "position"
columns = { x = { column = "x", unit = "m" }, y = { column = "y", unit = "m" } }
noise = { x = "0.5 m", y = "0.5 m" }

[prior]
position_from = "gps"
vx = { mean = 0, std = "2 m/s" }
vy = { mean = 0, std = "2 m/s" }
"""
TIMES = np.arange(400) * 0.5


def straight(rng: np.random.Generator) -> np.ndarray:
    """What the description says: a speed that changes a little."""
    return np.cumsum(1 + np.cumsum(rng.normal(scale=0.1 * 0.5**0.5, size=(400, 2)), 0), 0) * 0.5


def described(folder: Path, path: np.ndarray, share: float, rng: np.random.Generator) -> str:
    """A description of positions on a path, so many of them with twenty times the deviation."""
    noise = rng.normal(scale=0.5, size=(400, 2))
    noise[rng.random(400) < share] *= 20
    rows = np.column_stack([TIMES, path + noise])
    np.savetxt(folder / "r.csv", rows, delimiter=",", header="time,x,y", comments="")
    (folder / "r.toml").write_text(DESCRIPTION)
    return str(folder / "r.toml")


def reported(folder: Path, share: float) -> tuple[dict, str]:
    """The summary and the page of a record with outliers."""
    rng = np.random.default_rng(7)
    assert cli("track", described(folder, straight(rng), share, rng), "--out", str(folder / "out")) == 0
    return json.loads((folder / "out/summary.json").read_text()), (folder / "out/report.html").read_text()


def test_outliers_bring_a_robust_filter(tmp_path: Path) -> None:
    summary, html = reported(tmp_path, 0.08)
    plain, robust = summary["filters"].values()
    assert plain["grade"] == "too optimistic"
    assert plain["weights"] == {}
    assert "student" in robust["label"]
    assert robust["label"] in summary["verdict"]
    assert robust["grade"] in ("consistent", "plausible")
    counted = robust["weights"]["gps"]
    assert (counted["measurements"], counted["refused"]) == (399, 0)
    assert 20 < counted["lowered"] < 50
    told = opened(html, 1200, tmp_path, "")
    assert told["problems"] == []
    assert "weights" in {name for name, *_ in told["drawn"]}


def test_without_outliers_there_is_none(tmp_path: Path) -> None:
    summary, html = reported(tmp_path, 0.0)
    assert list(summary["filters"]) == ["SRCKFB"]
    assert "What was not taken in full" not in html


ROBUST = ("student", "student(0.5)", "huber", "gate")


def outside(outcome: Outcome, path: np.ndarray) -> float:
    """The share of steps whose position is outside of the claimed 95 % region."""
    off, P = outcome.result.mean[0, :, :2] - path, outcome.result.cov[0, :, :2, :2]
    nees = np.einsum("ti,ti->t", off, np.linalg.solve(P, off[..., None])[..., 0])
    return float((nees > chi2(2).ppf(0.95)).mean())


TURN = 50 * np.column_stack([np.cos(TIMES / 8), np.sin(TIMES / 8)])
JUMPS = np.repeat(np.cumsum(np.where(np.arange(400) % 60 < 3, 6.0, 0.2))[:, None], 2, 1)
TACKS = np.cumsum(np.where((np.arange(400) // 50)[:, None] % 2, [[2.0, 0.0]], [[0.0, 2.0]]), 0)


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("path", [TURN, JUMPS, TACKS], ids=["turn", "jumps", "tacks"])
@pytest.mark.one_in(2)
def test_what_a_model_lacks_is_not_explained_away(path: np.ndarray, share: float, tmp_path: Path) -> None:
    """Weighed down often enough, a wrong model agrees with what is left; its covariance is not believed for that."""
    record = load(described(tmp_path, path, share, np.random.default_rng(0)))
    trials = [parse_trial(f"SRCKFB:update={update}") for update in ROBUST]
    found = robust_trial(record, parse_trial("SRCKFB"))
    outcomes = [track(record, trial) for trial in [*trials, *([] if found is None else [found])]]
    assert any(outside(o, path) > 0.4 for o in outcomes)
    for outcome in outcomes:
        assert outside(outcome, path) < 0.15 or grade(score(record, outcome)) is Grade.OPTIMISTIC


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.0, 0.1])
def test_what_weighs_outliers_down_is_not_blamed(share: float, seed: int, tmp_path: Path) -> None:
    """A filter whose errors are as large as it claims is not too optimistic, though it expects too heavy tails."""
    rng = np.random.default_rng(seed)
    path = straight(rng)
    record = load(described(tmp_path, path, share, rng))
    for update in ROBUST:
        outcome = track(record, parse_trial(f"SRCKFB:update={update}"))
        # Huber's takes an outlier for one of a few deviations, and claims too little where one of ten is.
        if (update, share) != ("huber", 0.1):
            assert outside(outcome, path) < 0.1
            assert grade(score(record, outcome)) is not Grade.OPTIMISTIC or (update, share) == ("student", 0.1)
