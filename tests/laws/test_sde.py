"""Motions in continuous time against other integrators: van Loan's exponential, LSODA, drawn paths."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import sigmax
from sigmax.running import Fault
from tests.laws.problems import made

# What is integrated takes its time to compile.
QUICK = {"EKF", "SRUKFB"}
EACH = [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in sigmax.names()]


def van_loan(F, L, q, dt):
    """Transition matrix and covariance of the noise, of one exponential (van Loan 1978)."""
    n = len(F)
    both = expm(np.block([[-F, (L * q) @ L.T], [np.zeros((n, n)), F.T]]) * dt)
    Phi = both[n:, n:].T
    return Phi, Phi @ both[:n, n:]


rng = np.random.default_rng(0)
F = rng.normal(size=(3, 3))
L, DENSITY = rng.normal(size=(3, 2)), np.array([0.5, 2.0])
PRIOR = sigmax.Gaussian([1.0, -1.0, 0.5], np.diag([0.5, 1.0, 2.0]))


def linear_model(**given):
    motion = sigmax.sde(lambda x: jnp.asarray(F) @ x, L, state=("a", "b", "c"), **given)
    return sigmax.Model(motion=motion, Q=motion.noise(DENSITY), sensor=lambda x: x[:1], R=[1.0])


def check_linear(name, model, dt, backend):
    got = sigmax.run(name, model, PRIOR, np.full((2, 1), np.nan), dt=dt, backend=backend)
    x, P = PRIOR.mean, PRIOR.cov
    for k, step in enumerate(dt):
        Phi, Q = van_loan(F, L, DENSITY, step)
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        assert np.allclose(got.mean[k], x, rtol=1e-10, atol=1e-10)
        assert np.allclose(got.cov[k], P, rtol=1e-10, atol=1e-10 * np.abs(P).max())
    assert got.ok.all()


@pytest.mark.parametrize("name", EACH)
@pytest.mark.one_in(2)
def test_a_linear_equation_is_van_loans_exponential(name):
    check_linear(made(name), linear_model(steps=2), [0.05, 0.2], "native")


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_long_interval_takes_more_steps(backend):
    check_linear("EKF", linear_model(steps=12), [0.5, 1.0], backend)


def pull(x):
    """A pendulum with friction."""
    return jnp.stack([x[1], -jnp.sin(x[0]) * 4 - 0.2 * x[1]])


def spread(x):
    return jnp.stack([jnp.zeros(1), 0.3 + 0.1 * jnp.cos(x[:1])])


def exact(x, P, dt):
    """The moments of Taylor's rule, by another integrator."""

    def field(_, y):
        at, P = y[:2], y[2:].reshape(2, 2)
        A = np.array([[0, 1], [-4 * np.cos(at[0]), -0.2]])
        l = np.array([[0.0], [0.3 + 0.1 * np.cos(at[0])]])
        drift = [at[1], -np.sin(at[0]) * 4 - 0.2 * at[1]]
        return np.concatenate([drift, (A @ P + P @ A.T + l @ l.T).ravel()])

    done = solve_ivp(field, (0, dt), np.concatenate([x, P.ravel()]), "LSODA", rtol=1e-11, atol=1e-12).y[:, -1]
    return done[:2], done[2:].reshape(2, 2)


def pendulum(**given):
    motion = sigmax.sde(pull, spread, state=(sigmax.angle("angle"), "rate"), **given)
    return sigmax.Model(motion=motion, Q=motion.noise(), sensor=lambda x: x[:1], R=[1.0])


@pytest.mark.parametrize("dt", [0.3, 1.0])
def test_taylors_rule_has_the_moments_of_its_equations(dt):
    """The mean along the drift, the covariance by the Lyapunov equation along it: any interval."""
    x, P = np.array([1.0, -0.5]), np.array([[0.05, 0.01], [0.01, 0.1]])
    run = sigmax.run("SREKF", pendulum(steps=6), sigmax.Gaussian(x, P), np.full((1, 1), np.nan), dt=dt)
    mean, cov = exact(x, P, dt)
    assert run.ok.all()
    assert np.allclose(run.mean[0], mean, rtol=1e-8, atol=1e-9)
    assert np.allclose(run.cov[0], cov, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_sigma_points_have_the_moments_of_drawn_paths():
    """Paths of Euler and Maruyama in small steps; the spread of the state bends, and noise is small beside it."""
    rng, dt, small, tracks = np.random.default_rng(1), 0.5, 1e-3, 40000
    prior = sigmax.Gaussian([1.0, -0.5], [0.16, 0.09])
    x = prior.mean + rng.normal(size=(tracks, 2)) * np.sqrt([0.16, 0.09])
    for _ in range(round(dt / small)):
        change = np.column_stack([x[:, 1], -4 * np.sin(x[:, 0]) - 0.2 * x[:, 1]])
        x = x + small * change
        x[:, 1] += (0.3 + 0.1 * np.cos(x[:, 0])) * np.sqrt(small) * rng.normal(size=tracks)
    far = {}
    for name in ("EKF", "GHKF"):
        run = sigmax.run(name, pendulum(steps=6), prior, np.full((1, 1), np.nan), dt=dt)
        far[name] = np.abs(run.mean[0] - x.mean(0)) / x.std(0) * np.sqrt(tracks), np.abs(run.cov[0] / np.cov(x.T) - 1)
    assert far["GHKF"][0].max() < 5
    assert far["GHKF"][1].max() < 0.04
    assert far["EKF"][0].max() > 10


@pytest.mark.parametrize(("steps", "short"), [(1, 0.1), pytest.param(4, 0.4, marks=pytest.mark.slow)])
def test_what_is_not_accurate_is_no_number(steps, short):
    """Where a step is sound its error keeps the tolerance; too long ones are told and leave the state as it was."""
    rng, model, told = np.random.default_rng(0), pendulum(steps=steps), []
    for _ in range(5):
        prior = sigmax.Gaussian(rng.normal([0, 2], 1), [1e-6, 1e-6])
        for dt in (0.1, 0.4, 1.0, 6.0):
            # The first interval is short: one that is too long is refused before the run.
            run = sigmax.run("EKF", model, prior, np.full((2, 1), np.nan), dt=[0.01, dt])
            told.append((dt, run.ok[1]))
            if run.ok[1]:
                mean, _ = exact(run.mean[0], prior.cov, dt)
                gap = (run.mean[1] - mean + np.pi) % (2 * np.pi) - np.pi
                assert np.abs(gap).max() < 1e-5 * dt
            else:
                assert run.fault[1] in (Fault.MOTION_NOT_FINITE, Fault.MOTION_NOISE_INDEFINITE)
                assert np.array_equal(run.mean[1], run.mean[0])
    assert all(ok for dt, ok in told if dt <= short)
    assert not any(ok for dt, ok in told if dt == 6)
    live = sigmax.Live("EKF", model, prior)
    live.predict(6.0)
    assert not live.ok
    with pytest.raises(sigmax.InputError, match=rf"{steps} steps .* too few for an interval of 6 s.*more steps="):
        sigmax.run("EKF", model, prior, np.full((1, 1), np.nan), dt=6.0)


def cart(x, u):
    return jnp.stack([x[1], u[0] - 0.5 * x[1]])


def test_inputs_hold_over_the_interval_and_the_motion_pickles():
    motion = sigmax.sde(cart, [[0.0], [1.0]], state=("place", "speed"))
    model = sigmax.Model(
        motion=motion, Q=motion.noise(0.1), sensor=sigmax.sensors.position(at=(0,), names=("p",)), R=[1.0]
    )
    prior, u = sigmax.Gaussian([0, 1.0], [1, 1]), np.array([[2.0], [-1.0]])
    got = sigmax.run("SRCKF", model, prior, np.full((2, 1), np.nan), dt=0.4, inputs=u)
    A = np.array([[0, 1], [0, -0.5]])
    x, P = prior.mean, prior.cov
    for k in range(2):
        Phi, Q = van_loan(A, np.array([[0.0], [1.0]]), np.array([0.1]), 0.4)
        lifted = expm(np.block([[A, np.array([[0], u[k]])], [np.zeros((1, 3))]]) * 0.4)
        x, P = Phi @ x + lifted[:2, 2], Phi @ P @ Phi.T + Q
        assert np.allclose(got.mean[k], x, rtol=1e-10)
        assert np.allclose(got.cov[k], P, rtol=1e-9)
    copied = pickle.loads(pickle.dumps(model))
    assert np.array_equal(sigmax.run("SRCKF", copied, prior, np.full((2, 1), np.nan), dt=0.4, inputs=u).mean, got.mean)


@pytest.mark.slow
def test_no_time_moves_nothing_and_a_gradient_goes_through():
    model = pendulum()
    prior = sigmax.Gaussian([1.0, 0.3], [0.1, 0.1])
    still = sigmax.run("SRCKF", model, prior, np.full((1, 1), np.nan), dt=0.0)
    assert np.allclose(still.mean[0], prior.mean, rtol=1e-14)
    assert np.allclose(still.cov[0], prior.cov, rtol=1e-12, atol=1e-15)

    def likelihood(q):
        motion = sigmax.sde(pull, spread, state=(sigmax.angle("angle"), "rate"))
        own = sigmax.Model(motion=motion, Q=motion.noise(q[None]), sensor=lambda x: x[:1], R=[0.01])
        return sigmax.run("EKF", own, prior, np.array([[1.0], [0.9], [0.5]]), dt=0.1).log_likelihood

    slope = jax.grad(likelihood)(jnp.asarray(1.0))
    assert np.isclose(slope, (likelihood(jnp.asarray(1.001)) - likelihood(jnp.asarray(0.999))) / 0.002, rtol=1e-4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"steps": 0}, "steps must be a whole number"),
        ({"tolerance": 2.0}, "tolerance is a share"),
        ({"diffusion": [1.0, 2.0]}, "the diffusion is a matrix"),
        ({"diffusion": [[np.inf]]}, "the diffusion must be finite"),
    ],
)
def test_what_does_not_fit_is_a_message(given, words):
    with pytest.raises(sigmax.InputError, match=words):
        sigmax.sde(pull, given.pop("diffusion", [[0.0], [1.0]]), **given)
