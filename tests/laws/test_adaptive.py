"""Noises found as a filter goes: equal to textbooks in plain NumPy, in every form, on both engines, live and late."""

import subprocess

import numpy as np
import pytest

import sigmax
from sigmax.engine.rows import RowSteps
from sigmax.errors import InputError
from sigmax.filters import adaptive_Q

F, H = np.array([[1.0, 0.7], [0.0, 0.95]]), np.array([[1.0, 0.0], [0.4, 1.0]])
Q, R = np.array([[0.06, 0.05], [0.05, 0.1]]), np.array([0.4, 0.9])
PRIOR = sigmax.Gaussian([0.5, -0.2], [[2.0, 0.3], [0.3, 1.0]])
MODEL = sigmax.Model(
    motion=lambda x, dt: np.asarray(F) @ x,
    sensor=lambda x: np.asarray(H) @ x,
    Q=lambda dt: dt * Q,
    R=R,
    state=("x", "v"),
    measurement=("a", "b"),
)
BOTH = sigmax.get("SREKFB", update="adaptive(12)", Q=adaptive_Q(15, [["x"], ["v"]]))


def drawn(steps=60, tracks=None, seed=4):
    """A record whose noises are several times those of the model in its second half, with holes."""
    rng = np.random.default_rng(seed)
    shape = () if tracks is None else (tracks,)
    x, z = np.zeros((*shape, 2)), []
    for k in range(steps):
        more = 1.0 if k < steps / 2 else 3.0
        x = x @ F.T + more * rng.normal(size=(*shape, 2)) @ np.linalg.cholesky(Q).T
        z.append(x @ H.T + more * np.sqrt(R) * rng.normal(size=(*shape, 2)))
    z = np.stack(z, -2)
    z[..., 7:8, :], z[..., 20:21, 1] = np.nan, np.nan
    return z


def variational(z, memory, sweeps):
    """The filter of Särkkä and Nummenmaa 2009, inverse gammas whose shapes have come to rest: means, P, R."""
    x, P, alpha = PRIOR.mean, PRIOR.cov, memory / 2 * np.ones(2)
    beta, rho, found = alpha * R, 1 - 1 / memory, []
    for row in z:
        x, P = F @ x, F @ P @ F.T + Q
        at = np.flatnonzero(~np.isnan(row))
        h, y = H[at], row[at]
        guess, kept = beta / alpha, beta.copy()
        m, C = x, P
        for sweep in range(sweeps + 1):
            K = P @ h.T @ np.linalg.inv(h @ P @ h.T + np.diag(guess[at]))
            m, C = x + K @ (y - h @ x), P - K @ h @ P
            if sweep < sweeps:
                kept = beta.copy()
                kept[at] = rho * beta[at] + 0.5 * (y - h @ m) ** 2 + 0.5 * np.diag(h @ C @ h.T)
                guess = kept / alpha  # alpha = rho alpha + 1/2
        x, P, beta = m, C, kept
        found.append((x, P, beta / alpha))
    return [np.stack(a) for a in zip(*found, strict=True)]


def recursive(z, memory):
    """The number that multiplies Q, by Kalman's equations and their derivatives by its logarithm: means, P, s."""
    x, P, dx, dP = PRIOR.mean, PRIOR.cov, np.zeros(2), np.zeros((2, 2))
    theta, told, prior, found = 0.0, 0.0, np.log(10) ** -2, []
    for row in z:
        s = np.exp(theta)
        x, P, dx, dP = F @ x, F @ P @ F.T + s * Q, F @ dx, F @ dP @ F.T + s * Q
        at = np.flatnonzero(~np.isnan(row))
        if len(at):
            h, nu = H[at], row[at] - H[at] @ x
            Y = np.linalg.inv(h @ P @ h.T + np.diag(R[at]))
            dnu, dS = -h @ dx, h @ dP @ h.T
            K = P @ h.T @ Y
            dK = dP @ h.T @ Y - P @ h.T @ Y @ dS @ Y
            score = -nu @ Y @ dnu + 0.5 * nu @ Y @ dS @ Y @ nu - 0.5 * np.trace(Y @ dS)
            # x + K ν and P − K S Kᵀ, by the rules for products.
            S = np.linalg.inv(Y)
            x, dx = x + K @ nu, dx + dK @ nu + K @ dnu
            P, dP = P - K @ S @ K.T, dP - dK @ S @ K.T - K @ dS @ K.T - K @ S @ dK.T
            told = told * (1 - 1 / memory) + dnu @ Y @ dnu + 0.5 * np.trace(Y @ dS @ Y @ dS)
            step = (score - theta * prior / memory) / (told + prior)
            theta += np.clip(step, -np.log(2), np.log(2))
        found.append((x, P, np.exp(theta)))
    return [np.stack(a) for a in zip(*found, strict=True)]


@pytest.mark.parametrize("name", ["EKF", "SRCKFB", pytest.param("SRUKF", marks=pytest.mark.slow), "SREIF"])
def test_R_is_that_of_variational_bayes(name):
    z = drawn()
    mean, cov, scale = variational(z, 12, 2)
    assert scale[-1].max() > 3 * scale[20].max()
    got = sigmax.run(sigmax.get(name, update="adaptive(12)"), MODEL, PRIOR, z)
    np.testing.assert_allclose(got.mean, mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.cov, cov, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(got.R_scale * R, scale, rtol=1e-9)
    # Twenty sweeps differ from two by less than half of the estimate's own uncertainty, √(2 / 12).
    assert np.abs(np.log(variational(z, 12, 20)[2] / scale)).max() < 0.2


@pytest.mark.parametrize("name", ["EKF", "SRCKFB", pytest.param("SRPF", marks=pytest.mark.slow), "CIF"])
def test_Q_is_that_of_recursive_maximum_likelihood(name):
    z = drawn()
    mean, cov, scale = recursive(z, 15)
    assert scale[-1] > 2 * scale[20]
    got = sigmax.run(sigmax.get(name, Q="adaptive(15)"), MODEL, PRIOR, z)
    np.testing.assert_allclose(got.mean, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(got.cov, cov, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(got.Q_scale[:, 0], scale, rtol=1e-8)


def test_live_is_the_batch_and_so_is_a_late_record():
    z = drawn(24, 2)
    got = sigmax.run(BOTH, MODEL, PRIOR, z)
    for track in range(2):
        live = sigmax.Live(BOTH, MODEL, PRIOR, window=3.0)
        order = [0, 1, 3, 2, 4, 5, 7, 6, *range(8, 12)]
        for k in order:
            live.update(z[track, k], time=k + 1.0)
        middle = live.save()
        live = sigmax.Live(BOTH, MODEL, PRIOR, window=3.0)
        live.restore(middle)
        for k in range(12, 24):
            live.update(z[track, k], time=k + 1.0)
        assert np.array_equal(live.mean, got.mean[track, -1])
        assert np.array_equal(live.R_scale, got.R_scale[track, -1])
        assert np.array_equal(live.Q_scale, got.Q_scale[track, -1])
        assert "Q_scale_v" in repr(live)


@pytest.mark.parametrize(
    "filter",
    [sigmax.get("EKF", update="adaptive(12)", Q="adaptive(15)"), pytest.param(BOTH, marks=pytest.mark.slow)],
    ids=str,
)
def test_engines_agree(filter):
    z = drawn(24, 2)
    one, other = (sigmax.run(filter, MODEL, PRIOR, z, backend=b) for b in ("native", "xla"))
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.Q_scale, other.Q_scale, rtol=1e-8)
    np.testing.assert_allclose(one.R_scale, other.R_scale, rtol=1e-9)
    if filter is BOTH:
        smoothed = [sigmax.smooth(BOTH, MODEL, r, backend=b) for r, b in ((one, "native"), (other, "xla"))]
        np.testing.assert_allclose(smoothed[0].mean, smoothed[1].mean, rtol=1e-9, atol=1e-9)


def test_a_smoother_takes_the_Q_that_was_found():
    z = drawn()
    filter = sigmax.get("EKF", Q="adaptive(15)")
    got = sigmax.run(filter, MODEL, PRIOR, z)
    smoothed = sigmax.smooth(filter, MODEL, got)
    x, P = got.mean[-1], got.cov[-1]
    for k in range(len(z) - 2, -1, -1):
        ahead = F @ got.cov[k] @ F.T + got.Q_scale[k, 0] * Q
        gain = got.cov[k] @ F.T @ np.linalg.inv(ahead)
        x, P = got.mean[k] + gain @ (x - F @ got.mean[k]), got.cov[k] + gain @ (P - ahead) @ gain.T
        np.testing.assert_allclose(smoothed.mean[k], x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(smoothed.cov[k], P, rtol=1e-7, atol=1e-9)
    with pytest.raises(InputError, match="other noises are found"):
        sigmax.smooth("SRCKFB", MODEL, got)


def test_units_of_a_sensor_do_not_matter():
    """The same in other units, and with R given as a function or with each measurement."""
    z, D = drawn(30), np.array([100.0, 0.01])
    filter = sigmax.get("EKF", update="adaptive(12)")
    got = sigmax.run(filter, MODEL, PRIOR, z)
    scaled = sigmax.Model(
        motion=MODEL.motion,
        sensor=lambda x: D * (np.asarray(H) @ x),
        Q=MODEL.Q,
        R=R,
        state=("x", "v"),
        measurement=("a", "b"),
    )
    other = sigmax.run(filter, scaled, PRIOR, z * D, R=np.tile(R * D * D, (30, 1)))
    np.testing.assert_allclose(got.mean, other.mean, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(got.R_scale, other.R_scale, rtol=1e-10)


def test_outliers_do_not_count_as_noise():
    rng = np.random.default_rng(0)
    z = drawn(200, seed=1)[:100]
    z[rng.random(100) < 0.08] += 30.0
    plain, robust = (
        sigmax.run(sigmax.get("EKF", update=update, Q="adaptive(15)"), MODEL, PRIOR, z)
        for update in ("adaptive(40)", "adaptive(40) student(2)")
    )
    assert plain.R_scale[-30:].mean() > 10
    assert robust.R_scale[-30:].mean() < 3
    assert robust.Q_scale[-30:].mean() < 5


def test_exported_c_carries_what_is_known(tmp_path):
    sigmax.export_c(sigmax.get("EKF", update="adaptive(12)", Q="adaptive(15)"), MODEL, PRIOR, tmp_path, z=drawn(30))
    assert "what is known of noises: R_scale_a, R_scale_b, Q_scale" in (tmp_path / "filter.h").read_text()
    told = subprocess.run(["make", "-C", str(tmp_path), "test"], capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert "faults 0" in told.stdout


def test_names_are_read_as_they_are_written():
    for text in ("adaptive(20)", "adaptive(20) iterated(2) student(4)"):
        assert str(sigmax.get("EKF", update=text).update) == text
    assert sigmax.get("EKF", Q="adaptive(30)").name == "EKF(Q=adaptive(30))"
    assert BOTH.Q.groups == (("x",), ("v",))
    result = sigmax.run(BOTH, MODEL, PRIOR, drawn(6))
    assert {"R_scale_a", "R_scale_b", "Q_scale_x", "Q_scale_v"} <= set(result.to_frame().columns)
    assert "R_scale_a" in str(result)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"update": "adaptive(1)"}, "at least 2"),
        ({"update": "adaptive(5) adaptive(6)"}, "says twice"),
        ({"Q": "adaptive(x)"}, "is a number of measurements"),
        ({"Q": "more"}, "'adaptive', 'adaptive"),
        ({"Q": "adaptive", "members": 5}, "a Q of their own"),
    ],
)
def test_what_is_no_adaptive_noise_is_a_message(given, message):
    with pytest.raises(InputError, match=message):
        sigmax.get("EKF", **given)


def test_what_cannot_be_adapted_is_a_message():
    adaptive, z = sigmax.get("EKF", update="adaptive"), drawn(3)
    unnamed = sigmax.Model(motion=MODEL.motion, sensor=MODEL.sensors[""], Q=Q, R=lambda x: R, state=("x", "v"))
    modes = sigmax.imm({"one": MODEL, "two": MODEL}, sojourn=[5.0, 5.0])
    for filter, model, message in (
        (adaptive, unnamed, "name them with measurement="),
        (adaptive, modes, "let modes differ"),
        (sigmax.bank(adaptive, 5), MODEL, "filter of one belief"),
        (sigmax.get("EKF", Q=adaptive_Q(20, ["speed"])), MODEL, "speed"),
    ):
        with pytest.raises(InputError, match=message):
            sigmax.run(filter, model, PRIOR, z)
    with pytest.raises(InputError, match="do not carry"):
        RowSteps(adaptive, MODEL)
    with pytest.raises(InputError, match="R is that of the model"):
        _ = sigmax.run("EKF", MODEL, PRIOR, z).R_scale
    with pytest.raises(InputError, match="modes, which holds noises"):
        _ = sigmax.run(adaptive, MODEL, PRIOR, z, keep=("mean",)).R_scale
