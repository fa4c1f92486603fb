"""Studies from the command line, from TOML and from a user's file; what is written; the page in a browser."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from sigmax import InputError
from sigmax.cli.app import app
from sigmax.reports.comparison import Word, page, standings, verdict, write
from sigmax.reports.comparison.labels import lifted
from sigmax.studies import compare, load_studies
from sigmax.studies.load import parsed_filters
from tests.browser import opened
from tests.studies.problems import linear, scalar

OWN = """
import jax.numpy as jnp
import sigmax


def motion(x, dt):
    return jnp.stack([x[0] + dt * x[1], x[1]])


def model():
    made = sigmax.Model(motion=motion, sensor=lambda x: x[:1], Q=[0.1, 0.1], R=[1.0], state=("place", "speed"))
    return made, sigmax.Gaussian([0.0, 1.0], [4.0, 1.0])


def study(runs=64):
    made, prior = model()
    filters = {"EKF": sigmax.get("EKF")}
    return sigmax.studies.Study(name="own", model=made, prior=prior, steps=5, filters=filters, runs=runs)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path


def told(*arguments):
    done = CliRunner().invoke(app, list(arguments))
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def test_a_study_of_ones_own_from_the_command_line(folder):
    done = told("compare", "own.py:model", "-f", "EKF SRCKFB", "--runs", "100", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "SRCKFB" in done.output
    assert "100 runs are too few for a verdict" in " ".join(done.output.split())
    inside = folder / "out"
    assert {p.name for p in inside.iterdir()} == {
        "report.html",
        "summary.json",
        "measures.parquet",
        "figures",
        "sums.npz",
    }
    names = {"rmse", "relative", "cost", "consistency", "histograms", "trade"}
    assert {p.name for p in (inside / "figures").iterdir()} == {f"{n}.{kind}" for n in names for kind in ("png", "svg")}
    summary = json.loads((inside / "summary.json").read_text())
    assert set(summary["rmse"]) == set(summary["lost"]) == set(summary["relative_cost"]) == {"EKF", "SRCKFB"}
    assert set(summary["rmse"]["EKF"]) == {"place", "speed"}
    assert set(summary["rmse"]["EKF"]["place"]) == {"1", "3", "10", "32", "100"}
    table = pd.read_parquet(inside / "measures.parquet")
    last = table[(table["filter"] == "EKF") & (table["component"] == "speed") & (table["time"] == 100.0)]
    assert last["rmse"].item() == summary["rmse"]["EKF"]["speed"]["100"]
    # Again, with more runs: the sums are continued, the folder replaced.
    assert summary["verdicts"]["EKF"]["verdict"] == "not known"
    assert summary["verdicts"]["EKF"]["runs_that_would_tell"] <= 1000
    again = told("compare", "own.py:model", "-f", "EKF", "-f", "SRCKFB", "--runs", "1000", "--out", "out")
    assert again.exit_code == 0
    assert "Take " in again.output
    summary = json.loads((inside / "summary.json").read_text())
    assert summary["runs"] == 1000
    assert summary["verdicts"]["EKF"]["verdict"] == "sound"


def test_a_study_as_toml(folder):
    (folder / "mine.toml").write_text(
        'model = "own.py:model"\nsteps = 8\ndt = 0.5\nruns = 50\nfilters = ["EKF", "UKF:alpha=0.5,beta=2,kappa=0"]\n'
        'truth = "fixed"\nstart = [1.0, 2.0]\nestimate = "drawn"\ndetection = 0.8\nlook = [1, 8]\n'
    )
    (study,) = load_studies("mine.toml")
    assert (study.steps, study.dt, study.runs, study.detection) == (8, 0.5, 50, 0.8)
    assert list(study.filters) == ["EKF", "UKF:alpha=0.5,beta=2,kappa=0"]
    c = compare(study)
    np.testing.assert_allclose(c.study.time, np.arange(1, 9) * 0.5)
    assert not c.study.fair
    for line, message in (
        ('truth = "flying"', "unknown truth 'flying'"),
        ("stepps = 3", "did you mean steps"),
        ("steps = 0", "steps"),
        ('filters = ["EKFF"]', "unknown filter 'EKFF'"),
        ('model = "radar-cd"', "is no model"),
    ):
        key = line.partition(" =")[0]
        kept = "" if key == "model" else 'model = "radar-ct"\n'
        (folder / "bad.toml").write_text(f"{kept}{line}\n")
        with pytest.raises(InputError, match=re.escape(message)):
            load_studies("bad.toml")


def test_studies_by_name_and_their_options(folder):
    assert [s.name for s in load_studies("STEPANOV-scalar")] == [f"stepanov-{k}" for k in "ABCD"]
    (own,) = load_studies("own.py:study", {"runs": "33"})
    assert own.runs == 33
    (wide,) = load_studies("sobolev-rmse", {"p0": "literal", "detection": "0.5", "dt": "5"})
    assert wide.dt == 5.0
    assert wide.detections == {"": 0.5}
    named = parsed_filters(["srukfb", "SRUKFB:alpha=1,beta=2,kappa=-2"], wide)
    assert list(named) == ["SRUKFB", "SRUKFB:alpha=1,beta=2,kappa=-2"]
    assert "0.45" in str(named["SRUKFB"].correct)
    for name, options, message in (
        ("sobolev-rms", {}, "did you mean sobolev-rmse"),
        ("sobolev-rmse", {"p1": "x"}, "its options are: p0 (variance)"),
        ("sobolev-rmse", {"dt": "x"}, "dt must be a number; it is 'x'"),
        ("sobolev-rmse", {"p0": "x"}, "unknown reading of P0 'x'"),
        ("radar-ct", {"p0": "x"}, "takes no options"),
        ("own.py:nothing", {}, "nothing"),
        ("missing.toml", {}, "there is no file"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            load_studies(name, options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare", "nothing"], "unknown study 'nothing'"),
        (["compare", "growth", "--filter", "EKFF"], "unknown filter 'EKFF'"),
        (["compare", "growth", "--runs", "1"], "runs must be a whole number of at least 2"),
        (["compare", "growth", "--set", "p0"], "should be option=value"),
        (["compare", "growth", "--out", "own.py"], "is a file"),
        (["compare", "growth", "--out", "."], "holds other things"),
        (["compare", "sobolev-rmse", "--particles", "10"], "no filter is optimal"),
        (["compare", "growth", "--cluster", "moon"], "--cluster moon"),
    ],
)
def test_bad_input_is_refused_in_words(folder, arguments, message):
    with pytest.raises(InputError, match=re.escape(message)):
        told(*arguments)


def test_no_filter_that_runs_is_told_and_not_a_crash(folder):
    done = told("compare", "growth", "-f", "KF", "--runs", "10", "--out", "out")
    assert done.exit_code == 1
    assert "None of these filters could be run." in done.output
    assert "could not be run" in (folder / "out" / "report.html").read_text()


def test_the_lists_name_everything(folder):
    assert all(name in told("studies").output for name in ("sobolev-rmse", "stepanov-scalar", "bearings-only"))


@pytest.fixture(scope="module")
def compared():
    study = scalar(particles=60, optimum_runs=256, title="A <bent> & scalar problem")
    return compare(study, ["EKF", "PF", "KF"], runs=1024)


def test_the_verdict_follows_its_rules(compared):
    found = {s.name: s for s in standings(compared)}
    assert found["KF"].failure
    assert found["PF"].word is Word.SOUND
    assert 0.95 < found["PF"].distance < 1.2
    assert 0.9 < found["PF"].middle < 1.2
    headline, sentences = verdict(compared)
    assert headline.startswith("Take ")
    assert "the optimum" in headline
    assert any(s.startswith("KF could not be run") for s in sentences)
    assert any("120 particles over 256 runs" in s for s in sentences)


_CHOOSE = """
for (const select of document.querySelectorAll("select[data-choice]")) {
  select.selectedIndex = select.options.length - 1; select.dispatchEvent(new Event("change"));
}"""


@pytest.mark.parametrize("width", [390, 1200])
def test_the_page_in_a_browser(width, compared, tmp_path):
    seen = opened(page([compared]), width, tmp_path, _CHOOSE)
    assert seen["problems"] == []
    assert seen["scroll"] <= width
    assert {name: shown for name, shown, _, _ in seen["drawn"]} == {
        "trade": "trade",
        "curves": "curves/bias/0",
        "consistency": "consistency/nis",
        "histogram": "histogram/1/0/3",
        "cost": "cost/0",
    }
    assert all(right <= width for *_, right in seen["drawn"])


def test_single_runs_are_on_the_page_and_as_pictures(tmp_path):
    c = compare(linear(runs=20), runs=20, show=[3])
    seen = opened(page([c]), 390, tmp_path, _CHOOSE)
    assert seen["problems"] == []
    last = c.study.model.dim + c.shown[0].z[""].shape[1] - 1
    assert ("single", f"single/3/{last}") in {(name, shown) for name, shown, _, _ in seen["drawn"]}
    write(tmp_path / "out", [c])
    assert (tmp_path / "out" / "figures" / "run-3.png").stat().st_size > 10_000


def test_names_in_the_chart_do_not_cover_each_other():
    rng = np.random.default_rng(0)
    names = [f"SRFILTER{k}" for k in range(14)]
    x, y = rng.uniform(1, 1.3, 14), rng.uniform(0, 0.1, 14)
    lines = lifted(x, y, names)
    assert min(lines) == 0
    across, up = (x - x.min()) / np.ptp(x), (y - y.min()) / np.ptp(y) + 0.037 * np.array(lines)
    near = (np.abs(up[:, None] - up) < 0.0369) & (np.abs(across[:, None] - across) < 0.12)
    assert near.sum() == 14
    assert lifted([1.0], [2.0], ["EKF"]) == [0]
    assert lifted([], [], []) == []


def test_several_studies_make_one_page(compared, tmp_path):
    html = page([compared, compared])
    seen = opened(html, 1200, tmp_path, "")
    assert seen["problems"] == []
    assert {name for name, *_ in seen["drawn"]} == {
        f"{k}/{name}" for k in range(2) for name in ("trade", "curves", "consistency", "histogram", "cost")
    }
