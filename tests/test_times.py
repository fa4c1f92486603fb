"""Times of measurements, in every form in which people have them."""

import pickle
from datetime import UTC, datetime, timedelta

import jax
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import sigmax

STEPS = np.array([0.0, 0.5, 0.25, 2.0, 86400.0, 1e-6])
SECONDS = np.cumsum(STEPS) + 3.0
EPOCH = np.datetime64("2024-02-28T23:59:58.123456")
INSTANTS = EPOCH + np.round(SECONDS * 1e9).astype("timedelta64[ns]")
FRAME = pd.DatetimeIndex(INSTANTS)
BERLIN = FRAME.tz_localize("UTC").tz_convert("Europe/Berlin")
FORMS = {
    "datetime64[ns]": INSTANTS,
    "datetime64[us]": INSTANTS.astype("datetime64[us]"),
    "index": FRAME,
    "index in Berlin": BERLIN,
    "series": pd.Series(FRAME),
    "series in Berlin": pd.Series(BERLIN),
    "timestamps": list(BERLIN),
    "datetimes": FRAME.to_pydatetime().tolist(),
    "datetimes in Tokyo": [t.to_pydatetime() for t in BERLIN.tz_convert("Asia/Tokyo")],
    "polars": pl.Series(INSTANTS),
    "polars in Berlin": pl.Series(INSTANTS).dt.replace_time_zone("UTC").dt.convert_time_zone("Europe/Berlin"),
    "arrow": pa.array(INSTANTS),
    "arrow in Berlin": pa.array(INSTANTS).cast(pa.timestamp("ns", tz="Europe/Berlin")),
    "column of arrow": pa.table({"t": INSTANTS})["t"],
}
AS_SECONDS = {
    "array": SECONDS,
    "list": SECONDS.tolist(),
    "series": pd.Series(SECONDS),
    "polars": pl.Series(SECONDS),
    "arrow": pa.array(SECONDS),
    "timedelta64": np.round(SECONDS * 1e9).astype("timedelta64[ns]"),
    "timedeltas": [timedelta(seconds=s) for s in SECONDS],
    "index of timedeltas": pd.to_timedelta(SECONDS, unit="s"),
}


@pytest.fixture(scope="module")
def case():
    s = sigmax.builtin("position-cv")
    z = np.random.default_rng(0).normal(size=(len(STEPS), 2)) * 5
    return s.model, s.prior, z


@pytest.mark.parametrize("form", FORMS)
def test_instants_of_any_kind_are_the_same(case, form):
    r = sigmax.run("KF", *case, t=FORMS[form], update_first=True)
    assert r.time.dtype == "datetime64[ns]"
    np.testing.assert_array_equal(r.time, INSTANTS)
    np.testing.assert_allclose(r.dt, STEPS, rtol=0, atol=1e-9)
    np.testing.assert_allclose(r.mean, sigmax.run("KF", *case, dt=STEPS, update_first=True).mean, atol=1e-6)


@pytest.mark.parametrize("form", AS_SECONDS)
def test_seconds_of_any_kind_are_the_same(case, form):
    r = sigmax.run("KF", *case, t=AS_SECONDS[form], t0=2.0)
    np.testing.assert_allclose(r.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_allclose(r.dt, [1.0, *STEPS[1:]], atol=1e-9)
    back = sigmax.smooth("KF", case[0], r, t=AS_SECONDS[form])
    np.testing.assert_array_equal(back.time, r.time)
    np.testing.assert_array_equal(back.mean, sigmax.smooth("KF", case[0], r).mean)


def test_the_prior_may_stand_before_the_first_measurement(case):
    for t0 in (EPOCH, BERLIN[0] - pd.Timedelta(seconds=3), datetime(2024, 2, 28, 23, 59, 58, 123456, UTC)):
        r = sigmax.run("KF", *case, t=FORMS["index in Berlin"], t0=t0)
        np.testing.assert_allclose(r.dt, [3.0, *STEPS[1:]], atol=1e-9)
        np.testing.assert_array_equal(r.time, INSTANTS)


def test_times_by_steps_begin_where_the_prior_stands(case):
    assert (sigmax.run("KF", *case, dt=2.0, t0=EPOCH).time == EPOCH + np.arange(1, 7) * np.timedelta64(2, "s")).all()
    assert (sigmax.run("KF", *case, dt=2.0, t0=10).time == 12.0 + 2 * np.arange(6)).all()
    assert (sigmax.run("KF", *case, dt=2.0).time == 2.0 + 2 * np.arange(6)).all()
    assert (sigmax.run("KF", *case, dt=2.0, update_first=True).time == 2.0 * np.arange(6)).all()


def test_tracks_may_have_times_of_their_own(case):
    model, prior, z = case
    t = SECONDS + np.array([[0.0], [7.0]])
    r = sigmax.run("KF", model, prior, np.stack([z, z]), t=t, t0=[0.0, 1.0])
    np.testing.assert_array_equal(r.time, t)
    np.testing.assert_allclose(r.dt[:, 0], [3.0, 9.0])
    for k in range(2):
        alone = sigmax.run("KF", model, prior, z, t=t[k], t0=float(k))
        np.testing.assert_allclose(r.mean[k], alone.mean, rtol=1e-12)
    one = sigmax.run("KF", model, prior, np.stack([z, z]), t=INSTANTS, update_first=True)
    assert one.time.shape == (2, 6)
    assert (one.time == INSTANTS).all()


@pytest.mark.slow
def test_times_that_are_traced_differentiate(case):
    model, prior, z = case

    def likelihood(shift):
        return sigmax.run("KF", model, prior, z, t=SECONDS + shift, t0=0.0).log_likelihood

    def by_steps(shift):
        return sigmax.run(
            "KF", model, prior, z, dt=jax.numpy.asarray([3.0, *STEPS[1:]]).at[0].add(shift)
        ).log_likelihood

    assert jax.grad(likelihood)(0.1) == pytest.approx(float(jax.grad(by_steps)(0.1)), rel=1e-6)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"t": SECONDS}, "say when the prior stands"),
        ({"t": SECONDS, "t0": 0.0, "update_first": True}, "leave t0 out"),
        ({"t": SECONDS, "t0": EPOCH}, "must be of one kind"),
        ({"t": SECONDS, "dt": 1.0, "t0": 0.0}, "give one of them"),
        ({"t": SECONDS[:4], "t0": 0.0}, "one time for each of the 6 steps"),
        ({"t": SECONDS[::-1], "update_first": True}, "time runs backwards at step 1"),
        ({"t": SECONDS, "t0": 4.0}, "time runs backwards at step 0"),
        ({"t": [*SECONDS[:5], np.nan], "t0": 0.0}, "t must be finite"),
        ({"t": pd.DatetimeIndex([*INSTANTS[:5], pd.NaT]), "update_first": True}, r"at \[5\] it is missing"),
        ({"t": ["a"] * 6, "t0": 0.0}, "t must be seconds or instants"),
        ({"t": "2024-05-01", "t0": 0.0}, "the text '2024-05-01'"),
        ({"t": [True] * 6, "t0": 0.0}, "t must be seconds or instants"),
        ({"t": np.array(["1500-01-01"] * 6, "datetime64[s]"), "update_first": True}, "1678 and 2262"),
        ({"t0": [1.0, 2.0]}, "one for each track"),
    ],
)
def test_what_is_no_time_is_refused_in_words(case, given, said):
    with pytest.raises(sigmax.InputError, match=said):
        sigmax.run("KF", *case, **given)


TABLE = np.array([[1.0, 2.0], [3.0, np.nan], [np.nan, np.nan], [4.0, 5.0], [0.0, 1.0], [2.0, 2.0]])
ROWS = [[None if np.isnan(v) else v for v in row] for row in TABLE]
BACK = [[b, a] for a, b in ROWS]
TABLES = {
    "lists": ROWS,
    "masked": np.ma.masked_invalid(TABLE),
    "masked rows": [np.ma.masked_invalid(row) for row in TABLE],
    "frame": pd.DataFrame(TABLE),
    "frame, the other way round": pd.DataFrame(TABLE[:, ::-1], columns=["y", "x"]),
    "frame of Int64": pd.DataFrame(ROWS, columns=["x", "y"]).astype("Int64"),
    "frame of arrow": pd.DataFrame(ROWS, columns=["x", "y"]).astype("double[pyarrow]"),
    "polars": pl.DataFrame(ROWS, ["x", "y"], orient="row"),
    "polars, the other way round": pl.DataFrame(BACK, ["y", "x"], orient="row"),
    "polars of integers": pl.DataFrame(ROWS, {"x": pl.Int64, "y": pl.Int16}, orient="row", strict=False),
    "arrow": pa.table({"x": [r[0] for r in ROWS], "y": [r[1] for r in ROWS]}),
    "arrow, the other way round": pa.table({"y": [r[1] for r in ROWS], "x": [r[0] for r in ROWS]}),
    "arrow of integers": pa.table({n: pa.array([r[k] for r in ROWS], pa.int32()) for k, n in enumerate("xy")}),
    "batch of arrow": pa.RecordBatch.from_pydict({"x": [r[0] for r in ROWS], "y": [r[1] for r in ROWS]}),
}


@pytest.mark.parametrize("form", TABLES)
def test_measurements_come_as_tables_of_any_kind(case, form):
    model, prior, _ = case
    np.testing.assert_array_equal(sigmax.run("KF", model, prior, TABLES[form]).dof, [2, 1, 0, 2, 2, 2])
    r = sigmax.run("KF", model, prior, TABLES[form])
    np.testing.assert_array_equal(r.mean, sigmax.run("KF", model, prior, TABLE).mean)


def test_a_live_filter_takes_columns_row_by_row(case):
    model, prior, _ = case
    live = sigmax.Live("KF", model, prior)
    for row in (pd.Series({"y": 2.0, "x": 1.0}), [3.0, None], np.ma.masked_invalid(TABLE[2]), pa.array([4.0, 5.0])):
        live.step(row, 1.0)
    assert live.mean == pytest.approx(sigmax.run("KF", model, prior, TABLE[:4]).mean[-1], rel=1e-12)


def test_a_live_filter_counts_from_an_instant(case):
    """As the run, whatever form an instant has; pickled, saved and asked for another time it stays with its kind."""
    model, prior, z = case
    r = sigmax.run("KF", model, prior, z, t=INSTANTS, t0=EPOCH)
    live = sigmax.Live("KF", model, prior, time=BERLIN[0] - pd.Timedelta(seconds=3), window=1e6, lag=1.0)
    for k in (0, 2, 1, 3, 5, 4):
        live.update(z[k], time=FORMS["datetimes in Tokyo" if k % 2 else "timestamps"][k])
    assert live.time == INSTANTS[5].astype("datetime64[us]")
    assert live.counts == {"taken": 4, "late": 2}
    np.testing.assert_allclose(live.mean, r.mean[-1], rtol=1e-6)
    then = live.at(INSTANTS[2])
    assert then.time == INSTANTS[2]
    np.testing.assert_allclose(then.to_frame().loc[INSTANTS[2], list(model.state)], r.mean[2], rtol=1e-6)
    assert live.lagged.to_xarray().time.values[0] == live.lagged.time == INSTANTS[3]
    again = pickle.loads(pickle.dumps(live))
    other = sigmax.Live("KF", model, prior, time=EPOCH - np.timedelta64(9, "D"), window=1e6, lag=1.0)
    other.restore(live.save())
    for one in (again, other):
        one.step(z[0], 0.5)
        assert one.time == live.time + np.timedelta64(500, "ms")
    with pytest.raises(sigmax.InputError, match="counts time in instants, this filter in seconds"):
        sigmax.Live("KF", model, prior, window=1e6, lag=1.0).restore(live.save())
    with pytest.raises(sigmax.InputError, match="time must be one instant"):
        live.update(z[0], time=3.0)


@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("tracks", [None, 2])
def test_a_live_filter_says_what_it_is(case, backend, tracks):
    model, prior, z = case
    start = prior if tracks is None else sigmax.Gaussian(np.tile(prior.mean, (tracks, 1)), prior.cov)
    live = sigmax.Live("KF", model, start, backend=backend)
    assert live.engine == backend
    live.step(z[0] if tracks is None else np.tile(z[0], (tracks, 1)), 2.0)
    shown = repr(live).splitlines()
    assert shown[0] == f"Live KF, {backend} engine"
    said = dict(line.split(maxsplit=1) for line in shown[1:])
    assert said["time"] == "2 s"
    mean, std = np.atleast_2d(live.mean)[0], np.atleast_2d(live.std)[0]
    for i, name in enumerate(model.state):
        value, _, deviation, unit = said[name].split()
        assert float(value) == pytest.approx(mean[i], abs=0.06 * std[i])
        assert float(deviation) == pytest.approx(std[i], rel=0.06)
        assert unit == ("m" if i < 2 else "m/s")
    assert live.at(2.0).to_frame()["vx_std"].to_numpy() == pytest.approx(np.full(tracks or 1, std[2]))
