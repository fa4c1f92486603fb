"""Constraints: exact moments of what is cut off (SciPy), the limit of a measurement without noise, every form alike."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

import sigmax
from sigmax.errors import InputError
from sigmax.steps.constraining import truncated

INF = np.inf


@pytest.mark.parametrize("seed", range(3))
def test_moments_of_what_is_cut_off_are_exact(seed):
    """Against SciPy's truncated normal, and by quadrature where that loses its digits far out in a tail."""
    rng = np.random.default_rng(seed)
    low = rng.normal(size=40) * 10 ** rng.uniform(-2, 1.5, 40)
    high = low + 10 ** rng.uniform(-4, 2, 40)
    low[::7], high[3::7] = -INF, INF
    mean, variance = map(np.asarray, truncated(jnp.asarray(low), jnp.asarray(high)))
    for a, b, m, v in zip(low, high, mean, variance, strict=True):
        mode = np.clip(0, a, b)
        ends = (max(a, mode - 12), min(b, mode + 12))

        def density(t, mode=mode):
            return np.exp(-(t - mode) * (t + mode) / 2)

        def moment(power, about, ends=ends, density=density, mode=mode):
            near = sorted({*ends, *(p for p in mode + np.array([-3, -1, -0.1, 0, 0.1, 1, 3]) if ends[0] < p < ends[1])})
            return sum(
                integrate.quad(lambda t: (t - about) ** power * density(t), *part, epsabs=0, epsrel=1e-12)[0]
                for part in pairwise(near)
            )

        whole = moment(0, 0)
        exact = mode + moment(1, mode) / whole
        np.testing.assert_allclose(m, exact, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(v, moment(2, exact) / whole, rtol=1e-8)
        if abs(mode) < 5 and b - a > 1e-2:
            np.testing.assert_allclose([m, v], stats.truncnorm.stats(a, b), rtol=1e-6, atol=1e-12)


MEAN = np.array([0.3, -0.5, 1.0])
P = np.array([[2.0, 0.6, 0.2], [0.6, 1.0, -0.3], [0.2, -0.3, 0.8]])
PRIOR = sigmax.Gaussian(MEAN, P)
A = np.array([[1.0, -1.0, 0.5]])


def resting(**changes):
    given = dict(motion=lambda x, dt: x, sensor=lambda x: x[:1], Q=np.zeros(3), R=[0.5], state=("a", "b", "c"))
    return sigmax.Model(**given | changes)


NOTHING = np.full((1, 1), np.nan)
FORMS = ["EKF", "SRCKF", "SRUKFB", "EIF", "SRCIF", "TSCKF"]
LINE = sigmax.constrain(resting(), lambda x: (jnp.asarray(A) @ x)[0], low=1.0, high=2.5)
VALUE = sigmax.constrain(resting(), lambda x: jnp.stack([x[0] + x[1], x[2] - x[1]]), equal=[1.5, 0.25])


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.one_in(3)
def test_a_linear_bound_gives_the_exact_moments_in_every_form(name):
    s = np.sqrt(A @ P @ A.T)[0, 0]
    y = (A @ MEAN)[0]
    m, v = stats.truncnorm.stats((1 - y) / s, (2.5 - y) / s)
    C = (P @ A.T)[:, 0] / s
    result = sigmax.run(name, LINE, PRIOR, NOTHING)
    assert result.ok.all()
    np.testing.assert_allclose(result.mean[0], MEAN + C * m, rtol=1e-9)
    np.testing.assert_allclose(result.cov[0], P - (1 - v) * np.outer(C, C), rtol=1e-9, atol=1e-9)
    free = sigmax.run(name, resting(), PRIOR, NOTHING)
    after = sigmax.constrained(name, LINE, free)
    np.testing.assert_allclose(after.mean, result.mean, rtol=1e-12)
    np.testing.assert_allclose(after.cov, result.cov, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.one_in(3)
def test_a_value_is_the_limit_of_a_precise_measurement(name):
    G = np.array([[1.0, 1, 0], [0, -1, 1]])
    K = P @ G.T @ np.linalg.inv(G @ P @ G.T)
    result = sigmax.run(name, VALUE, PRIOR, NOTHING)
    assert result.ok.all()
    np.testing.assert_allclose(result.mean[0], MEAN + K @ (np.array([1.5, 0.25]) - G @ MEAN), rtol=1e-9)
    np.testing.assert_allclose(result.cov[0], P - K @ G @ P, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(G @ result.mean[0], [1.5, 0.25], rtol=1e-12)
    pseudo = resting(sensor=lambda x: jnp.asarray(G) @ x, R=[1e-12, 1e-12])
    near = sigmax.run(name, pseudo, PRIOR, [[1.5, 0.25]])
    np.testing.assert_allclose(result.mean, near.mean, rtol=1e-9)


def moving(**changes):
    flight = sigmax.motions.constant_velocity(("x", "y"))
    return sigmax.Model(motion=flight, Q=flight.noise(0.3), sensor=lambda x: x[:2], R=[1.0, 1.0], **changes)


# A road of which the direction is known: the velocity goes along it.
ROAD = sigmax.constrain(moving(), lambda x: x[3] - 0.5 * x[2], equal=0.0)
START = sigmax.Gaussian([0.0, 0.0, 1.0, 0.0], [4.0, 4.0, 2.0, 2.0])
Z = np.cumsum(np.random.default_rng(4).normal(size=(15, 2)) * 0.7 + [1.0, 0.5], 0)
Z[6] = np.nan


def by_hand():
    """The Kalman filter that measures the road without noise after each prediction, and its smoother."""
    F = np.eye(4) + np.diag([1.0, 1.0], 2)
    Q = np.asarray(moving().Q(1.0))
    H, g = np.eye(4)[:2], np.array([[0, 0, -0.5, 1.0]])
    x, C, filtered, before = START.mean, START.cov, [], []
    for z in Z:
        x, C = F @ x, F @ C @ F.T + Q
        before.append((x, C))
        for M, R, y in ((g, np.zeros((1, 1)), np.zeros(1)), (H, np.eye(2), z)):
            if not np.isnan(y).any():
                K = C @ M.T @ np.linalg.inv(M @ C @ M.T + R)
                x, C = x + K @ (y - M @ x), (np.eye(4) - K @ M) @ C
        filtered.append((x, C))
    smoothed = [filtered[-1]]
    for (x, C), (x_next, C_next) in zip(filtered[-2::-1], before[:0:-1], strict=True):
        G = C @ F.T @ np.linalg.inv(C_next)
        smoothed.append((x + G @ (smoothed[-1][0] - x_next), C + G @ (smoothed[-1][1] - C_next) @ G.T))
    return filtered, smoothed[::-1]


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
def test_in_the_recursion_it_is_one_more_measurement_of_each_step_forwards_and_backwards(backend):
    result = sigmax.run("SREKFB", ROAD, START, Z, backend=backend)
    back = sigmax.smooth("SREKFB", ROAD, result, backend=backend)
    for k, ((x, C), (xs, Cs)) in enumerate(zip(*by_hand(), strict=True)):
        np.testing.assert_allclose(result.mean[k], x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(result.cov[k], C, atol=1e-8)
        np.testing.assert_allclose(back.mean[k], xs, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(back.cov[k], Cs, atol=1e-7)


def test_live_and_batches_are_the_run():
    result = sigmax.run("SREKFB", ROAD, START, Z)
    live = sigmax.Live("SREKFB", ROAD, START)
    for z in Z:
        live.predict(1.0)
        live.update(z)
    np.testing.assert_allclose(live.mean, result.mean[-1], rtol=1e-12, atol=1e-12)
    batch = sigmax.run("SREKFB", ROAD, START, np.stack([Z[::-1], Z]))
    np.testing.assert_allclose(batch.cov[1], result.cov, rtol=1e-10, atol=1e-12)


def test_a_bound_taken_when_all_is_measured_is_the_recursion_by_hand():
    """Cut off by SciPy before each motion, two sensors after it; backwards from the estimates that were cut off."""
    q, noises = 0.05, {"one": 0.4, "two": 1.0}
    free = sigmax.Model(
        motion=lambda x, dt: 0.9 * x,
        sensor={name: lambda x: x for name in noises},
        Q=[q],
        R={name: [r] for name, r in noises.items()},
        state=("level",),
    )
    model = sigmax.constrain(free, lambda x: x[0], low=0.0, high=1.5, when="measured")
    rng = np.random.default_rng(3)
    z = {name: rng.normal(size=(12, 1)) * 0.6 for name in noises}
    z["two"][4] = z["one"][7] = z["two"][7] = np.nan
    prior = sigmax.Gaussian([0.2], [[0.5]])

    def cut(x, C):
        s = np.sqrt(C)
        m, v = stats.truncnorm.stats((0.0 - x) / s, (1.5 - x) / s)
        return x + s * m, C * v

    x, C, filtered, begun, ahead = 0.2, 0.5, [], [], []
    for k in range(12):
        begun.append(cut(x, C))
        x, C = 0.9 * begun[-1][0], 0.81 * begun[-1][1] + q
        ahead.append((x, C))
        for name, r in noises.items():
            if not np.isnan(y := z[name][k, 0]):
                x, C = x + C / (C + r) * (y - x), C * r / (C + r)
        filtered.append((x, C))
    result = sigmax.run("SRCKFB", model, prior, z)
    np.testing.assert_allclose(result.mean[:, 0], [x for x, _ in filtered], rtol=1e-7)
    np.testing.assert_allclose(result.cov[:, 0, 0], [C for _, C in filtered], rtol=1e-7)
    live = sigmax.Live("SRCKFB", model, prior)
    for k in range(12):
        live.predict(1.0)
        for name in noises:
            live.update(z[name][k], name)
    assert np.array_equal(live.mean, result.mean[-1])
    smoothed = sigmax.smooth("SRCKFB", model, result)
    xs, Cs = filtered[-1]
    for k in range(10, -1, -1):
        (x, C), (x_next, C_next) = begun[k + 1], ahead[k + 1]
        G = 0.9 * C / C_next
        xs, Cs = x + G * (xs - x_next), C + G * (Cs - C_next) * G
        np.testing.assert_allclose([smoothed.mean[k, 0], smoothed.cov[k, 0, 0]], [xs, Cs], rtol=1e-6)
    told = sigmax.constrained("SRCKFB", model, result)
    np.testing.assert_allclose(told.mean[:-1, 0], [x for x, _ in begun[1:]], rtol=1e-7)
    with pytest.raises(InputError, match="when="):
        sigmax.constrain(free, lambda x: x[0], low=0.0, when="later")


def test_a_bent_value_is_met_and_a_wall_is_not_crossed():
    ring = sigmax.constrain(resting(), lambda x: jnp.hypot(x[0], x[1]), equal=3.0)
    near = sigmax.Gaussian([2.0, 1.8, 0.0], [0.01, 0.02, 1.0])
    on = sigmax.run("SRCKFB", ring, near, NOTHING)
    assert np.hypot(*on.mean[0, :2]) == pytest.approx(3.0, abs=0.01)
    wall = sigmax.constrain(resting(Q=[0.05, 0.0, 0.0]), lambda x: x[0], low=0.0)
    z = np.full((20, 1), -1.0)
    held = sigmax.run("SRCKFB", wall, PRIOR, z)
    outside = sigmax.constrained("SRCKFB", wall, sigmax.run("SRCKFB", resting(Q=[0.05, 0.0, 0.0]), PRIOR, z))
    assert held.ok.all()
    assert (outside.mean[:, 0] > 0).all()
    assert (np.linalg.eigvalsh(outside.cov) >= 0).all()
    assert held.mean[-1, 0] > -0.5


def test_a_bias_and_considered_components_stay_what_they_are():
    bias = sigmax.Bias(sensor=[[1.0]], prior=sigmax.Gaussian([0.0], [[1.0]]), names=("offset",))
    model = sigmax.constrain(resting(bias=bias), lambda x: x[0], low=0.5)
    filter = sigmax.get("TSEKF", consider=("c", "offset"))
    result = sigmax.run(filter, model, PRIOR, [[1.0], [np.nan], [2.0]])
    assert result.ok.all()
    np.testing.assert_allclose(result.mean[:, 2], MEAN[2])
    np.testing.assert_allclose(result.cov[:, 2, 2], P[2, 2])
    np.testing.assert_allclose(result.bias_cov[:, 0, 0], 1.0)


def test_what_contradicts_is_told_and_nonsense_is_refused():
    known = sigmax.Gaussian(MEAN, np.diag([0.0, 1.0, 1.0]))
    wrong = sigmax.run("SRCKFB", sigmax.constrain(resting(), lambda x: x[0], low=1.0), known, NOTHING)
    assert "constraint was left out" in wrong.faults()[0]
    fits = sigmax.run("SRCKFB", sigmax.constrain(resting(), lambda x: x[0], low=0.0), known, NOTHING)
    assert fits.ok.all()
    for given, words in (
        ({}, "low= or high="),
        ({"low": 1, "equal": 1}, "low= or high="),
        ({"low": 2, "high": 1}, "between low and high"),
        ({"low": [1, 2]}, "a number or 1 of them"),
        ({"equal": np.nan}, "finite|a number"),
    ):
        with pytest.raises(InputError, match=words):
            sigmax.constrain(resting(), lambda x: x[0], **given)
    with pytest.raises(InputError, match="weighed by the constraint"):
        sigmax.run(sigmax.bank("EKF"), LINE, PRIOR, NOTHING)
    with pytest.raises(InputError, match="no constraint"):
        sigmax.constrained("EKF", resting(), sigmax.run("EKF", resting(), PRIOR, NOTHING))
    modes = {"slow": (LINE, "EKF"), "fast": (resting(Q=np.ones(3)), "EKF")}
    with pytest.raises(InputError, match="constrain one mode alone"):
        sigmax.run(None, sigmax.imm(modes, sojourn={"slow": 9.0, "fast": 9.0}), PRIOR, NOTHING)
