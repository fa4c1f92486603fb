"""The command line: what it leaves, what it refuses, how fast it answers."""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from pyarrow import parquet

import sigmax
from sigmax import records, reports
from sigmax.cli import main
from tests.own_records import RADAR, radar_table, tracked_radar, write_csv, write_radar


def cli(*arguments: str) -> int:
    """Run the command line in this process; its exit status."""
    old, sys.argv = sys.argv, ["sigmax", *arguments]
    try:
        main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    finally:
        sys.argv = old
    return 0


class Finished(NamedTuple):
    """A folder with a description and the results of two filters beside it, and what was printed."""

    folder: Path
    printed: str


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("finished")
    path = write_radar(folder)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        status = cli("track", str(path), "--filter", "EKF", "-f", "EKF:fixed=veast", "--out", str(folder / "results"))
    assert status == 0
    return Finished(folder, printed.getvalue())


def test_the_folder_holds_what_is_promised(finished: Finished) -> None:
    results = finished.folder / "results"
    assert sorted(p.name for p in results.iterdir()) == ["estimates.parquet", "report.html", "summary.json"]
    assert sorted(p.name for p in finished.folder.iterdir()) == ["radar.csv", "radar.toml", "results"]
    summary = json.loads((results / "summary.json").read_text())
    assert list(summary["filters"]) == ["EKF", "EKF:fixed=veast"]
    ekf, fixed = summary["filters"].values()
    assert 5 < ekf["rmse_position_m"] < 60
    assert ekf["expected_nis"] == 2.0
    assert 0.5 < ekf["mean_nis"] < 4
    assert 0 < ekf["seconds"] < 5
    assert fixed["rmse_position_m"] > 3 * ekf["rmse_position_m"]
    assert fixed["grade"] == "too optimistic"
    assert summary["verdict"].startswith("82 measured components are too few")
    assert "So far EKF has the smallest position RMSE" in summary["verdict"]
    assert summary["units"]["vnorth"] == "m/s"
    assert summary["versions"]["sigmax"] == sigmax.__version__


def test_the_estimates_are_those_of_the_library(finished: Finished) -> None:
    path = finished.folder / "results" / "estimates.parquet"
    table = pd.read_parquet(path)
    assert list(table.columns[:6]) == ["filter", "track", "time", "north", "north_std", "north_truth"]
    assert len(table) == 2 * 50
    record, outcome, _ = tracked_radar()
    result = outcome.result
    mine = table[(table["filter"] == "EKF") & (table["track"] == "B2")]
    np.testing.assert_allclose(mine["north"], result.mean[1, :20, 0], rtol=1e-9)
    np.testing.assert_allclose(mine["veast_std"], result.std[1, :20, 3], rtol=1e-9)
    np.testing.assert_allclose(mine["nis"], result.nis[1, :20], rtol=1e-7)
    np.testing.assert_allclose(mine["east_truth"], record.truth[1, :20, 1])
    assert mine["veast_truth"].isna().all()
    assert mine["ok"].all()
    assert parquet.read_schema(path).field("vnorth_std").metadata == {b"unit": b"m/s"}


def test_the_table_is_printed(finished: Finished) -> None:
    assert re.search(r"^filter +RMSE +mean NIS +expected +run +covariance", finished.printed, re.M)
    assert re.search(r"^EKF +\d+\.?\d* m +[\d.]+ +2 \([\d.]+–[\d.]+\) +\S+ s +\w+", finished.printed, re.M)
    told = "".join(finished.printed.split())
    assert f"Report:{finished.folder}/results/report.html" in told


REFUSED = {
    "an unknown record": (["track", "plaza3"], "unknown record 'plaza3'; did you mean .*plaza1"),
    "a missing description": (["track", "none.toml"], "there is no file none.toml; beside it lie radar.toml"),
    "an unknown filter": (["track", "radar.toml", "-f", "SRCKBF"], "did you mean .*SRCKF"),
    "a filter that needs a linear model": (
        ["track", "radar.toml", "-f", "EKF", "-f", "KF"],
        "KF: KF is for linear models",
    ),
    "a folder with other things": (["track", "radar.toml", "-o", "."], "holds other things"),
    "a file in the way": (["track", "radar.toml", "-o", "radar.csv"], "give --out a folder"),
    "something that is no record": (["track", "notes.txt"], "neither a built-in record"),
    "an unknown option": (["track", "radar.toml", "--fliter", "EKF"], "--fliter"),
    "an unknown command": (["trakc"], "trakc"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_one_message_and_status_2(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_radar(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    before = sorted(tmp_path.rglob("*"))
    arguments, words = REFUSED[case]
    monkeypatch.setattr("sigmax.cli.track.track", lambda *_: pytest.fail("a filter ran"))
    assert cli(*arguments) == 2
    told = capsys.readouterr()
    assert re.search(words, told.err)
    assert "Traceback" not in told.err
    assert told.out == ""
    assert sorted(tmp_path.rglob("*")) == before


def test_a_table_without_description_gets_one_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    table = radar_table()
    columns = {
        "time": table["t"],
        "ship_id": [0] * 50,
        "note": ["a"] * 50,
        "x_m": table["north_km"],
        "y_m": table["east_km"],
    }
    write_csv(tmp_path / "ship.csv", columns)
    assert cli("track", "ship.csv") == 2
    told = capsys.readouterr()
    assert "sigmax track ship.csv > ship.toml" in told.err
    (tmp_path / "ship.toml").write_text(told.out)
    record = records.load("ship.toml")
    np.testing.assert_allclose(record.z["position"][0, 1:, 0], table["north_km"][1:])


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_interruption_leaves_nothing_half_written(
    error: type[BaseException],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object) -> str:
        raise error

    record, *outcomes = tracked_radar()
    scores = [reports.score(record, o) for o in outcomes]
    old = tmp_path / "old"
    for _ in range(2):
        # The second time replaces a former result.
        reports.write(old, record, outcomes, scores)
    before = {p.name: p.read_bytes() for p in old.iterdir()}
    monkeypatch.setattr("sigmax.reports.folder.page", interrupted)
    for folder in (old, tmp_path / "new" / "deeper"):
        with pytest.raises(sigmax.InputError if error is OSError else error):
            reports.write(folder, record, outcomes, scores)
    assert [p.name for p in tmp_path.iterdir()] == ["old"]
    assert {p.name: p.read_bytes() for p in old.iterdir()} == before


def test_a_filter_that_fails_is_a_row_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, outcome, _ = tracked_radar()

    def fails(filter: sigmax.Filter, *_: object, **__: object) -> object:
        if filter.name == "UKF":
            raise FloatingPointError("no luck today")
        return outcome.result

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sigmax.records.tracking.run", fails)
    write_radar(tmp_path)
    assert cli("track", "radar.toml", "-f", "UKF", "-f", "EKF", "-o", "both") == 0
    printed = capsys.readouterr().out
    assert "UKF could not be run: FloatingPointError: no luck today" in printed
    summary = json.loads(Path("both/summary.json").read_text())
    assert summary["filters"]["UKF"]["failure"] == "FloatingPointError: no luck today"
    assert summary["filters"]["UKF"]["rmse_position_m"] is None
    assert summary["filters"]["EKF"]["rmse_position_m"] > 0
    assert cli("track", "radar.toml", "-f", "UKF", "-o", "alone") == 1
    assert not Path("alone").exists()


def test_a_loss_inside_the_run_is_told_with_step_and_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.py").write_text(
        "import jax.numpy as jnp\n"
        "def noise(x):\n"
        "    return jnp.where(x[0] > 8000.0, -1.0, 1.0) * jnp.stack([900.0, 1.2e-5])\n"
    )
    description = RADAR.replace('{ range = "30 m", azimuth = "0.2 deg" }', '"far.py:noise"').replace(
        'position_from = "radar"', 'north = { mean = "6 km", std = "5 km" }\neast = { mean = "2 km", std = "5 km" }'
    )
    write_radar(tmp_path, description)
    assert cli("track", "radar.toml") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "EKF broke down:" in printed
    assert re.search(r"the first at track A1, step \d+ \(t = \d+ s\): R is not positive semidefinite", printed)
    summary = json.loads(Path("runs/radar/summary.json").read_text())["filters"]["EKF"]
    table = pd.read_parquet("runs/radar/estimates.parquet")
    assert summary["faults"] == (~table["ok"]).sum() > 0
    assert table[table["track"] == "B2"]["ok"].all()


def run_program(*arguments: str) -> tuple[str, float]:
    """What `sigmax` prints in a process of its own, and the processor's seconds it took."""
    before = os.times()
    done = subprocess.run([sys.executable, "-m", "sigmax.cli", *arguments], capture_output=True, text=True, check=True)
    after = os.times()
    return done.stdout, (after.children_user - before.children_user) + (after.children_system - before.children_system)


def test_help_comes_at_once() -> None:
    """Processor time, the least of five: what other processes do at the same time does not count."""
    printed, _ = run_program("--help")
    assert "sigmax track plaza1" in printed
    assert min(run_program("--help")[1] for _ in range(5)) < 0.4


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys, sigmax.cli\ntry: sigmax.cli.main()\nexcept SystemExit: pass\n"
        "print(*sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True)
    heavy = {"jax", "numpy", "pandas", "plotly", "pyarrow", "scipy", "pydantic"}
    assert not heavy & set(done.stderr.split())


@pytest.mark.parametrize("command", [[], ["track"], ["filters"], ["records"]])
def test_every_help_has_an_example(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    told = []
    for flag in ("-h", "--help"):
        assert cli(*command, flag) == 0
        told.append(capsys.readouterr().out)
    assert told[0] == told[1]
    assert f"Example: sigmax {' '.join(command)}".strip() in told[0]


def test_the_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli("filters") == 0
    printed = capsys.readouterr().out
    for name in sigmax.names():
        assert re.search(rf"^{name} ", printed, re.M)
    assert cli("records") == 0
    assert re.search(r"^plaza2 ", capsys.readouterr().out, re.M)


def test_the_example_of_track_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("importlib.util").find_spec("gtsam") or pytest.skip(
        "gtsam is not installed: pip install 'sigmax[plaza]'"
    )
    assert cli("track", "--help") == 0
    example = re.search(r"Example: sigmax (.*?)\n\n", capsys.readouterr().out, re.S)[1].split()
    monkeypatch.chdir(tmp_path)
    assert cli(*example) == 0
    filters = json.loads(Path("runs/try/summary.json").read_text())["filters"]
    assert list(filters) == ["EKF", "SRUKFB:alpha=0.45,beta=2,kappa=-2"]
    for score in filters.values():
        assert score["rmse_position_m"] <= 0.35
