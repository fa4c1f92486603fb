"""Correlated noises: the predictor of the textbook, and the whole record as one normal distribution."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.models import after, correlated, correlated_at_end, shifted

F = np.array([[1.0, 0.8], [-0.1, 0.9]])
H = np.array([[1.0, 0.3], [0.0, 1.0]])
Q, R = np.array([[0.5, 0.1], [0.1, 0.4]]), np.array([[0.6, 0.1], [0.1, 0.3]])
S = np.array([[0.3, -0.1], [0.05, 0.2]])
MODEL = sigmax.Model(
    motion=lambda x, dt: jnp.asarray(F) @ x,
    sensor=lambda x: jnp.asarray(H) @ x,
    Q=lambda dt: jnp.asarray(Q),
    R=R,
    state=("a", "b"),
)
PRIOR = sigmax.Gaussian([0.5, -1.0], [[2.0, 0.3], [0.3, 1.0]])
Z = np.random.default_rng(2).normal(size=(9, 2))
Z[3], Z[5, 0] = np.nan, np.nan


def drawn_together(end=False):
    """Mean and covariance of all states given all they were measured by, and of each given what came until then."""
    T = len(Z)
    # The states are linear in x_0 and the noises: rows over [x_0, w_0 … w_T-2, v_0 … v_T-1].
    size = 2 + 2 * (T - 1) + 2 * T
    C = np.zeros((size, size))
    C[:2, :2] = PRIOR.cov
    X = [np.eye(2, size)]
    for k in range(T):
        v = slice(2 + 2 * (T - 1) + 2 * k, 4 + 2 * (T - 1) + 2 * k)
        C[v, v] = R
        if k < T - 1:
            w = slice(2 + 2 * k, 4 + 2 * k)
            with_it = slice(v.start + 2, v.stop + 2) if end else v
            C[w, w], C[w, with_it], C[with_it, w] = Q, S, S.T
            step = np.zeros((2, size))
            step[:, w] = np.eye(2)
            X.append(F @ X[-1] + step)
    V = [np.eye(size)[2 + 2 * (T - 1) + 2 * k :][:2] for k in range(T)]
    begin = np.zeros(size)
    begin[:2] = PRIOR.mean

    def given(until):
        rows = np.concatenate([(H @ X[k] + V[k])[~np.isnan(Z[k])] for k in range(until)])
        z = np.concatenate([Z[k][~np.isnan(Z[k])] for k in range(until)])
        K = C @ rows.T @ np.linalg.inv(rows @ C @ rows.T)
        mean, cov = begin + K @ (z - rows @ begin), C - K @ rows @ C
        return [(x @ mean, x @ cov @ x.T) for x in X]

    whole = given(T)
    return [given(k + 1)[k] for k in range(T)], whole


FILTERED, SMOOTHED = drawn_together()


def check(name, backend=None):
    model = correlated(MODEL, S)
    # The prior stands at the first measurement.
    result = sigmax.run(name, model, PRIOR, Z, inputs=shifted(Z), update_first=True, backend=backend)
    assert result.ok.all()
    back = sigmax.smooth(name, model, result, backend=backend)
    for k in range(len(Z)):
        for found, (mean, cov) in ((result, FILTERED[k]), (back, SMOOTHED[k])):
            np.testing.assert_allclose(found.mean[k], mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(found.cov[k], cov, rtol=1e-9, atol=1e-9)
    return result


@pytest.mark.parametrize("name", ["EKF", "SRCKF", "SRUKFB", "SREIF"])
def test_every_form_is_the_conditional_distribution_forwards_and_backwards(name):
    check(name)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("name", [n for n in sigmax.names() if n != "KF"])
def test_every_filter_and_engine(name, backend):
    check(name, backend)


@pytest.mark.parametrize("name", ["EKF", "SRCKF", pytest.param("SREIF", marks=pytest.mark.slow)])
def test_at_the_end_of_an_interval_too_forwards_and_backwards(name):
    """And beside a sensor that is not correlated, of which nothing is heard."""
    filtered, smoothed = drawn_together(end=True)
    model, prior = correlated_at_end(MODEL, PRIOR, S)
    result = sigmax.run(name, model, prior, Z, update_first=True)
    assert result.ok.all()
    back = sigmax.smooth(name, model, result)
    for k in range(len(Z)):
        for found, (mean, cov) in ((result, filtered[k]), (back, smoothed[k])):
            np.testing.assert_allclose(found.mean[k, :2], mean, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(found.cov[k, :2, :2], cov, rtol=1e-8, atol=1e-8)
    two = sigmax.Model(
        motion=MODEL.motion, Q=MODEL.Q, state=("a", "b"), sensor={"one": MODEL.sensors[""], "two": lambda x: x[:1]},
        R={"one": R, "two": [1.0]},
    )  # fmt: skip
    model, prior = correlated_at_end(two, PRIOR, {"one": S})
    assert model.state == ("a", "b", "noise_one_measurement0", "noise_one_measurement1")
    both = sigmax.run(name, model, prior, {"one": Z, "two": np.full((len(Z), 1), np.nan)}, update_first=True)
    np.testing.assert_allclose(both.mean, result.mean, rtol=1e-9, atol=1e-9)


def test_the_predictor_of_the_textbook():
    """K = (F P Hᵀ + S) (H P Hᵀ + R)⁻¹ of Anderson and Moore, of a record without holes."""
    z = np.nan_to_num(Z)
    model = correlated(MODEL, S)
    result = sigmax.run("SRCKFB", model, PRIOR, z, inputs=shifted(z), update_first=True)
    x, P = PRIOR.mean, PRIOR.cov
    for k, value in enumerate(z):
        Y = H @ P @ H.T + R
        np.testing.assert_allclose(result.innovation[k], value - H @ x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(result.innovation_cov[k], Y, rtol=1e-9)
        K = (F @ P @ H.T + S) @ np.linalg.inv(Y)
        x, P = F @ x + K @ (value - H @ x), F @ P @ F.T + Q - K @ Y @ K.T


def test_live_and_a_batch_are_the_run_and_angles_turn():
    model = correlated(MODEL, S)
    alone = sigmax.run("EKF", model, PRIOR, Z, inputs=shifted(Z), update_first=True)
    both = np.stack([Z[::-1], Z])
    batch = sigmax.run("EKF", model, PRIOR, both, inputs=shifted(both), update_first=True)
    np.testing.assert_allclose(batch.mean[1], alone.mean, rtol=1e-12)
    live = sigmax.Live("EKF", model, PRIOR)
    for k, z in enumerate(Z):
        if k:
            live.predict(1.0, u=after(Z[k - 1]))
        live.update(z)
    np.testing.assert_allclose(live.mean, alone.mean[-1], rtol=1e-12)
    turning = sigmax.Model(
        motion=lambda x, dt: x, sensor=lambda x: x, Q=[0.02], R=[0.01],
        state=(sigmax.angle("course"),), measurement=(sigmax.angle("compass"),),
    )  # fmt: skip
    near = [
        correlated(turning, [[0.01]]).motion(jnp.asarray([3.13]), 1.0, after([a])) for a in (-3.13, 2 * np.pi - 3.13)
    ]
    np.testing.assert_allclose(near[0], near[1])


def test_it_is_worth_what_it_should_be():
    """Over drawn records the correlation is found in NEES and errors; leaving it out shows."""
    rng = np.random.default_rng(5)
    noise = np.linalg.cholesky(np.block([[Q, S], [S.T, R]]) + 1e-12 * np.eye(4))
    B, T = 300, 30
    x, z, truth = rng.multivariate_normal(PRIOR.mean, PRIOR.cov, B), [], []
    for _ in range(T):
        both = rng.normal(size=(B, 4)) @ noise.T
        truth.append(x)
        z.append(x @ H.T + both[:, 2:])
        x = x @ F.T + both[:, :2]
    z, truth = np.stack(z, 1), np.stack(truth, 1)
    nees = {}
    for what, model, inputs in (("with", correlated(MODEL, S), shifted(z)), ("without", MODEL, None)):
        result = sigmax.run("EKF", model, PRIOR, z, inputs=inputs, update_first=True)
        e = (result.mean - truth)[:, 5:]
        nees[what] = np.einsum("bti,btij,btj->bt", e, np.linalg.inv(result.cov[:, 5:]), e).mean() / 2
    assert nees["with"] == pytest.approx(1, abs=0.06)
    assert abs(nees["without"] - 1) > 0.1


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="shape"):
        correlated(MODEL, np.eye(3))
    with pytest.raises(InputError, match="a matrix"):
        correlated(MODEL, {"a": S})
    too_much = correlated(MODEL, 10 * S)
    with pytest.raises(InputError, match="semidefinite"):
        sigmax.run("EKF", too_much, PRIOR, Z, inputs=shifted(np.ones_like(Z))[::-1], update_first=True)
    with pytest.raises(InputError, match="inputs"):
        sigmax.run("EKF", correlated(MODEL, S), PRIOR, Z)
