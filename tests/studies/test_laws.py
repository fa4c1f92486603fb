"""What a study must give whatever is studied: known answers, and the same bits however the work is dealt out."""

import io

import numpy as np
import pytest

import sigmax
from sigmax import InputError
from sigmax.reports.comparison import verdict
from sigmax.studies.bank import bank
from sigmax.studies.beforehand import yardsticks
from sigmax.studies.claims import claims_of
from sigmax.studies.measures import histogram, measures
from sigmax.studies.particles import particles
from sigmax.studies.simulate import draw
from sigmax.studies.sums import Estimated, bin_edges, summed
from sigmax.studies.work import Work, estimate
from tests.studies.problems import P0, F, Q, R, linear, scalar


def exact_covariances(steps):
    """The Kalman filter's, written out."""
    P, found = P0, []
    for _ in range(steps):
        P = F @ P @ F.T + Q
        K = P[:, :1] / (P[0, 0] + R)
        P = P - K @ P[:1]
        found.append((P + P.T) / 2)
    return np.array(found)


def test_on_a_linear_model_everything_is_known():
    study = linear()
    c = sigmax.compare(study, runs=2000)
    exact = exact_covariances(study.steps)
    variances = np.einsum("tii->ti", exact)
    for m in c.measures.values():
        np.testing.assert_allclose(m.claimed, exact, rtol=1e-10)
        assert (np.abs(m.rmse.value - np.sqrt(variances)) < 4.5 * m.rmse.error).all()
        assert (np.abs(m.ratio.value - 1) < 4.5 * m.ratio.error).all()
        assert (np.abs(m.bias.value) < 4.5 * m.bias.error).all()
        assert ((m.nees.low < m.nees.value) & (m.nees.value < m.nees.high)).mean() > 0.6
        np.testing.assert_allclose(m.nees.expected, 2.0)
        assert abs(m.nis.value.mean() - 1) < 4.5 * np.sqrt(2 / (2000 * study.steps))
        # The median of |e| of a Gaussian is 0.6745 σ.
        look = c.by.look
        assert (np.abs(m.median.value - 0.6745 * np.sqrt(variances[look])) < 5 * m.median.error + 0.004).all()
        assert float(m.lost["all"].value) < 0.001
    # The bound of a linear model is the Kalman filter.
    np.testing.assert_allclose(c.bound, np.sqrt(variances), rtol=1e-9)
    assert c.no_bound == ""


@pytest.mark.parametrize("way", ["guided", "bootstrap", "bank"])
def test_every_way_to_the_optimum_finds_the_kalman_filter(way):
    study = linear(optimum=way, steps=5)
    drawn = draw(study, 3, 0)
    cut = drawn._replace(**{k: getattr(drawn, k)[:16] for k in ("start", "truth", "mean", "kept")})
    cut = cut._replace(z={s: v[:16] for s, v in drawn.z.items()})
    found = bank(study, cut, 400, (3, 0)) if way == "bank" else particles(study, cut, 4000, (3, 0), way)
    exact = sigmax.run("EKF", study.model, study.prior, cut.z[""])
    sigma = exact.std
    assert np.abs(found.mean - exact.mean).max() < 0.35 * sigma.max()
    assert np.sqrt((((found.mean - exact.mean) / sigma) ** 2).mean()) < 0.08
    ratio = np.sqrt((found.factor**2).sum(-1)) / sigma
    assert abs(ratio.mean() - 1) < 0.03


def test_what_finitely_many_particles_miss_is_extrapolated_away():
    """On a linear model the optimum is the Kalman filter, whose variance so few particles claim too small."""
    c = sigmax.compare(linear(optimum_runs=1024), ["EKF"], runs=1024, particles=60)
    exact = np.einsum("tii->ti", exact_covariances(12))
    few, more, limit = (
        float((np.einsum("tii->ti", m.claimed) / exact).mean() - 1)
        for m in (c.optimum.measures, c.optimum.check, c.optimum.limit)
    )
    assert few < 2 * more / 1.5 < -0.015
    assert abs(limit) < 0.5 * abs(more)
    kalman = c.optimum.filters["EKF"].rmse.value ** 2
    real = [
        float((m.rmse.value**2 / kalman).mean() - 1) for m in (c.optimum.measures, c.optimum.check, c.optimum.limit)
    ]
    assert real[0] > real[1] > 0.01
    assert abs(real[2]) < 0.5 * real[1]
    assert "extrapolated away" in verdict(c)[1][-1]


def test_sums_are_what_they_say_and_add_up():
    study = scalar(look=(1, 6))
    drawn = draw(study, 5, 0)
    work = Work(study, study.filters, yardsticks(study, None), 5, False, None)
    found = estimate(work, "PF", drawn)
    truth = drawn.truth
    whole = measures(summed(found, truth, None, work.by))
    error = found.mean - truth
    variance = (found.factor**2).sum(-1)
    np.testing.assert_allclose(whole.rmse.value, np.sqrt((error**2).mean(0)))
    np.testing.assert_allclose(whole.real[:, 0, 0], (error[..., 0] ** 2).mean(0))
    np.testing.assert_allclose(whole.claimed[:, 0, 0], variance[..., 0].mean(0))
    np.testing.assert_allclose(whole.nees.value, (error**2 / variance).mean(0)[:, 0])
    np.testing.assert_allclose(whole.nis.value, found.nis.mean(0))
    np.testing.assert_allclose(whole.bias.value, error.mean(0))
    np.testing.assert_allclose(whole.median.value, np.median(np.abs(error[:, [0, 5]]), axis=0))
    # The standard error of a ratio of means, by drawing the runs again.
    rng = np.random.default_rng(0)
    again = [rng.integers(0, len(error), len(error)) for _ in range(400)]
    ratios = [(error[k, -1, 0] ** 2).mean() / variance[k, -1, 0].mean() for k in again]
    assert 0.8 < whole.ratio.error[-1, 0] / np.std(ratios) < 1.25

    def part(rows):
        return summed(Estimated(*(a[rows] for a in found)), truth[rows], None, work.by)

    both = part(slice(0, 100)).plus(part(slice(100, None)))
    np.testing.assert_allclose(measures(both).rmse.value, whole.rmse.value, rtol=1e-12)
    assert both.bins.sum() == len(error) * 2


def test_a_histogram_has_the_density_of_its_errors():
    errors = np.random.default_rng(1).standard_normal(200_000) * 0.02
    scale = 3.0
    bins, _ = np.histogram(errors, bin_edges(np.array(scale)))
    density, edges = histogram(bins, scale, 0.08)
    middle = (edges[1:] + edges[:-1]) / 2
    wanted = np.exp(-0.5 * (middle / 0.02) ** 2) / (0.02 * np.sqrt(2 * np.pi))
    assert np.abs(density - wanted).max() < 0.03 * wanted.max()


def same(a, b):
    return all(
        np.array_equal(x, y, equal_nan=True) for name in a.sums for x, y in zip(a.sums[name], b.sums[name], strict=True)
    )


def test_the_same_bits_for_any_workers_and_chunks_and_more_runs_begin_with_the_same():
    study = scalar(particles=50, optimum_runs=300)
    one = sigmax.compare(study, runs=900, workers=1)
    many = sigmax.compare(study, runs=900, workers=2, chunk=3)
    assert same(one, many)
    assert np.array_equal(one.optimum.check.rmse.value, many.optimum.check.rmse.value)
    assert not same(one, sigmax.compare(study, runs=900, seed=2))


class Stopped(Exception):
    pass


def test_a_study_that_was_stopped_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    study = scalar(particles=20, optimum_runs=512)
    monkeypatch.setattr("sigmax.studies.comparing._STORED_EVERY", 0.0)
    told = []

    def stop(what, done, of):
        told.append((what, done))
        if what == "runs" and done >= 1024:
            raise Stopped

    with pytest.raises(Stopped):
        sigmax.compare(study, runs=2000, workers=1, folder=tmp_path, report=stop)
    resumed = []
    went_on = sigmax.compare(
        study, runs=2000, workers=2, folder=tmp_path, report=lambda what, done, of: resumed.append((what, done))
    )
    assert next(done for what, done in resumed if what == "runs") >= 1024
    whole = sigmax.compare(study, runs=2000)
    assert same(went_on, whole)
    assert np.array_equal(went_on.optimum.measures.rmse.value, whole.optimum.measures.rmse.value)
    np.testing.assert_array_equal(went_on.bound, whole.bound)
    # Fewer runs of it are made anew, and so is the optimum of fewer of them.
    assert same(sigmax.compare(study, runs=300, folder=tmp_path), sigmax.compare(study, runs=300))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A study that is done, what it found, and the sums that it left."""
    study, folder = scalar(particles=8, optimum_runs=64), tmp_path_factory.mktemp("finished")
    found = sigmax.compare(study, runs=512, folder=folder)
    return study, found, (folder / "sums.npz").read_bytes()


def rewritten(content, change):
    """An archive with one of its arrays changed."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    change(arrays)
    into = io.BytesIO()
    np.savez(into, **arrays)
    return into.getvalue()


def wrong(name, value):
    return lambda arrays: arrays.update({name: value})


DAMAGES = {
    "text": lambda content: b"no",
    "nothing": lambda content: b"",
    "zeros": lambda content: bytes(len(content)),
    "cut short": lambda content: content[: len(content) // 2],
    "its end is lost": lambda content: content[:-30],
    "a byte has turned": lambda content: content[:5000] + bytes([content[5000] ^ 255]) + content[5001:],
    "an array is lost": lambda content: rewritten(content, lambda arrays: arrays.pop("all/EKF/ee")),
    "a filter is lost": lambda content: rewritten(
        content, lambda arrays: [arrays.pop(k) for k in list(arrays) if k.startswith("all/EKF/")]
    ),
    "another shape": lambda content: rewritten(content, wrong("all/EKF/ee", np.zeros((3, 2, 2)))),
    "another type": lambda content: rewritten(content, wrong("all/EKF/e", np.array(["a"] * 6)[:, None])),
    "other runs": lambda content: rewritten(content, wrong("all/EKF/runs", np.array(300))),
    "an object": lambda content: rewritten(content, wrong("all/EKF/runs", np.array([{}], object))),
    "about is no JSON": lambda content: rewritten(content, wrong("about", np.array("{"))),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_sums_are_told_and_made_anew(finished, damage, tmp_path):
    study, found, content = finished
    (tmp_path / "sums.npz").write_bytes(DAMAGES[damage](content))
    again = sigmax.compare(study, runs=512, folder=tmp_path)
    assert same(again, found)
    assert len(again.notes) == 1
    assert "begins anew" in again.notes[0]
    assert "sums.npz" in again.notes[0]
    # What is left behind is sound again.
    assert sigmax.compare(study, runs=512, folder=tmp_path).notes == ()


def test_sums_of_another_study_are_told_and_not_used(finished, tmp_path):
    study, found, content = finished
    assert found.notes == ()
    others = (
        (scalar(prior=sigmax.Gaussian([1.0], [[0.6]])), {}),
        (study, {"seed": 2}),
        (study, {"particles": 9}),
        (study, {"filters": ["EKF"]}),
    )
    for other, more in others:
        (tmp_path / "sums.npz").write_bytes(content)
        new = sigmax.compare(other, runs=256, folder=tmp_path, **more)
        assert "another study" in new.notes[0]
        assert same(new, sigmax.compare(other, runs=256, **more))


def test_a_study_is_stored_every_few_seconds_whatever_it_is_doing(tmp_path, monkeypatch):
    """Also while the optimum is sought, which takes longest: a stop at any report finds all that was reported."""
    monkeypatch.setattr("sigmax.studies.comparing._STORED_EVERY", 0.0)
    monkeypatch.setattr("sigmax.studies.study._PARTICLES", 1000)
    study = scalar(particles=20, optimum_runs=96)
    assert study.piece(20) == 8
    for stop_at in (1, 3, 5):
        reports = []

        def stop(what, done, of, reports=reports, stop_at=stop_at):
            reports.append((what, done, of))
            if what == "optimum" and sum(w == "optimum" for w, *_ in reports) == stop_at:
                raise Stopped

        with pytest.raises(Stopped):
            sigmax.compare(study, ["EKF"], runs=256, workers=1, folder=tmp_path / str(stop_at), report=stop)
        resumed = []
        sigmax.compare(
            study,
            ["EKF"],
            runs=256,
            workers=1,
            folder=tmp_path / str(stop_at),
            report=lambda what, done, of, resumed=resumed: resumed.append((what, done)),
        )
        assert [done for what, done in resumed if what == "optimum"] == [8 * k for k in range(stop_at + 1, 13)]
        assert [done for what, done in resumed if what == "runs"] == [256]


def test_truth_and_measurements_are_drawn_as_the_study_says():
    study = linear(detection=0.3, steps=40)
    drawn = draw(study, 1, 0)
    assert 0.26 < (~np.isnan(drawn.z[""])).mean() < 0.34
    step = drawn.truth[:, 1:] - drawn.truth[:, :-1] @ F.T
    np.testing.assert_allclose(np.cov(step.reshape(-1, 2).T), Q, atol=0.003)
    np.testing.assert_allclose(np.cov(drawn.start.T), P0, atol=0.35)
    seen = (drawn.z[""] - drawn.truth[..., :1])[~np.isnan(drawn.z[""])]
    assert abs(seen.var() - R) < 0.03
    fixed = linear(start=[1.0, 2.0], nature=sigmax.studies.undisturbed(study.model), estimate="drawn", steps=3)
    drawn = draw(fixed, 1, 0)
    np.testing.assert_allclose(drawn.truth, np.broadcast_to([[3.0, 2.0], [5.0, 2.0], [7.0, 2.0]], drawn.truth.shape))
    np.testing.assert_allclose(np.cov((drawn.mean - [1.0, 2.0]).T), P0, atol=0.35)
    assert not fixed.fair


def test_what_cannot_be_run_is_a_row_and_no_crash():
    def failing(x, u=None):
        raise RuntimeError("there is no such sensor")

    study = scalar(filters={"EKF": sigmax.get("EKF"), "KF": sigmax.get("KF")})
    c = sigmax.compare(study, runs=10)
    assert list(c.measures) == ["EKF"]
    assert "linear" in c.failures["KF"]
    alone = sigmax.compare(scalar(filters={"KF": sigmax.get("KF")}), runs=10)
    assert alone.measures == {}
    assert alone.sums == {}


def test_runs_of_which_the_truth_escapes_are_counted_and_left_out():
    def blows(x, dt):
        return x + 0.5 * x**2

    model = sigmax.Model(motion=blows, sensor=lambda x: x, Q=[0.01], R=[0.1])
    study = sigmax.studies.Study(
        name="blows", model=model, prior=sigmax.Gaussian([-0.5], [[0.3]]), steps=15, reach=[100.0]
    )
    c = sigmax.compare(study, ["EKF", "PF"], runs=256, particles=20)
    assert 0 < c.escaped < 200
    assert c.measures["EKF"].runs == 256 - c.escaped
    assert np.isfinite(c.measures["EKF"].rmse.value).all()


def test_the_wrong_study_is_refused_in_words():
    with pytest.raises(InputError, match="steps = 0"):
        linear(steps=0)
    with pytest.raises(InputError, match="estimate"):
        linear(estimate="drown")
    with pytest.raises(InputError, match=r"start must have the shape \(2,\)"):
        linear(start=[1.0])
    with pytest.raises(InputError, match="look has the step 99"):
        linear(look=(99,))
    with pytest.raises(InputError, match=r"detection of the sensor is 1\.5"):
        linear(detection=1.5)
    with pytest.raises(InputError, match="use at most 187500 steps"):
        sigmax.compare(linear(steps=10_000_000), runs=10)
    with pytest.raises(InputError, match="runs must be a whole number of at least 2; it is 1"):
        sigmax.compare(linear(), runs=1)
    with pytest.raises(InputError, match="no filter is optimal"):
        sigmax.compare(linear(start=[1.0, 0.0]), runs=10, particles=100)
    with pytest.raises(InputError, match="names no filters"):
        sigmax.compare(linear(filters={}), runs=10)
    with pytest.raises(InputError, match="unknown filter 'EKFF'"):
        sigmax.compare(linear(), ["EKFF"], runs=10)


def test_largest_errors_are_those_of_the_runs_whatever_the_blocks():
    """By hand over the drawn runs of two blocks; and where an estimate is no number, nothing is larger."""
    study = linear(runs=300)
    c = sigmax.compare(study, runs=300)
    worst = np.zeros((study.steps, 2))
    for block in (0, 1):
        drawn = draw(study, 1, block)
        runs = 256 if block == 0 else 300 - 256
        work = Work(study, dict(study.filters), yardsticks(study, None), 1, False, None)
        name = next(iter(study.filters))
        off = np.abs(estimate(work, name, drawn).mean - drawn.truth)[:runs]
        worst = np.maximum(worst, off.max(0))
    np.testing.assert_allclose(c.measures[name].largest, worst, rtol=1e-12)
    none = claims_of(np.full((1, 2, 1), np.nan), np.ones((1, 2, 1, 1)), np.zeros((1, 2, 1)), scalar().model.space)
    assert np.isinf(none.largest).all()


def test_a_run_that_is_shown_is_the_run_among_the_others():
    """Truth and measurements are those of its place in its block; estimates those of the whole block."""
    study = linear(runs=300)
    c = sigmax.compare(study, runs=300, show=[2, 290])
    assert [one.run for one in c.shown] == [2, 290]
    work = Work(study, dict(study.filters), c.by, 1, False, None)
    for one, block, at in zip(c.shown, (0, 1), (1, 290 - 257), strict=True):
        drawn = draw(study, 1, block)
        np.testing.assert_array_equal(one.truth, drawn.truth[at])
        np.testing.assert_array_equal(one.z[""], drawn.z[""][at])
        for name in study.filters:
            found = estimate(work, name, drawn)
            np.testing.assert_allclose(one.mean[name], found.mean[at], rtol=1e-10)
            np.testing.assert_allclose(
                one.std[name] ** 2, np.diagonal(found.factor[at] @ found.factor[at].swapaxes(-1, -2), 0, 1, 2)
            )
    for wrong in (0, 301, True):
        with pytest.raises(InputError, match="show names runs from 1 to 300"):
            sigmax.compare(study, runs=300, show=[wrong])
