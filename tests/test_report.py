"""Scores, the verdict in words, and the page in a real browser."""

import dataclasses
import gzip
import hashlib
import json
import re
from html import unescape
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import sigmax
from sigmax.records import Outcome, Record, parse_trial
from sigmax.reports import Grade, Score, grade, score, verdict
from sigmax.reports.figures import nis_figure
from sigmax.reports.page import page
from sigmax.reports.score import misses
from sigmax.reports.verdict import best, nis_in_words, significant
from sigmax.views.thin import stride, thin
from tests.browser import opened, unpacked
from tests.own_records import tracked_radar


def made(label: str, rmse: float | None, nis: float, **more: object) -> Score:
    """A score whose NIS is known to 7 %."""
    known = {
        "nis_ratio": (0.93 * nis, 1.07 * nis),
        "nis_bounds": (0.95, 1.05),
        "components": 2000,
        "measurements": 2000,
    }
    return Score(label, label, rmse_position_m=rmse, mean_nis=nis, expected_nis=1.0, seconds=1.0, **(known | more))


def test_grades_follow_their_rules() -> None:
    wanted = {
        1.0: Grade.CONSISTENT,
        1.05: Grade.CONSISTENT,
        1.06: Grade.NEAR,
        0.75: Grade.NEAR,
        1.45: Grade.UNKNOWN,
        1.7: Grade.OPTIMISTIC,
        0.65: Grade.UNKNOWN,
        0.6: Grade.CAUTIOUS,
    }
    for nis, expected in wanted.items():
        assert grade(made("a", 1.0, nis)) is expected
    assert grade(made("a", 1.0, 1.0, heavy=True)) is Grade.HEAVY
    assert grade(made("a", 1.0, 9.0, heavy=True)) is Grade.OPTIMISTIC
    assert grade(made("a", 1.0, 1.0, faults=1, first_fault="step 3")) is Grade.FAULTY
    assert grade(Score("a", "a", failure="ValueError: no")) is Grade.FAILED
    assert grade(Score("a", "a")) is Grade.UNKNOWN


def scored(nis: np.ndarray, dof: int = 1) -> Score:
    """The score of a filter with this NIS (T,)."""
    total = dof * len(nis)
    bounds = tuple(chi2.ppf([0.025, 0.975], total) / len(nis))
    found = misses(np.ones((1, len(nis)), bool), nis[None], np.full((1, len(nis)), dof))
    mean = float(nis.mean())
    count = {"components": total, "measurements": len(nis)}
    return Score("a", "a", mean_nis=mean, expected_nis=float(dof), nis_bounds=bounds, **count, **found)


@pytest.mark.parametrize("nis", [0.0, 1e-300, 1e-30])
def test_measurements_that_are_expected_exactly_tell_nothing_of_tails_and_stretches(nis):
    found = misses(np.ones((1, 50), bool), np.full((1, 50), nis), np.ones((1, 50), int))
    assert not found["beyond"]
    assert not found["heavy"]
    assert found["stretches"] is None


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_a_verdict_on_a_record_is_not_turned_into_its_opposite_by_more_of_it(dof: int) -> None:
    """Draws of known size: graded by their beginning, and by more and more of them."""
    opposite = {Grade.OPTIMISTIC: -1, Grade.CAUTIOUS: 1, Grade.CONSISTENT: 0, Grade.NEAR: 0}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        squares = (rng.standard_normal((3000, dof)) ** 2).sum(1)
        final = {}
        for ratio in (0.2, 0.5, 1.0, 1.2, 2.5, 50.0):
            grades = [grade(scored(ratio * squares[:T], dof)) for T in (5, 20, 60, 300, 3000)]
            said = {opposite[g] for g in grades if g is not Grade.UNKNOWN}
            assert len(said) <= 1, (ratio, grades)
            final[ratio] = grades
        assert final[1.0][-1] in (Grade.CONSISTENT, Grade.NEAR)
        assert final[1.0][0] is Grade.UNKNOWN
        assert final[0.2][-1] is final[0.5][-1] is Grade.CAUTIOUS
        assert final[2.5][-1] is final[50.0][-1] is Grade.OPTIMISTIC


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
def test_noise_raised_over_outliers_is_seen_in_the_tails(share: float) -> None:
    """The mean of the NIS is 1, and nothing else is as it should be."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        miss = rng.standard_normal(500) * np.where(rng.random(500) < share, 30.0, 1.0)
        found = scored(miss**2 / (miss**2).mean())
        assert found.mean_nis == pytest.approx(1.0)
        assert grade(found) is Grade.HEAVY
        assert found.kurtosis > 10
        headline, sentences = verdict([found])
        assert "though its misses have heavy tails" in headline
        assert "kurtosis" in sentences[0]
        assert "outliers" in sentences[0]
    clean = [scored(np.random.default_rng(seed).standard_normal(500) ** 2) for seed in range(50)]
    assert not any(s.heavy for s in clean)
    assert not any(s.stretches for s in clean)


def test_misses_that_last_are_told() -> None:
    rng = np.random.default_rng(3)
    offset = np.repeat(rng.standard_normal(20) * 2, 30)
    found = scored((offset + rng.standard_normal(600)) ** 2 / 5)
    assert found.stretches > 0.2
    assert "one after another" in verdict([found])[1][0]


@pytest.mark.parametrize("scale", [1e-3, 0.02, 0.1, 0.3, 0.7, 2.0, 10.0])
def test_a_lasting_cause_is_named_only_where_misses_are_large(scale: float) -> None:
    """Small misses that are correlated say that a filter is too cautious, and nothing else."""
    rng = np.random.default_rng(3)
    offset = np.repeat(rng.standard_normal(20) * 2, 30)
    found = scored((offset + rng.standard_normal(600)) ** 2 / 5 * scale)
    assert found.stretches > 0.2
    sentence = verdict([found])[1][0]
    assert ("something that lasts" in sentence) == (found.mean_nis > found.nis_bounds[1])
    assert ("something that lasts" in sentence) == (scale > 1)


def test_the_advice_is_the_best_of_those_that_can_be_believed() -> None:
    scores = [
        made("A", 0.31, 1.0),
        made("B", 0.30, 0.98),
        made("C", 0.302, 1.2),
        made("D", 0.1, 16.2),
        made("E", 0.2, 0.1),
    ]
    headline, sentences = verdict(scores)
    assert headline == (
        "Take B: position RMSE 0.3 m, the smallest of the 3 whose covariance can be believed. C is equally good."
    )
    assert sentences[0].startswith("B: mean NIS 0.98 against an expected 1, within its bounds")
    assert sentences[1] == (
        "D: mean NIS 16.2 against an expected 1: this filter's covariance cannot be believed; "
        "its model lacks something. Measurements miss by 4.02 times what it claims. "
        "Its position is off by 0.1 m (RMSE)."
    )
    assert "E: mean NIS 0.1 against an expected 1: too cautious" in sentences[2]
    assert "lower R, or Q" in sentences[2]


def test_other_verdicts(tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    assert best([made("D", 0.1, 16.2)]) is None
    assert verdict([made("D", 0.1, 16.2)])[0].startswith("D cannot be believed")
    assert verdict([made("D", 0.1, 16.2), made("F", 0.2, 9.0)])[0].startswith("None of these filters can be believed")
    # Caution is not dishonest: amber, and it can be used.
    careful = verdict([made("D", 0.1, 16.2), made("E", 0.2, 0.1)])[0]
    assert careful == "Take E, the only one that can be used, though it is too cautious: position RMSE 0.2 m."
    assert verdict([made("E", 0.2, 0.3)])[0] == "E can be used, though it is too cautious: position RMSE 0.2 m."
    record, outcomes, _ = tracked
    assert 'class="verdict open"' in page(record, outcomes[:1], [made("EKF", 0.2, 0.3)])
    few = made("G", 0.1, 1.2, nis_ratio=(0.5, 3.0), components=20, measurements=20)
    assert verdict([few, made("D", 0.1, 16.2)])[0] == (
        "20 measured components are too few to say whether a covariance can be believed; about 300 would tell. "
        "So far G has the smallest position RMSE, 0.1 m, of those that may be believed."
    )
    assert verdict([made("A", 0.5, 1.0)])[0] == "A can be used: position RMSE 0.5 m."
    assert verdict([made("A", 0.5, 1.0), made("D", 0.1, 9.0)])[0].startswith("Take A, the only one whose covariance")
    # Without truth the likelihood decides.
    known = [made("A", None, 1.0, log_likelihood=-50.0), made("B", None, 1.0, log_likelihood=-40.0)]
    assert verdict(known)[0] == "Take B: the largest likelihood of the 2 whose covariance can be believed."
    broken = made("F", 0.1, 1.0, faults=2, first_fault="step 7 (t = 3 s): Q is not positive semidefinite at this step")
    assert "F broke down: 2 steps were not sound, the first at step 7" in verdict([made("A", 0.5, 1.0), broken])[1][1]
    assert (
        "G could not be run: ValueError: no"
        in verdict([made("A", 0.5, 1.0), Score("G", "G", failure="ValueError: no")])[1][1]
    )
    assert verdict([Score("A", "A")])[0].startswith("Nothing was measured")
    # What did not run is not judged.
    failed = [Score(name, name, failure="ValueError: no") for name in ("G", "H")]
    assert verdict(failed[:1])[0] == "G could not be run."
    assert verdict(failed)[0] == "None of these filters could be run."


def test_numbers_read_well() -> None:
    assert [significant(v) for v in (0.0, 0.30001, 12345.6, 1e-7, 2.5e8, 100.0)] == [
        "0",
        "0.3",
        "12300",
        "1.00e-07",
        "2.50e+08",
        "100",
    ]


def test_bounds_are_shown_with_the_digits_they_need() -> None:
    assert nis_in_words(made("A", 1.0, 16.2)) == ("16.2", "1 (0.95–1.05)")
    many = Score("A", "A", mean_nis=1.9987654, expected_nis=2.0, nis_bounds=(1.99608, 2.00392))
    assert nis_in_words(many) == ("1.999", "2 (1.996–2.004)")
    assert nis_in_words(Score("A", "A")) == ("–", "–")


def test_thinning_keeps_what_stands_out() -> None:
    y = np.sin(np.arange(100_000) / 900)
    y[54_321], y[7] = 9.0, -9.0
    at = thin(y, 1000)
    assert len(at) <= 1000
    assert (np.diff(at) > 0).all()
    assert {7, 54_321} <= set(at)
    assert thin(y[:50], 60).tolist() == list(range(50))
    assert stride(5, 10).tolist() == [0, 1, 2, 3, 4]
    assert stride(1000, 10)[[0, -1]].tolist() == [0, 999]


@pytest.fixture
def tracked() -> tuple[Record, list[Outcome], list[Score]]:
    """Two tracks, one filter that works, the same with a speed fixed at 0, and one that could not be run."""
    record, *ran = tracked_radar()
    outcomes = [*ran, Outcome(parse_trial("SRCKFB"), None, float("nan"), None, "ValueError: </script> no")]
    return record, outcomes, [score(record, o) for o in outcomes]


def test_scores_are_what_they_say(tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    record, outcomes, scores = tracked
    result, s = outcomes[0].result, scores[0]
    errors, nis = [], []
    for k, T in enumerate(record.steps):
        errors.append(result.mean[k, :T, :2] - record.truth[k, :T, :2])
        nis.append(result.nis[k, :T])
    nis = np.concatenate(nis)
    assert s.rmse_position_m == pytest.approx(np.sqrt((np.concatenate(errors) ** 2).sum(1).mean()))
    assert s.rmse["north"] == pytest.approx(np.sqrt((np.concatenate(errors)[:, 0] ** 2).mean()))
    assert set(s.rmse) == {"north", "east"}
    assert s.mean_nis == pytest.approx(np.nanmean(nis))
    assert s.measurements == np.isfinite(nis).sum()
    assert s.expected_nis == 2.0
    # Bounds of a mean of chi-square variables, against draws.
    draws = np.random.default_rng(0).chisquare(2, (20_000, s.measurements)).mean(1)
    np.testing.assert_allclose(s.nis_bounds, np.quantile(draws, [0.025, 0.975]), rtol=0.02)
    assert s.log_likelihood == pytest.approx(result.log_likelihood.sum())
    assert (s.faults, s.failure, scores[2].failure) == (0, "", "ValueError: </script> no")


def test_a_fault_is_told_with_track_step_and_reason(
    tracked: tuple[Record, list[Outcome], list[Score]], monkeypatch: pytest.MonkeyPatch
) -> None:
    record, outcomes, _ = tracked
    fault = np.array(outcomes[0].result.fault)
    # Step 25 of track B2 is padding.
    fault[1, [12, 25]] = sigmax.running.Fault.SENSOR_NOISE_INDEFINITE
    monkeypatch.setattr(sigmax.running.Smoothed, "fault", property(lambda _: fault))
    s = score(record, outcomes[0])
    assert s.faults == 1
    assert s.first_fault.startswith("track B2, step 12 (t = 24 s): R is not positive semidefinite at this step")


def figures_of(html: str) -> dict:
    return json.loads(unpacked(html, "figures"))


def test_the_page_holds_everything_and_loads_nothing(tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    record, _, scores = tracked
    html = page(*tracked)
    assert unpacked(html, "plotly").startswith("/**\n* plotly.js (cartesian")
    assert len(html) < 2e6
    without_plotly = re.sub(r"<script[ >].*?</script>", "", html, flags=re.S)
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:)""", without_plotly)
    assert "<b>&</b>" not in without_plotly
    text = unescape(re.sub(r"<[^>]+>", " ", without_plotly))
    assert verdict(scores)[0] in text
    assert "could not be run: ValueError" in text
    figures = figures_of(html)
    assert set(figures) == {"path", "nis", *(f"components/{i}/{k}" for i in (0, 1) for k in (0, 1))}
    names = [trace["name"] for trace in figures["path"]["data"]]
    assert names[0] == "truth"
    assert "2σ of EKF" in names
    assert "radar" in figures["path"]["data"][-1]["text"]
    first = figures["components/0/0"]["data"]
    assert len(first) == 3 * record.model.size
    assert len(first[2]["y"]) == 30


def test_the_moving_nis_is_an_average_over_tracks_and_times(
    tracked: tuple[Record, list[Outcome], list[Score]],
) -> None:
    record, outcomes, _ = tracked
    figure, window = nis_figure(record, [(0, "EKF", outcomes[0])])
    nis, dof = (np.nan_to_num(v) for v in (outcomes[0].result.nis, outcomes[0].result.dof))
    times = np.unique(record.time[(dof > 0) & record.real])
    inside = (record.time >= times[0]) & (record.time <= times[window - 1]) & record.real
    trace = next(t for t in figure["data"] if t["name"] == "EKF")
    assert trace["x"][0] == times[window - 1]
    assert trace["y"][0] == pytest.approx(nis[inside].sum() / dof[inside].sum(), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 0.01, 0.3, 1.0, 40.0, 1e8])
def test_the_axis_of_the_nis_holds_all_of_it(scale: float, tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    record, outcomes, _ = tracked
    result = outcomes[0].result
    outcome = dataclasses.replace(outcomes[0], result=dataclasses.replace(result, stored_nis=result.nis * scale))
    figure, _ = nis_figure(record, [(0, "EKF", outcome)])
    axis = figure["layout"]["yaxis"]
    low, high = (10**end for end in axis["range"])
    for trace in figure["data"]:
        assert all(low < y < high for y in trace["y"])
    assert 3 <= sum(low < tick < high for tick in axis["tickvals"]) <= 20


def test_ellipses_hold_two_standard_deviations(tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    _, outcomes, _ = tracked
    figure = figures_of(page(*tracked))["path"]
    trace = next(t for t in figure["data"] if t["name"] == "2σ of EKF")
    pieces, piece = [], []
    for x, y in [*zip(trace["x"], trace["y"], strict=True), (None, None)]:
        if x is None:
            pieces.append(np.array(piece))
            piece = []
        else:
            piece.append((x, y))
    mean, cov = outcomes[0].result.mean[0, 0], outcomes[0].result.cov[0, 0]
    # East is drawn to the right, north upwards.
    away = pieces[0][:, ::-1] - mean[:2]
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", away, np.linalg.inv(cov[:2, :2]), away), 4.0, rtol=1e-3)


_CHOOSE = """
const select = document.querySelector('select[data-choice="track"]');
select.value = "1"; select.dispatchEvent(new Event("change"));"""


@pytest.mark.parametrize("width", [390, 1200])
def test_the_page_in_a_browser(width: int, tracked: tuple[Record, list[Outcome], list[Score]], tmp_path: Path) -> None:
    """Every figure is drawn, nothing complains, and nothing reaches beyond the screen."""
    told = opened(page(*tracked), width, tmp_path, _CHOOSE)
    assert told["problems"] == []
    assert told["scroll"] <= width
    assert {name: shown for name, shown, _, _ in told["drawn"]} == {
        "path": "path",
        "components": "components/0/1",
        "nis": "nis",
    }
    for _, _, traces, right in told["drawn"]:
        assert traces >= 3
        assert right <= width


def test_a_record_without_truth_and_map_has_a_page_too(tracked: tuple[Record, list[Outcome], list[Score]]) -> None:
    record, outcomes, _ = tracked
    bare = dataclasses.replace(
        record,
        truth=np.full_like(record.truth, np.nan),
        position=(),
        landmarks={},
        epoch=sigmax.records.record.pd.Timestamp("2024-05-01", tz="UTC"),
    )
    scores = [score(bare, o) for o in outcomes[:1]]
    assert scores[0].rmse_position_m is None
    html = page(bare, outcomes[:1], scores)
    figures = figures_of(html)
    assert "path" not in figures
    assert figures["components/0/0"]["data"][2]["x"][1] == "2024-05-01T00:00:02"
    assert 'data-label="position RMSE"' not in html


def test_times_and_places_far_from_zero_are_drawn_from_an_origin(
    tracked: tuple[Record, list[Outcome], list[Score]],
) -> None:
    """Seconds since 1970 and UTM coordinates: what a point tells survives, ticks are dates, titles name the origin."""
    record, outcomes, scores = tracked
    north, east, start = 5_819_000.0, 487_000.0, 1.7e9
    away = np.zeros(record.model.size)
    away[list(record.position)] = [north, east] if record.model.state[record.position[0]] == "north" else [east, north]
    moved = dataclasses.replace(
        record,
        time=record.time + start,
        truth=record.truth + away,
        landmarks={
            n: (p[0] + away[record.position[0]], p[1] + away[record.position[1]]) for n, p in record.landmarks.items()
        },
    )
    far = [dataclasses.replace(o, result=shifted(o.result, away)) for o in outcomes[:1]]
    near_page, far_page = figures_of(page(record, outcomes[:1], scores[:1])), figures_of(page(moved, far, scores[:1]))

    def offset(title: str) -> float:
        found = re.search(r"− ([\d,]+) m", title)
        return float(found[1].replace(",", "")) if found else 0.0

    for axis, home in (("x", east), ("y", north)):
        taken = offset(far_page["path"]["layout"][f"{axis}axis"]["title"]["text"])
        assert abs(taken - home) < 1e5
        for one, other in zip(near_page["path"]["data"], far_page["path"]["data"], strict=True):
            theirs = [None if v is None else v + taken - home for v in other[axis]]
            np.testing.assert_allclose(np.array(one[axis], float), np.array(theirs, float), atol=1e-3)
    x = far_page["components/0/0"]["data"][2]["x"]
    assert x[0] == "2023-11-14T22:13:20"
    assert len(set(x)) == len(x) == 30
    assert far_page["nis"]["layout"]["xaxis"]["title"]["text"] == "time (UTC)"
    # A clock of another kind: since its own start.
    odd = dataclasses.replace(record, time=record.time + 5e6)
    figures = figures_of(page(odd, outcomes[:1], scores[:1]))
    assert figures["components/0/0"]["layout"]["xaxis"]["title"]["text"] == "time since 5000000 s [s]"
    assert figures["components/0/0"]["data"][2]["x"][:2] == [0.0, 2.0]
    # Without truth the component itself is drawn: not a step may be lost.
    blind = dataclasses.replace(moved, truth=np.full_like(moved.truth, np.nan))
    drawn = figures_of(page(blind, far, scores[:1]))["components/0/0"]["data"][2]["y"]
    np.testing.assert_allclose(drawn, far[0].result.mean[0, :30, 0], atol=1e-3)


def shifted(result: sigmax.Result, by: np.ndarray) -> sigmax.Result:
    """The same result with its means elsewhere."""
    mean = result.stored_mean
    place = by.reshape(-1, *[1] * (mean.ndim - 1)) if mean.shape[0] == len(by) else by
    return dataclasses.replace(result, stored_mean=mean + place)


def test_plotly_is_the_one_that_its_note_names() -> None:
    folder = files("sigmax.reports") / "plotly"
    code = gzip.decompress((folder / "plotly-cartesian.min.js.gz").read_bytes())
    note = (folder / "README.md").read_text(encoding="utf-8")
    assert hashlib.sha256(code).hexdigest() in note
    assert re.search(rb"plotly.js \(cartesian - minified\) v([\d.]+)", code)[1].decode() in note
    assert "Permission is hereby granted" in (folder / "LICENSE").read_text(encoding="utf-8")
