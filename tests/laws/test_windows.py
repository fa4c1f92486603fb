"""A record smoothed in windows is the record smoothed whole."""

import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.running import smooth_in_windows


def bent(x, dt, u):
    return np.array([x[0] + dt * np.sin(x[1]), 0.9 * x[1] + dt * u[0]])


MODEL = sigmax.Model(
    motion=bent, sensor=lambda x: np.array([np.hypot(1.0, x[0])]), Q=[0.01, 0.04], R=[0.02], state=("a", "b")
)
PRIOR = sigmax.Gaussian([0.5, 0.2], [[0.3, 0.1], [0.1, 0.2]])
T, B = 23, 2


def drawn():
    rng = np.random.default_rng(2)
    z = 1.2 + 0.3 * rng.normal(size=(B, T, 1))
    z[:, 5], z[1, 11] = np.nan, np.nan
    return z, rng.normal(size=(T, 1)), rng.uniform(0.3, 1.5, size=T)


@pytest.mark.parametrize("steps", [2, 5, 11, 22, 40])
def test_windows_are_the_whole(steps):
    z, u, dt = drawn()
    for given in (
        {"dt": dt, "update_first": True},
        {"dt": dt[1:], "update_first": True, "R": np.tile([0.03], (T, 1))},
        {"t": 100 + np.cumsum(dt), "t0": 100.0},
    ):
        whole = sigmax.run("EKF", MODEL, PRIOR, z, inputs=u, **given)
        smoothed = sigmax.smooth("EKF", MODEL, whole)
        seen = []
        for window, part in smooth_in_windows("EKF", MODEL, PRIOR, z, steps=steps, inputs=u, **given):
            np.testing.assert_allclose(part.mean, smoothed.mean[:, window], rtol=1e-10, atol=1e-11)
            np.testing.assert_allclose(part.cov, smoothed.cov[:, window], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(part.time, smoothed.time[:, window], rtol=1e-12)
            assert np.array_equal(part.fault, smoothed.fault[:, window])
            seen = [window.start, *seen]
        assert seen == list(range(0, T, steps))


def test_a_file_is_read_window_by_window(tmp_path):
    z, u, dt = drawn()
    z[0, 9] = np.inf  # a step that fails
    np.save(tmp_path / "z.npy", z[0])
    file = np.load(tmp_path / "z.npy", mmap_mode="r")
    smoothed = sigmax.smooth("EKF", MODEL, sigmax.run("EKF", MODEL, PRIOR, z[0], dt=dt, inputs=u))
    found = np.zeros_like(smoothed.mean)
    for window, part in smooth_in_windows("EKF", MODEL, PRIOR, file, steps=5, dt=dt, inputs=u):
        found[window] = part.mean
    np.testing.assert_allclose(found, smoothed.mean, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize(
    ("filter", "changes", "message"),
    [
        ("EKF", {"steps": 1}, "2 or more"),
        ("EKF", {"keep": ("mean",)}, "leave keep= out"),
        (sigmax.get("EKF", update="adaptive"), {}, "finds noises"),
        (sigmax.get("EKF", consider="a"), {}, "considers a"),
    ],
)
def test_what_windows_do_not_know_is_a_message(filter, changes, message):
    z, u, dt = drawn()
    named = sigmax.Model(
        motion=bent, sensor=MODEL.sensors[""], Q=[0.01, 0.04], R=[0.02], state=("a", "b"), measurement=("r",)
    )
    with pytest.raises(InputError, match=message):
        next(smooth_in_windows(filter, named, PRIOR, z, dt=dt, inputs=u, **changes))
