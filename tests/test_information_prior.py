"""A prior of singular information: EIF and SREIF are least squares from it, and say what is still open."""

import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.running import Fault

RNG = np.random.default_rng(5)
T, N = 9, 3
# The third component is made anew of the others in each step, so that F has no inverse; nor has Q.
F = np.array([[1.0, 0.7, 0.0], [0.0, 0.9, 0.0], [0.3, 0.4, 0.0]])
G = np.array([[0.2, 0.1, 0.0]]).T
H = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -1.0]])
R = np.array([[0.5, 0.2], [0.2, 0.3]])
MODEL = sigmax.Model(
    motion=lambda x, dt: jnp.asarray(F) @ x,
    sensor=lambda x: jnp.asarray(H) @ x,
    Q=G @ G.T,
    R=R,
    state=("p", "v", "s"),
    measurement=("first", "second"),
)


def least_squares(F, G, H, R, y, Y, z):
    """Means and covariances of each step from all until it, NaN where they are open: dense, by the pseudo-inverse."""
    n, T = len(F), len(z)
    values, vectors = np.linalg.eigh(Y)
    there = values > 1e-9
    root = np.sqrt(values[there])[:, None] * vectors[:, there].T
    known = vectors[:, there].T @ y / np.sqrt(values[there])
    size = n + G.shape[1] * T
    state = np.eye(n, size)
    rows, right = [np.pad(root, ((0, 0), (0, size - n)))], [known]
    rows.append(np.eye(size)[n:])
    right.append(np.zeros(size - n))
    means, covs = [], []
    for k in range(T):
        state = F @ state
        state[:, n + G.shape[1] * k : n + G.shape[1] * (k + 1)] += G
        seen = np.isfinite(z[k])
        if seen.any():
            L = np.linalg.cholesky(R[np.ix_(seen, seen)])
            rows.append(np.linalg.solve(L, H[seen] @ state))
            right.append(np.linalg.solve(L, z[k][seen]))
        A, b = np.concatenate(rows), np.concatenate(right)
        inverse = np.linalg.pinv(A, rcond=1e-10)
        open_ = np.abs(state - state @ inverse @ A).max(1) > 1e-7
        means.append(np.where(open_, np.nan, state @ inverse @ b))
        cov = state @ inverse @ inverse.T @ state.T
        covs.append(np.where(open_[:, None] | open_[None], np.nan, cov))
    return np.array(means), np.array(covs)


def records(count):
    """Measurements with gaps, and pairs (y, Y) of every rank in turn."""
    z = 3 * RNG.standard_normal((count, T, 2))
    z[RNG.random(z.shape) < 0.35] = np.nan
    roots = [RNG.standard_normal((N, k % (N + 1))) for k in range(count)]
    Y = np.array([root @ root.T for root in roots])
    return z, np.einsum("bij,bj->bi", Y, 2 * RNG.standard_normal((count, N))), Y


@pytest.mark.parametrize(("name", "backend"), [("EIF", "native"), pytest.param("SREIF", "xla", marks=pytest.mark.slow)])
def test_every_step_is_least_squares(name, backend):
    z, y, Y = records(40)
    found = sigmax.run(name, MODEL, sigmax.Gaussian.information(y, Y), z, dt=1.0, backend=backend)
    opened = 0
    for b in range(len(z)):
        means, covs = least_squares(F, G, H, R, y[b], Y[b], z[b])
        np.testing.assert_array_equal(np.isnan(found.mean[b]), np.isnan(means))
        scale = np.sqrt(np.einsum("tii->ti", covs))
        assert np.nanmax(np.abs(found.mean[b] - means) / scale, initial=0) < 1e-9
        np.testing.assert_array_equal(np.isnan(found.cov[b]), np.isnan(covs))
        assert np.nanmax(np.abs(found.cov[b] - covs) / (scale[:, :, None] * scale[:, None]), initial=0) < 1e-9
        np.testing.assert_array_equal(found.fault[b] == Fault.UNDETERMINED, np.isnan(means).any(-1))
        opened += np.isnan(means).any(-1).sum()
    assert 0 < opened < found.fault.size / 2
    assert found.ok[:, -1].mean() > 0.8


@pytest.mark.slow
def test_far_from_zero_and_in_any_units():
    """Factors of 1e6 and 1e-4 between components, and a state 1e7 deviations from 0, cost digits and no more."""
    units = np.array([1e6, 1.0, 1e-4])
    z, _, _ = records(1)
    z = np.where(np.isfinite(z[0]), z[0] + 1e7, np.nan)
    nothing = sigmax.Gaussian.information(np.zeros(N), np.zeros((N, N)))
    plain = sigmax.run("SREIF", MODEL, nothing, z, dt=1.0)
    scaled = sigmax.Model(
        motion=lambda x, dt: jnp.asarray(F * units[:, None] / units) @ x,
        sensor=lambda x: jnp.asarray(H / units) @ x,
        Q=units[:, None] * (G @ G.T) * units,
        R=R,
        state=MODEL.state,
    )
    other = sigmax.run("SREIF", scaled, nothing, z, dt=1.0)
    np.testing.assert_array_equal(np.isnan(other.mean), np.isnan(plain.mean))
    assert np.nanmax(np.abs(other.mean / units - plain.mean) / plain.std) < 1e-6
    means, covs = least_squares(F, G, H, R, np.zeros(N), np.zeros((N, N)), z)
    assert np.nanmax(np.abs(plain.mean - means)[-1] / np.sqrt(np.diag(covs[-1]))) < 1e-6


def test_once_determined_any_filter_goes_on():
    z, y, Y = records(20)
    found = sigmax.run("EIF", MODEL, sigmax.Gaussian.information(y, Y), z, dt=1.0)
    for b in np.flatnonzero(found.ok[:, 4])[:4]:
        prior = sigmax.Gaussian(found.mean[b, 4], found.cov[b, 4])
        on = sigmax.run("KF", MODEL, prior, z[b, 5:], dt=1.0)
        np.testing.assert_allclose(on.mean, found.mean[b, 5:], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(on.nis, found.nis[b, 5:], rtol=1e-7)
        np.testing.assert_allclose(on.step_log_likelihood, found.step_log_likelihood[b, 5:], rtol=1e-7)
        np.testing.assert_allclose(on.innovation_cov, found.innovation_cov[b, 5:], rtol=1e-7)
        np.testing.assert_array_equal(on.dof, found.dof[b, 5:])


def test_what_is_counted_is_what_was_determined_before():
    """All measurements, less the directions that were open and are not: the degrees of freedom of least squares."""
    z, y, Y = records(40)
    found = sigmax.run("EIF", MODEL, sigmax.Gaussian.information(y, Y), z, dt=1.0)
    seen = np.isfinite(z).sum((1, 2))
    rank = np.minimum(np.arange(40) % (N + 1), N)
    done = found.ok[:, -1]
    left = seen - found.dof.sum(1)
    assert (left <= N - rank).all()
    # F has no inverse, and one direction of the start need never be told.
    assert (left[done] >= N - rank[done] - 1).all()
    # Honest: residuals of least squares at the true model are chi-square; here z is anything, and they are its squares.
    b = int(np.flatnonzero(done & (rank == 0))[0])
    means, _ = least_squares(F, G, H, R, y[b], Y[b], z[b])
    assert np.isfinite(means[-1]).all()
    wide = sigmax.run("SRCKFB", MODEL, sigmax.Gaussian(np.zeros(N), np.full(N, 1e8)), z[b], dt=1.0)
    assert abs(np.nansum(found.nis[b]) - np.nansum(wide.nis)) < 1e-3 * np.nansum(wide.nis)


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_the_pair_of_each_step_is_that_of_the_textbook(backend):
    """Y⁻ = M − M G (I + Gᵀ M G)⁻¹ Gᵀ M with M = F⁻ᵀ Y F⁻¹, Y⁺ = Y⁻ + Hᵀ R⁻¹ H: singular Y, a motion with an inverse."""
    A, L, h = np.array([[1.0, 0.5], [0.0, 0.9]]), np.diag([0.3, 0.2]), np.array([[0.0, 1.0]])
    model = sigmax.Model(
        motion=lambda x, dt: jnp.asarray(A) @ x, sensor=lambda x: x[1:], Q=[0.09, 0.04], R=[0.5], state=("p", "v")
    )
    z = RNG.standard_normal((6, 1))
    nothing = sigmax.Gaussian.information(np.zeros(2), np.zeros(2))
    found = sigmax.run("EIF", model, nothing, z, dt=1.0, backend=backend)
    Y, y = np.zeros((2, 2)), np.zeros(2)
    vectors, matrices = found.information
    for k in range(6):
        M, m = np.linalg.inv(A).T @ Y @ np.linalg.inv(A), np.linalg.inv(A).T @ y
        gain = M @ L @ np.linalg.inv(np.eye(2) + L.T @ M @ L) @ L.T
        Y, y = M - gain @ M + h.T @ h / 0.5, m - gain @ m + h[0] * z[k] / 0.5
        np.testing.assert_allclose(matrices[k], Y, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(vectors[k], y, rtol=1e-9, atol=1e-9)
    # The position is never seen.
    assert np.isnan(found.mean[:, 0]).all()
    assert np.isfinite(found.mean[:, 1]).all()
    assert (found.fault == Fault.UNDETERMINED).all()
    assert "not determined yet" in found.faults()[0]


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
def test_live_is_the_run(backend):
    z, y, Y = records(3)
    prior = sigmax.Gaussian.information(y, Y)
    whole = sigmax.run("EIF", MODEL, prior, z, dt=1.0, backend=backend)
    live = sigmax.Live("EIF", MODEL, prior, backend=backend)
    for k in range(T):
        if k == 1:
            content, old = live.save(), live
            live = sigmax.Live("EIF", MODEL, prior, backend=backend)
            live.restore(content)
            np.testing.assert_array_equal(live.mean, old.mean)
        live.predict(1.0)
        told = live.update(z[:, k])
        np.testing.assert_allclose(live.mean, whole.mean[:, k], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(live.cov, whole.cov[:, k], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(told.nis, whole.nis[:, k], rtol=1e-9)
        np.testing.assert_array_equal(live.ok, whole.ok[:, k])
        np.testing.assert_allclose(live.information[1], whole.information[1][:, k], rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_inputs_noises_by_row_and_a_bias():
    """Each against the same model with a wide prior, where that is exact enough."""
    cv = sigmax.motions.constant_velocity()
    bias = sigmax.Bias(prior=sigmax.Gaussian([0.5], [0.2]), sensor=[[1.0], [0.0]], Q=[0.01])
    pushed = sigmax.models.Motion(
        lambda x, dt, u: cv.function(x, dt) + jnp.concatenate([u * dt**2 / 2, u * dt]), cv.state, cv.noise, ("ax", "ay")
    )
    model = sigmax.Model(motion=pushed, sensor=lambda x: x[:2], Q=cv.noise(0.1), R=[0.4, 0.1], bias=bias)
    z, u = RNG.standard_normal((7, 2)), RNG.standard_normal((7, 2))
    given = {"dt": 0.8, "inputs": u, "R": RNG.uniform(0.1, 1.0, (7, 2))}
    found = sigmax.run("SREIF", model, sigmax.Gaussian.information(np.zeros(4), np.zeros(4)), z, **given)
    wide = sigmax.run("SREIF", model, sigmax.Gaussian(np.zeros(4), np.full(4, 1e10)), z, **given)
    np.testing.assert_array_equal(found.ok, np.arange(7) > 0)
    np.testing.assert_allclose(found.mean[1:], wide.mean[1:], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.bias_mean[1:], wide.bias_mean[1:], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.bias_cov[1:], wide.bias_cov[1:], rtol=1e-6)
    # The bias is known before the state is.
    np.testing.assert_allclose(found.bias_mean[0], [0.5], rtol=1e-12)
    live = sigmax.Live("SREIF", model, sigmax.Gaussian.information(np.zeros(4), np.zeros(4)))
    for k in range(7):
        live.predict(0.8, u[k])
        live.update(z[k], R=given["R"][k])
    np.testing.assert_allclose(live.mean, found.mean[-1], rtol=1e-10)


def test_smoothing_reaches_back_to_the_first_step_that_is_determined():
    z, y, Y = records(1)
    z, y, Y = np.where(np.isfinite(z[0]), z[0], 1.0), y[0], Y[0]
    z[0, 1] = np.nan
    found = sigmax.run("EIF", MODEL, sigmax.Gaussian.information(y, Y), z, dt=1.0)
    first = int(np.argmax(found.ok))
    assert first > 0
    smoothed = sigmax.smooth("EIF", MODEL, found)
    prior = sigmax.Gaussian(found.mean[first], found.cov[first])
    on = sigmax.run("KF", MODEL, prior, z[first + 1 :], dt=1.0)
    want = sigmax.smooth("KF", MODEL, on)
    np.testing.assert_allclose(smoothed.mean[first + 1 :], want.mean, rtol=1e-8, atol=1e-9)
    assert np.isfinite(smoothed.mean[first]).all()
    assert not smoothed.ok[:first].any()


def test_regular_information_is_an_ordinary_prior():
    P = np.array([[4.0, 1.0], [1.0, 1e-12]]) * 1e-6
    P[0, 1] = P[1, 0] = 1e-13
    prior = sigmax.Gaussian.information(np.linalg.inv(P) @ [1.0, 2.0], np.linalg.inv(P))
    assert type(prior) is sigmax.Gaussian
    np.testing.assert_allclose(prior.mean, [1.0, 2.0], rtol=1e-9)
    np.testing.assert_allclose(prior.cov, P, rtol=1e-9)
    both = sigmax.Gaussian.information(np.ones((2, 2)), np.array([np.eye(2), 4 * np.eye(2)]))
    np.testing.assert_allclose(both.mean, [[1.0, 1.0], [0.25, 0.25]])
    one = sigmax.Gaussian.information([1.0, 0.0], [2.0, 0.0])
    assert repr(one) == "Gaussian.information(rank 1 of 2)"
    copy = pickle.loads(pickle.dumps(one))
    np.testing.assert_array_equal(copy.Y, one.Y)


NOTHING = sigmax.Gaussian.information(np.zeros(N), np.zeros(N))
ONES = np.ones((3, 2))


def varied(**parts):
    given = {"motion": MODEL.motion, "sensor": MODEL.sensors[""], "Q": G @ G.T, "R": R, "state": MODEL.state}
    return sigmax.Model(**(given | parts))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: sigmax.run("KF", MODEL, NOTHING, ONES), "take EIF or SREIF; sigmax.start"),
        (lambda: sigmax.run("CIF", MODEL, NOTHING, ONES), "take EIF or SREIF; sigmax.start"),
        (lambda: sigmax.run(sigmax.bank("EIF"), MODEL, NOTHING, ONES), "take EIF or SREIF; sigmax.start"),
        (lambda: sigmax.run(sigmax.get("EIF", update="student"), MODEL, NOTHING, ONES), "take plain EIF"),
        (lambda: sigmax.run(sigmax.get("EIF", consider=("s",)), MODEL, NOTHING, ONES), "holds by what it knows"),
        (lambda: sigmax.Live("CKF", MODEL, NOTHING), "sigmax.start"),
        (lambda: sigmax.Live("EIF", MODEL, NOTHING, lag=2.0), "sigmax.start"),
        (lambda: sigmax.run("EIF", varied(sensor=lambda x: x[:2] ** 2), NOTHING, ONES), "not linear; .*sigmax.start"),
        (lambda: sigmax.Live("EIF", varied(motion=lambda x, dt: jnp.sin(x)), NOTHING), "not linear; .*sigmax.start"),
        (lambda: sigmax.run("EIF", varied(R=lambda x: jnp.exp(x[:2])), NOTHING, ONES), "R depends on the state"),
        (
            lambda: sigmax.run("EIF", varied(state=("p", "v", sigmax.angle("s"))), NOTHING, ONES),
            "an angle of which nothing is known.*sigmax.start",
        ),
        (lambda: sigmax.smooth("EIF", MODEL, NOTHING), "what sigmax.run gave"),
        (lambda: sigmax.run("EIF", MODEL, sigmax.Gaussian.information(np.zeros(4), np.zeros(4)), ONES), "4 components"),
        (lambda: sigmax.fit("EIF", lambda p: (MODEL, NOTHING), {"a": 1.0}, ONES, dt=1.0), "no mean and no covariance"),
        (lambda: sigmax.doctor(MODEL, NOTHING, ONES), "take EIF or SREIF; sigmax.start"),
        (lambda: NOTHING.cov, "EIF and SREIF take it"),
        (lambda: sigmax.Gaussian.information([1.0, 0.0], [0.0, 1.0]), "no state x has Y x = y"),
        (lambda: sigmax.Gaussian.information([0.0, 0.0], [[0.0, 1.0], [1.0, 0.0]]), "positive semidefinite"),
        (lambda: sigmax.Gaussian.information([0.0, 0.0], np.zeros((3, 3))), "needs Y of shape"),
        (lambda: sigmax.Gaussian.information([0.0, np.nan], np.zeros(2)), "finite"),
    ],
)
def test_what_cannot_be_is_told_in_words(call, says):
    with pytest.raises(sigmax.InputError, match=says):
        call()
