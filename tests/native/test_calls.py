"""Live steps called through the extension in C and without it: the same bits, the same errors, nothing leaked."""

import gc
import threading
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

import sigmax
from sigmax import InputError
from sigmax.native import calls
from tests.native.test_engine import record


@pytest.fixture(scope="module")
def radar():
    return record("radar-ct", tracks=1, steps=20)


@pytest.fixture
def in_python(monkeypatch):
    """What makes calls ready as on a machine without the headers of Python."""

    def switch():
        monkeypatch.setattr(calls, "extension", lambda: None)

    return switch


def live(radar, dtype="float64"):
    made, z, _ = radar
    return sigmax.Live("SRCKFB", made.model, made.prior, dtype=dtype, backend="native"), z[0], made.dt


def told(live, z, dt):
    """Everything that can be read, of a whole step, two halves and a step with a noise of its own."""
    every = []
    for t, row in enumerate(z):
        if t % 3 == 0:
            live.predict(dt)
            innovation = live.update(row)
        elif t % 3 == 1:
            innovation = live.step(row, dt, R=[3000.0, 1e-7, 1e-3])
        else:
            innovation = live.step(row, dt)
        every += [*innovation, live.mean, live.cov, live.std, np.asarray(live.ok), np.asarray(int(live.fault))]
        assert [type(part) for part in innovation[:2]] == [np.ndarray] * 2
        assert [np.asarray(part).shape for part in innovation] == [(3,), (3, 3), (), (), ()]
        assert innovation.dof.dtype == np.int64
        assert innovation.nis.dtype == innovation.log_likelihood.dtype == live.mean.dtype
    return every


def test_a_compiler_with_the_headers_of_python_makes_the_extension():
    assert calls.extension() is not None


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_extension_changes_no_bit(radar, dtype, in_python):
    made, z, _ = radar
    z = z.copy()
    z[0, 4], z[0, 5, 1] = np.nan, np.nan
    found = told(*live((made, z, None), dtype))
    in_python()
    wanted = told(*live((made, z, None), dtype))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found, wanted, strict=True))


def test_a_measurement_may_come_in_any_dress(radar, in_python):
    _, row, dt = live(radar)
    first, whole = row[0], np.round(row[0])
    wide = np.zeros((3, 2))
    wide[:, 0] = first
    alike = [first, list(first), tuple(float(x) for x in first), wide[:, 0], first.astype(">f8"), np.ma.array(first)]
    same_whole = [whole, whole.astype(int), whole.astype(np.float32), [int(x) for x in whole]]
    for dresses in (alike, same_whole):
        for switch in (lambda: None, in_python):
            switch()
            means = []
            for dress in dresses:
                tracker, *_ = live(radar)
                tracker.step(dress, np.float32(dt))
                tracker.step(dress, int(dt))
                means.append(tracker.mean)
            assert all(np.array_equal(a, b) for a, b in pairwise(means))


@pytest.mark.parametrize("extended", [True, False])
@pytest.mark.parametrize(
    ("z", "dt", "error", "message"),
    [
        ([1.0, 2.0], 1.0, InputError, r"z must have the shape \(3,\).*it has \(2,\)"),
        (np.zeros((1, 3)), 1.0, InputError, r"it has \(1, 3\)"),
        (1.0, 1.0, InputError, r"it has \(\)"),
        (["1", "two", "3"], 1.0, InputError, "z must be an array of real numbers"),
        (np.zeros(3), -1.0, InputError, "dt must be"),
        (np.zeros(3), float("nan"), InputError, "dt must be"),
        (np.zeros(3), "1", InputError, 'dt is a span of time such as "2 s"'),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(radar, z, dt, error, message, extended, in_python):
    if not extended:
        in_python()
    tracker, *_ = live(radar)
    before = tracker.save()
    with pytest.raises(error, match=message):
        tracker.step(z, dt)
    assert tracker.save() == before


def test_a_failing_step_is_told_and_leaves_the_state(radar):
    tracker, z, dt = live(radar)
    before = tracker.mean
    told = tracker.step([np.inf, 0.0, 0.0], 0.0)
    assert not tracker.ok
    assert tracker.fault == sigmax.running.Fault.SENSOR_NOT_FINITE
    assert np.isnan(told.nis)
    tracker.restore(live(radar)[0].save())
    assert np.array_equal(tracker.mean, before)
    tracker.step(z[0], dt)
    assert tracker.ok


def test_several_sensors_and_inputs_go_through_it_too(in_python):
    def made():
        model = sigmax.Model(
            motion=lambda x, dt, u: x + dt * u,
            sensor={"both": lambda x: x, "one": lambda x: x[:1] ** 2},
            Q=[0.1, 0.1],
            R={"both": [0.5, 0.5], "one": [0.2]},
            state=("x", "y"),
            measurement={"both": ("x", "y"), "one": ("s",)},
        )
        tracker = sigmax.Live("SREKFB", model, sigmax.Gaussian([1.0, 1.0], np.eye(2)), backend="native")
        means = []
        for u in (0.1, 0.2):
            tracker.step([1.1, 0.9], 1.0, "both", u=[u, 0.0])
            tracker.step(np.array([1.3]), 0.5, "one", u=np.array([u, 1]))
            means.append(tracker.mean)
            with pytest.raises(InputError, match="inputs"):
                tracker.step([1.1, 0.9], 1.0, "both")
            with pytest.raises(InputError, match="say which sensor"):
                tracker.step([1.1, 0.9], 1.0, u=[u, 0.0])
        return means

    found = made()
    in_python()
    assert np.array_equal(found, made())


@pytest.mark.slow
def test_nothing_leaks(radar):
    tracker, z, dt = live(radar)

    def steps(count):
        for _ in range(count):
            tracker.step(z[0], 0.0)
        for _ in range(count // 200):
            assert len(tracker.cov) == 5
            with pytest.raises(InputError):
                tracker.step([0.0], dt)

    def trackers(count):
        for _ in range(count):
            live(radar)[0].step(z[1], dt)

    def grown(work, count):
        work(400)
        gc.collect()
        before, _ = tracemalloc.get_traced_memory()
        work(count)
        gc.collect()
        return tracemalloc.get_traced_memory()[0] - before

    tracemalloc.start()
    try:
        # One object lost in every step would be some megabytes, one array in every tracker 100 kB.
        assert grown(steps, 100_000) < 5000
        assert grown(trackers, 1000) < 60_000
    finally:
        tracemalloc.stop()


def test_threads_with_a_tracker_each_do_not_disturb_each_other(radar):
    def run(found, key):
        tracker, z, dt = live(radar)
        for row in np.concatenate([z] * 20):
            tracker.step(row, dt)
        found[key] = tracker.mean

    means = {}
    threads = [threading.Thread(target=run, args=(means, k)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    run(means, "alone")
    assert all(np.array_equal(means[k], means["alone"]) for k in range(4))


@pytest.mark.parametrize("reason", ["no headers", "the compiler fails"])
def test_where_it_cannot_be_made_calls_go_without_it(radar, reason, monkeypatch, tmp_path):
    wanted, z, dt = live(radar)
    wanted.step(z[0], dt)
    if reason == "no headers":
        monkeypatch.setattr(calls.sysconfig, "get_path", lambda name: str(tmp_path))
    else:
        (tmp_path / "broken.c").write_text("#error no\n")
        monkeypatch.setattr(calls, "_SOURCE", tmp_path / "broken.c")
    calls.extension.cache_clear()
    try:
        assert calls.extension() is None
        tracker, *_ = live(radar)
        tracker.step(z[0], dt)
        assert np.array_equal(tracker.cov, wanted.cov)
    finally:
        monkeypatch.undo()
        calls.extension.cache_clear()
