"""Noises inside functions: equal to added ones where they are added, to a textbook's EKF, and to drawn moments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.errors import InputError
from sigmax.models import inside

Q, R = np.array([[0.04, 0.01], [0.01, 0.09]]), np.array([0.2, 0.05])
G = np.array([[0.5, 0.0], [1.0, 0.3], [0.0, 1.0]])
PRIOR = sigmax.Gaussian([1.0, 0.5, 2.0], [[0.4, 0.1, 0.0], [0.1, 0.3, 0.05], [0.0, 0.05, 0.2]])
NAMES = ("a", "b", "c")
Z = np.random.default_rng(6).normal(size=(8, 2)) * 0.3 + [1.0, 2.2]
Z[2], Z[5, 1] = np.nan, np.nan


def bent(x, dt):
    return jnp.stack([x[0] + dt * jnp.sin(x[2]), x[1] * jnp.cos(0.2 * x[0]), x[2] + 0.1 * dt * x[0] * x[1]])


def seen(x):
    return jnp.stack([jnp.hypot(x[0], x[1]), x[2] + 0.1 * x[0] ** 2])


ADDED = sigmax.Model(motion=bent, sensor=seen, Q=G @ Q @ G.T, R=R, state=NAMES)
WITHIN = sigmax.Model(
    motion=inside(lambda x, dt, w: bent(x, dt) + jnp.asarray(G) @ w, Q),
    sensor=inside(lambda x, v: seen(x) + v, R),
    state=NAMES,
    measurement=("range", "sum"),
)


def same(name, backend, **how):
    runs = []
    for model in (ADDED, WITHIN):
        result = sigmax.run(name, model, PRIOR, Z, dt=0.5, backend=backend, **how)
        assert result.ok.all()
        runs.append((result, sigmax.smooth(name, model, result, backend=backend)))
    for one, other in zip(*runs, strict=True):
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(one.cov, other.cov, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(runs[0][0].log_likelihood, runs[1][0].log_likelihood, rtol=1e-9)


@pytest.mark.parametrize("name", ["SRCKF", "EIF"])
@pytest.mark.one_in(2)
def test_what_is_added_inside_is_what_is_added_outside(name):
    same(name, None)


@pytest.mark.parametrize("update", [pytest.param("iterated(2)", marks=pytest.mark.slow), "student"])
def test_with_any_update(update):
    same(sigmax.get("SRCKFB", update=update), None)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("name", [n for n in sigmax.names() if n != "KF"])
def test_every_filter_and_engine(name, backend):
    same(name, backend)


def driven(x, dt, u, w):
    """A unicycle whose speed and turn are told, and wrong by a share and a sum."""
    speed, turn = u[0] * (1 + w[0]), u[1] + w[1]
    return jnp.stack(
        [x[0] + dt * speed * jnp.cos(x[2] + w[1]), x[1] + dt * speed * jnp.sin(x[2] + w[1]), x[2] + dt * turn]
    )


SHARES = np.array([0.04, 0.01])


def scaled(x, v):
    return jnp.stack([x[0] * (1 + v[0]) + v[1], x[1] + v[1]])


NOISES = np.diag([0.02, 0.3])
UNICYCLE = sigmax.Model(
    motion=inside(driven, SHARES), sensor=inside(scaled, NOISES), state=NAMES, measurement=("x", "y")
)


def by_hand(z, u):
    """The EKF of the textbook: P⁻ = F P Fᵀ + L Q Lᵀ, S = H P Hᵀ + M R Mᵀ."""
    x, P, found = jnp.asarray(PRIOR.mean), PRIOR.cov, []
    none = jnp.zeros(2)
    for value, told in zip(z, u, strict=True):
        F, L = (np.asarray(jax.jacfwd(driven, i)(x, 0.5, told, none)) for i in (0, 3))
        x, P = driven(x, 0.5, told, none), F @ P @ F.T + L @ np.diag(SHARES * 0.5) @ L.T
        H, M = (np.asarray(jax.jacfwd(scaled, i)(x, none)) for i in (0, 1))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + M @ NOISES @ M.T)
        x, P = x + K @ (value - scaled(x, none)), (np.eye(3) - K @ H) @ P
        found.append((np.asarray(x), P))
    return found


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
def test_the_extended_filter_of_the_textbook(backend):
    z, u = np.nan_to_num(Z, nan=1.0), np.tile([1.5, 0.2], (8, 1))
    for name in ("EKF", "SREKFB") if backend == "native" else ("EKF",):
        result = sigmax.run(name, UNICYCLE, PRIOR, z, dt=0.5, inputs=u, backend=backend)
        for k, (x, P) in enumerate(by_hand(z, jnp.asarray(u))):
            np.testing.assert_allclose(result.mean[k], x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(result.cov[k], P, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("name", "within"), [("HCKF", 0.02), pytest.param("SRPFB", 0.05, marks=pytest.mark.slow)])
def test_moments_are_those_that_are_drawn(name, within):
    rng = np.random.default_rng(1)
    B, u = 400_000, np.array([1.5, 0.2])
    x = rng.multivariate_normal(PRIOR.mean, PRIOR.cov, B)
    w = rng.normal(size=(B, 2)) * np.sqrt(SHARES * 0.5)
    drawn = np.asarray(driven(x.T, 0.5, u, w.T)).T
    predicted = sigmax.run(name, UNICYCLE, PRIOR, np.full((1, 2), np.nan), dt=0.5, inputs=u[None])
    scale = np.sqrt(np.diag(np.cov(drawn.T)))
    assert (np.abs(predicted.mean[0] - drawn.mean(0)) < within * scale).all()
    assert (np.abs(predicted.cov[0] - np.cov(drawn.T)) < within * np.outer(scale, scale)).all()


@pytest.mark.parametrize("name", ["HCKF", "SRPFB", "EKF"])
def test_a_multiplicative_noise_has_its_exact_moments(name):
    """z = x (1 + v₁) + v₂: variance P + (x² + P) σ₁² + σ₂²; first derivatives leave out P σ₁²."""
    model = sigmax.Model(
        motion=lambda x, dt: x, sensor=inside(lambda x, v: x * (1 + v[0]) + v[1], [0.09, 0.5]), Q=[0.0],
        state=("x",), measurement=("z",),
    )  # fmt: skip
    x, P = 3.0, 2.0
    result = sigmax.run(name, model, sigmax.Gaussian([x], [P]), [[4.0]])
    Y = P + (x * x + (P if name != "EKF" else 0)) * 0.09 + 0.5
    np.testing.assert_allclose(result.innovation_cov[0, 0, 0], Y, rtol=1e-9)
    np.testing.assert_allclose(result.mean[0, 0], x + P / Y, rtol=1e-9)
    np.testing.assert_allclose(result.cov[0, 0, 0], P - P * P / Y, rtol=1e-9)


def test_live_batches_functions_of_dt_and_numpy():
    def plain(x, dt, w):
        return np.array([x[0] + dt * x[1] * (1 + w[0]), x[1] + w[1]])

    both = [
        sigmax.Model(motion=inside(plain, noise, size=2), sensor=lambda x: x[:1], R=[0.1], state=("x", "v"))
        for noise in (lambda dt: jnp.diag(jnp.asarray([0.01, 0.04])) * dt, [0.01, 0.04])
    ]
    prior, z = sigmax.Gaussian([0.0, 1.0], np.eye(2)), np.arange(6.0)[:, None]
    one, other = (sigmax.run("SRCKFB", m, prior, z, dt=0.5) for m in both)
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-10)
    live = sigmax.Live("SRCKFB", both[1], prior)
    for value in z:
        live.predict(0.5)
        live.update(value)
    np.testing.assert_allclose(live.cov, other.cov[-1], rtol=1e-10)
    batch = sigmax.run("SRCKFB", both[1], prior, np.stack([z, z + 1]), dt=0.5)
    np.testing.assert_allclose(batch.mean[0], other.mean, rtol=1e-10)


def test_what_does_not_go_is_refused():
    f, h = inside(lambda x, dt, w: x + w, [0.1]), inside(lambda x, v: x + v, [0.1])
    good = dict(motion=f, sensor=h, state=("x",), measurement=("z",))
    for changes, words in (
        ({"Q": [1.0]}, "leave Q out"),
        ({"R": [1.0]}, "leave its R out"),
        ({"motion": lambda x, dt: x}, "needs Q and R"),
        ({"bias": sigmax.Bias(sensor=[[1.0]], prior=sigmax.Gaussian([0.0], [1.0]))}, "without a Bias"),
        ({"sensor": inside(lambda x, v: x + v, lambda dt: dt, size=1)}, "no dt belongs"),
    ):
        with pytest.raises(InputError, match=words):
            sigmax.Model(**good | changes)
    with pytest.raises(InputError, match="size="):
        inside(lambda x, dt, w: x, lambda dt: dt)
    with pytest.raises(InputError, match="the noise inside"):
        inside(lambda x, dt, w: x, [[1.0, 2.0], [2.0, 1.0]])
    model, prior = sigmax.Model(**good), sigmax.Gaussian([0.0], [1.0])
    with pytest.raises(InputError, match="R by row knows noises that are added"):
        sigmax.run("EKF", model, prior, np.zeros((3, 1)), R=np.ones((3, 1)))
    with pytest.raises(InputError, match="R of one measurement"):
        sigmax.Live("EKF", model, prior).update([0.0], R=[1.0])
