"""Considered components: a Schmidt–Kalman filter by hand, in every form, and what must hold beyond linear models."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError

DT = 0.7
Q = np.diag([0.02, 0.3, 0.05])
R = np.array([[0.4, 0.1], [0.1, 0.9]])
HELD = ("lever", "offset")
BIAS = sigmax.Bias(
    sensor=[[1.0], [0.0]], motion=[[0.0], [0.2], [0.0]], prior=sigmax.Gaussian([0.3], [[2.0]]), names=("offset",)
)
PRIOR = sigmax.Gaussian([1.0, 0.5, -0.4], [[4.0, 0.3, 0.2], [0.3, 1.5, -0.1], [0.2, -0.1, 1.0]])
F = np.array([[1, 0.4 * DT, DT], [0, 0.95, 0], [0, 0.1, 0.9]])
H = np.array([[1.0, -0.5, 0.0], [0.0, 1.0, 2.0]])


def moved(x, dt):
    return jnp.asarray(F) @ x


def seen(x):
    return jnp.asarray(H) @ x


# The considered component of the state stands in the middle of it, the bias before or behind it, as the form wants.
MODEL = sigmax.Model(motion=moved, sensor=seen, Q=lambda dt: jnp.asarray(Q), R=R, state=("x", "lever", "v"), bias=BIAS)
Z = np.random.default_rng(8).normal(size=(12, 2)) * 2
Z[4], Z[7, 1] = np.nan, np.nan


def schmidt():
    """Means and covariances of [x; b] by Joseph's formula with rows of the gain set to 0."""
    A = np.block([[F, np.array([[0.0], [0.2], [0.0]])], [np.zeros((1, 3)), np.eye(1)]])
    W = np.zeros((4, 4))
    W[:3, :3] = Q
    G = np.column_stack([H, [1.0, 0.0]])
    x, P = np.r_[PRIOR.mean, 0.3], np.zeros((4, 4))
    P[:3, :3], P[3, 3] = PRIOR.cov, 2.0
    found = []
    for z in Z:
        x, P = A @ x, A @ P @ A.T + W
        there = ~np.isnan(z)
        if there.any():
            g, r = G[there], R[np.ix_(there, there)]
            K = P @ g.T @ np.linalg.inv(g @ P @ g.T + r)
            K[[1, 3]] = 0
            x, keep = x + K @ (z[there] - g @ x), np.eye(4) - K @ g
            P = keep @ P @ keep.T + K @ r @ K.T
        found.append((x, P))
    return found


def check(name, **how):
    result = sigmax.run(sigmax.get(name, consider=HELD), MODEL, PRIOR, Z, dt=DT, **how)
    assert result.ok.all()
    for k, (x, P) in enumerate(schmidt()):
        np.testing.assert_allclose(result.mean[k], x[:3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(result.cov[k], P[:3, :3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(result.bias_mean[k], x[3:], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(result.bias_cov[k], P[3:, 3:], rtol=1e-9, atol=1e-9)
    return result


# One of each form, one that takes the bias out of its points, one with negative weights.
@pytest.mark.parametrize("name", ["EKF", "SRCKF", "SRCIF", "SRUKFB", "EIF", "TSCKF", "TSCIF", "MTSCKF"])
@pytest.mark.one_in(2)
def test_every_form_is_the_filter_of_schmidt(name):
    check(name)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("name", sigmax.names())
def test_every_filter_is_the_filter_of_schmidt(name, backend):
    check(name, backend=backend)


def test_xla_live_and_a_batch_agree():
    alone = check("EKF", backend="xla")
    filter = sigmax.get("EKF", consider=HELD)
    batch = sigmax.run(filter, MODEL, PRIOR, np.stack([Z, Z[::-1]]), dt=DT)
    np.testing.assert_allclose(batch.mean[0], alone.mean, rtol=1e-12, atol=1e-12)
    live = sigmax.Live(filter, MODEL, PRIOR)
    for z in Z:
        live.step(z, DT)
    np.testing.assert_allclose(live.mean, alone.mean[-1], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(live.cov, alone.cov[-1], rtol=1e-12, atol=1e-12)


def bent(x):
    return jnp.stack([jnp.sqrt(1 + x[0] ** 2) + x[1] * x[0], jnp.arctan(x[0])])


CURVED = sigmax.Model(
    motion=lambda x, dt: jnp.stack([x[0] + 0.1 * jnp.sin(x[0]) * dt, x[1]]),
    sensor=bent,
    Q=[0.05, 0.0],
    R=[0.04, 0.01],
    state=("x", "scale"),
)
AT = sigmax.Gaussian([2.0, 0.1], [[0.5, 0.05], [0.05, 0.04]])


@pytest.mark.parametrize("update", ["once", "iterated(2)", "student", "gate(0.5)"])
def test_no_measurement_changes_what_is_considered(update):
    rng = np.random.default_rng(3)
    z = np.array([2.3, 1.1]) + rng.normal(size=(30, 2)) * [0.2, 0.1]
    z[::5] += 4
    filter = sigmax.get("SRCKFB", update=update, consider="scale")
    result = sigmax.run(filter, CURVED, AT, z)
    assert result.ok[result.dof > 0].all()
    np.testing.assert_allclose(result.mean[:, 1], 0.1, rtol=1e-12)
    np.testing.assert_allclose(result.cov[:, 1, 1], 0.04, rtol=1e-11)
    # It is never surer of the rest than the filter that learns the component, nor surer than if it were known.
    assert np.linalg.eigvalsh(result.cov).min() >= 0
    if update == "once":
        known = sigmax.run("SRCKFB", CURVED, sigmax.Gaussian(AT.mean, [[0.5, 0.0], [0.0, 0.0]]), z)
        assert (result.std[:, 0] >= known.std[:, 0] * (1 - 1e-9)).all()


def test_claims_are_honest_where_the_component_is_as_uncertain_as_it_says():
    """NEES of x over drawn constants: 1 with it considered, far above with it taken as known."""
    rng = np.random.default_rng(11)
    B, T = 400, 40
    gain = 1 + 0.2 * rng.standard_normal((B, 1))
    walk = np.cumsum(0.1 * rng.standard_normal((B, T)), 1)
    z = (walk + gain + 0.5 * rng.standard_normal((B, T)))[..., None]
    model = sigmax.Model(
        motion=lambda x, dt: x, sensor=lambda x: x[:1] + x[1:], Q=[0.01, 0.0], R=[0.25], state=("x", "offset")
    )
    nees = {}
    for held in ((), ("offset",)):
        variance = 0.04 if held else 0.0
        prior = sigmax.Gaussian([0.0, 1.0], [[1e-12, 0.0], [0.0, variance]])
        result = sigmax.run(sigmax.get("SREKFB", consider=held), model, prior, z)
        nees[held] = float(((result.mean[:, -1, 0] - walk[:, -1]) ** 2 / result.cov[:, -1, 0, 0]).mean())
    assert nees["offset",] == pytest.approx(1, abs=0.25)
    assert nees[()] > 1.5


def test_names_and_what_cannot_be_done_are_refused():
    with pytest.raises(InputError, match=r"consider: unknown component 'leaver'.*lever"):
        sigmax.run(sigmax.get("EKF", consider="leaver"), MODEL, PRIOR, Z)
    with pytest.raises(InputError, match="considers every component"):
        sigmax.run(sigmax.get("EKF", consider=("x", "scale")), CURVED, AT, Z)
    with pytest.raises(InputError, match="different names"):
        sigmax.get("EKF", consider=("x", "x"))
    with pytest.raises(InputError, match="members of a bank"):
        sigmax.get("EKF", consider="x", members=5)
    held = sigmax.get("EKF", consider="scale")
    with pytest.raises(InputError, match="smooth the same filter without consider"):
        sigmax.smooth(held, CURVED, sigmax.run(held, CURVED, AT, Z))
    with pytest.raises(InputError, match="without consider"):
        sigmax.Live(held, CURVED, AT, lag=1.0)


def test_a_trial_says_it():
    from sigmax.records import parse_trial

    trial = parse_trial("SRCKFB:consider=lever,consider=offset")
    assert trial.filter == sigmax.get("SRCKFB", consider=HELD)
    assert trial.filter.name == "SRCKFB(consider=lever+offset)"
