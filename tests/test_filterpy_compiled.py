"""Filters of FilterPy's names with the user's functions compiled in them: the same numbers, and never of yesterday."""

import copy
import math
import pickle
from dataclasses import dataclass, field

import numpy as np
import pytest

from sigmax import filterpy as ours
from sigmax.filterpy.compiled_calls import CompiledCall
from sigmax.native.calls import extension

pytestmark = pytest.mark.skipif(extension() is None, reason="there is no compiler or no Python.h")
SCALE, MATRIX = 0.5, np.array([[1.0, 0.1], [0.0, 1.0]])
Z = np.random.default_rng(2).normal(size=(6, 1)) + 2.0


def helper(x):
    return SCALE * np.hypot(x[0], 2.0)


def fx(x, dt):
    y = np.zeros(2)
    y[:] = MATRIX @ x
    y[1] += 0.1 * dt * math.sin(x[0])
    return y


def hx(x):
    return np.array([helper(x)])


@dataclass
class Sensor:
    scale: float = 0.5
    shift: np.ndarray = field(default_factory=lambda: np.zeros(1))

    def see(self, x):
        return self.scale * np.hypot(x[:1], 2.0) + self.shift


def unscented(motion=fx, sensor=hx, **hooks):
    k = ours.UnscentedKalmanFilter(2, 1, 0.5, sensor, motion, ours.MerweScaledSigmaPoints(2, 0.7, 2.0, 0.5), **hooks)
    k.x, k.P, k.Q, k.R = np.array([1.0, 0.3]), np.diag([0.4, 0.2]), np.eye(2) * 0.01, 0.1
    return k


def extended():
    k = ours.ExtendedKalmanFilter(2, 1)
    k.x, k.P, k.Q, k.R, k.F = np.array([[1.0], [0.3]]), np.diag([0.4, 0.2]), np.eye(2) * 0.01, 0.1, MATRIX.copy()
    return k


def stepped(k, zs=Z, **given):
    for z in zs:
        k.predict()
        if isinstance(k, ours.ExtendedKalmanFilter):
            k.update(
                z, lambda x: np.array([[SCALE * x[0, 0] / np.hypot(x[0, 0], 2.0), 0.0]]), lambda x: helper(x[:, 0])
            )
        else:
            k.update(z, **given)
    return k


NAMES = ["x", "P", "y", "K", "S", "x_prior", "P_prior", "x_post", "P_post", "z", "log_likelihood", "mahalanobis"]


def same(a, b):
    for name in NAMES:
        one, other = np.asarray(getattr(a, name)), np.asarray(getattr(b, name))
        assert one.shape == other.shape, name
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13, err_msg=name)


@pytest.fixture
def used(monkeypatch):
    """How many half-steps were compiled ones, and how many were not."""
    counts, call = [0, 0], CompiledCall.__call__

    def counted(self, *given):
        made = call(self, *given)
        counts[made is NotImplemented] += 1
        return made

    monkeypatch.setattr(CompiledCall, "__call__", counted)
    return counts


def turn(a, b):
    return np.array([(a[0] - b[0] + np.pi) % (2 * np.pi) - np.pi, a[1] - b[1]])


def circular(points, weights):
    return np.array(
        [
            math.atan2(np.dot(np.sin(points[:, 0]), weights), np.dot(np.cos(points[:, 0]), weights)),
            points[:, 1] @ weights,
        ]
    )


@pytest.mark.parametrize(
    "make",
    [unscented, extended, lambda: unscented(residual_x=turn, x_mean_fn=circular)],
    ids=["unscented", "extended", "hooks"],
)
def test_compiled_steps_are_those_of_numpy(make, used, monkeypatch):
    compiled = stepped(make())
    assert used == [2 * len(Z), 0]
    monkeypatch.setattr(CompiledCall, "__call__", lambda *given: NotImplemented)
    same(compiled, stepped(make()))


def test_whatever_a_function_reads_is_read_as_it_is_now(monkeypatch):
    sensor = Sensor()
    shift = [0.0]

    def closed(x):
        return np.array([helper(x) + shift[0]])

    def changes():
        yield lambda: None
        yield lambda: monkeypatch.setitem(globals(), "SCALE", 0.7)
        yield lambda: MATRIX.__setitem__((0, 1), 0.2)
        yield lambda: monkeypatch.setitem(globals(), "helper", lambda x: 0.4 * np.hypot(x[0], 1.0))
        yield lambda: setattr(sensor, "scale", 0.6)
        yield lambda: sensor.shift.__setitem__(0, 0.3)
        yield lambda: shift.__setitem__(0, 0.2)

    live = [unscented(), unscented(sensor=sensor.see), unscented(sensor=closed)]
    try:
        for change in changes():
            change()
            for k in live:
                fresh = unscented(k.fx, k.hx)
                fresh.x, fresh.P = k.x.copy(), k.P.copy()
                with monkeypatch.context() as plain:
                    plain.setattr(CompiledCall, "__call__", lambda *given: NotImplemented)
                    stepped(fresh, Z[:1])
                same(stepped(k, Z[:1]), fresh)
    finally:
        MATRIX[0, 1] = 0.1


def test_results_are_nobodys_but_the_filters():
    k = stepped(unscented(), Z[:1])
    before = k.x_post.copy(), k.P_prior.copy()
    k.x[0] = 99.0
    k.P *= 2
    np.testing.assert_array_equal(k.x_post, before[0])
    np.testing.assert_array_equal(k.P_prior, before[1])
    other = unscented()
    other.x, other.P = k.x.copy(), k.P.copy()
    same(stepped(k, Z[1:2]), stepped(other, Z[1:2]))


def test_weights_points_and_functions_may_be_others_at_any_time():
    k = stepped(unscented(), Z[:2])
    k.points_fn = ours.MerweScaledSigmaPoints(2, 0.9, 2.0, 0.0)
    k.Wm, k.Wc = k.points_fn.Wm, k.points_fn.Wc
    k.hx = lambda x: np.array([x[0] ** 2])
    fresh = unscented(sensor=k.hx)
    fresh.points_fn, fresh.Wm, fresh.Wc = k.points_fn, k.Wm, k.Wc
    fresh.x, fresh.P = k.x.copy(), k.P.copy()
    same(stepped(k, Z[2:]), stepped(fresh, Z[2:]))


def test_arguments_by_name_go_in_their_places(used):
    def driven(x, dt, u, gain=2.0):
        return np.array([x[0] + dt * x[1] + gain * u[0], x[1] + u[1]])

    def placed(x, beacon, scale):
        return np.array([scale * np.hypot(x[0] - beacon[0], x[1] - beacon[1])])

    k, twice = unscented(driven, placed), unscented(driven, placed)
    for z in Z:
        u, beacon = np.array([0.1, z[0]]), np.array([z[0], 1.0])
        k.predict(u=u)
        k.update(z, scale=2.0, beacon=beacon)
        twice.predict(fx=lambda x, dt, u=u: driven(x, dt, u))
        twice.update(z, hx=lambda x, b=beacon: placed(x, b, 2.0))
    same(k, twice)
    assert used[1] == 0


def test_further_arguments_of_the_cubature_filter_go_to_its_functions(used):
    k = ours.CubatureKalmanFilter(2, 1, 0.5, lambda x, a: a * x[:1], lambda x, dt, b: x + b * dt)
    k.predict(fx_args=(2.0,))
    k.update(np.array([1.0]), hx_args=(3.0,))
    other = ours.CubatureKalmanFilter(2, 1, 0.5, lambda x: 3.0 * x[:1], lambda x, dt: x + 2.0 * dt)
    other.predict()
    other.update(np.array([1.0]))
    same(k, other)
    assert used == [4, 0]


def test_a_filter_is_copied_and_pickled_with_its_functions():
    k = stepped(unscented())
    for other in (copy.deepcopy(k), pickle.loads(pickle.dumps(k))):
        same(stepped(other, Z[:1]), stepped(copy.deepcopy(k), Z[:1]))


def test_a_function_that_cannot_be_compiled_runs_as_it_is(used, caplog):
    def decides(x):
        return np.array([x[0] if x[0] > 0 else -x[0]])

    def other(x):
        return np.array([np.abs(x[0])])

    same(stepped(unscented(sensor=decides)), stepped(unscented(sensor=other)))
    assert used[1] == len(Z)
    assert "decides runs as it is, not compiled: it decides by the value" in caplog.text


def test_missing_components_and_wrong_sizes_are_as_they_were():
    k = stepped(unscented())
    x = k.x.copy()
    k.update(np.array([np.nan]))
    np.testing.assert_array_equal(k.x, x)
    assert k.z is None
    with pytest.raises(ValueError, match="z has 2 components, hx gives 1"):
        k.update(np.ones(2))
