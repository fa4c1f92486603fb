"""Compiled steps against XLA over catalogue and models, and against themselves: batch, loop and live alike."""

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.models.builtin import BUILTIN, builtin

STEPS = 50
EPS = np.finfo(float).eps


def record(name, tracks=3, steps=STEPS, seed=0):
    """Measurements simulated from the prior's mean, some missing whole or in part."""
    made = builtin(name)
    rng = np.random.default_rng(seed)
    u = None if made.inputs is None else np.repeat(made.inputs[None], steps, 0)
    given = () if u is None else (u[0],)
    (h,) = made.model.sensors.values()
    R = np.asarray(made.model.R[""].entries)

    def step(x, _):
        x = made.model.motion(x, made.dt, *given[: made.model.motion_inputs])
        return x, h(x, *given[: made.model.sensor_inputs[""]])

    _, seen = jax.lax.scan(step, jnp.asarray(made.prior.mean), None, steps)
    z = np.asarray(seen) + np.sqrt(R) * rng.standard_normal((tracks, steps, len(R)))
    z[:, 7] = np.nan
    z[0, 11, 0] = np.nan
    return made, z, u


def pairs(many):
    """Every filter with one model, every model with several filters; or a third of all pairs that make sense."""
    fitting = [
        (f, m)
        for (i, f), (j, m) in itertools.product(enumerate(sigmax.names()), enumerate(BUILTIN))
        if (not many or (i + j) % 3 == 0)
        and (f not in ("KF", "SKF") or builtin(m).linear)
        # Three points an axis are thousands in seven axes.
        and not (f.startswith(("GH", "SRGH")) and builtin(m).model.size > 5)
    ]
    if many:
        return fitting
    models = list(BUILTIN)
    turned = [(f, models[(k + j) % len(models)]) for k, f in enumerate(sigmax.names()) for j in range(len(models))]
    # Small models in the quick tests, and the smallest for what has n² points or derivatives and more.
    limit = {f: 4 if any(kind in f for kind in ("HC", "GH", "TK")) else 5 for f in sigmax.names()}
    light = [(f, m) for f, m in turned if (f, m) in fitting and builtin(m).model.size <= limit[f]]
    chosen = dict(reversed(light))
    return sorted(
        {
            *chosen.items(),
            ("KF", "position-cv"),
            ("SRCKFB", "radar-ct"),
            ("SRCKFB", "radar-ca"),
            ("SREKFB", "rover-beacon"),
        }
    )


def apart(name, filter):
    """The largest difference of the engines in standard deviations, less what the last bits of the state make."""
    made, z, u = record(name)
    given = filter, made.model, made.prior, z
    a, b = (sigmax.run(*given, dt=made.dt, inputs=u, backend=backend) for backend in ("native", "xla"))
    assert np.array_equal(a.fault, b.fault)
    assert np.array_equal(a.dof, b.dof)
    assert np.array_equal(np.isnan(a.innovation), np.isnan(b.innovation))
    np.testing.assert_allclose(a.nis, b.nis, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(a.log_likelihood, b.log_likelihood, rtol=1e-8, atol=1e-7)
    spread = np.sqrt(np.einsum("...ii->...i", b.innovation_cov))
    unit = np.maximum(spread[..., :, None] * spread[..., None, :], 1e-300)
    assert np.abs((a.innovation_cov - b.innovation_cov) / unit).max() < 1e-9
    sigma = b.std
    usual = 64 * EPS * np.abs(b.mean).max() / sigma
    means = np.abs(a.mean - b.mean) / sigma - usual
    covs = np.abs(a.cov - b.cov) / (sigma[..., :, None] * sigma[..., None, :]) - usual.max()
    return max(means.max(), covs.max())


@pytest.mark.parametrize(("filter", "name"), pairs(many=False))
@pytest.mark.one_in(7)
def test_the_engines_agree(filter, name):
    assert apart(name, filter) < 1e-11


def test_xla_as_users_have_it_agrees_too():
    """In a process of its own: the tests around ask XLA not to be quick."""
    code = "from tests.native.test_engine import apart; assert apart('rover-beacon', 'SREKFB') < 1e-11"
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=Path(__file__).parents[2], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("filter", "name"), [p for p in pairs(many=True) if p not in pairs(many=False)])
def test_the_engines_agree_on_many_pairs(filter, name):
    assert apart(name, filter) < 1e-11


@pytest.mark.parametrize("filter", ["SRCKFB", "EKF", "EIF", "SREUKFB"])
@pytest.mark.parametrize(
    ("name", "dtype"), [("radar-ct", "float64"), ("radar-ct", "float32"), ("radar-offset", "float64")]
)
@pytest.mark.one_in(2)
def test_batch_loop_and_live_are_alike_bit_for_bit(filter, name, dtype):
    if dtype == "float32" and filter in ("EKF", "EIF"):
        pytest.skip("the covariance and information forms need double precision here")
    made, z, _ = record(name, tracks=19, steps=12)
    batch = sigmax.run(filter, made.model, made.prior, z, dt=made.dt, dtype=dtype, backend="native")
    for k in (0, 7, 8, 18):
        alone = sigmax.run(filter, made.model, made.prior, z[k], dt=made.dt, dtype=dtype, backend="native")
        for part in ("mean", "factor", "nis", "innovation", "fault", "dof", "step_log_likelihood"):
            assert np.array_equal(getattr(alone, part), getattr(batch, part)[k], equal_nan=True), part
    for halves in (False, True):
        live = sigmax.Live(filter, made.model, made.prior, dtype=dtype, backend="native")
        for t in range(12):
            if halves:
                live.predict(made.dt)
                told = live.update(z[0, t])
            else:
                told = live.step(z[0, t], made.dt)
            assert np.array_equal(live.mean, batch.mean[0, t])
            assert np.array_equal(live.cov, batch.cov[0, t])
            assert np.array_equal(told.residual, batch.innovation[0, t], equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize(("filter", "name"), pairs(many=True))
def test_live_is_the_batch_bit_for_bit_on_many_pairs(filter, name):
    made, z, u = record(name)
    batch = sigmax.run(filter, made.model, made.prior, z, dt=made.dt, inputs=u, backend="native")
    live = sigmax.Live(filter, made.model, made.prior, backend="native")
    for t in range(STEPS):
        told = live.step(z[0, t], made.dt, u=None if u is None else u[t])
        assert np.array_equal(live.mean, batch.mean[0, t])
        assert np.array_equal(live.cov, batch.cov[0, t])
        assert np.array_equal(told.nis, batch.nis[0, t], equal_nan=True)
        assert told.log_likelihood == batch.step_log_likelihood[0, t]


def test_each_track_may_have_its_own_prior_times_and_inputs():
    made, z, u = record("rover-beacon", tracks=5)
    rng = np.random.default_rng(1)
    dt = rng.uniform(0.1, 1.0, (5, STEPS))
    prior = sigmax.Gaussian(np.asarray(made.prior.mean) + 0.1 * rng.standard_normal((5, 4)), made.prior.cov)
    inputs = np.repeat(u[None], 5, 0) * rng.uniform(0.9, 1.1, (5, STEPS, 1))
    batch = sigmax.run("SRCKFB", made.model, prior, z, dt=dt, inputs=inputs, backend="native")
    for k in range(5):
        own = sigmax.Gaussian(prior.mean[k], made.prior.cov)
        alone = sigmax.run("SRCKFB", made.model, own, z[k], dt=dt[k], inputs=inputs[k], backend="native")
        assert np.array_equal(alone.mean, batch.mean[k])
        assert np.array_equal(alone.cov, batch.cov[k])


@pytest.mark.parametrize(
    ("filter", "name"),
    [("SRUKFB", "radar-ct"), ("EKF", "rover-beacon"), pytest.param("CIF", "radar-ca", marks=pytest.mark.slow)],
)
@pytest.mark.one_in(2)
def test_smoothing_agrees(filter, name):
    made, z, u = record(name)
    result = sigmax.run(filter, made.model, made.prior, z, dt=made.dt, inputs=u, backend="native")
    a, b = (
        sigmax.smooth(filter, made.model, result, dt=made.dt, inputs=u, backend=backend)
        for backend in ("native", "xla")
    )
    assert np.array_equal(a.fault, b.fault)
    usual = 64 * EPS * np.abs(b.mean).max() / b.std
    assert (np.abs(a.mean - b.mean) / b.std - usual).max() < 1e-9
    np.testing.assert_allclose(a.std, b.std, rtol=1e-7)
    alone = sigmax.run(filter, made.model, made.prior, z[1], dt=made.dt, inputs=u, backend="native")
    one = sigmax.smooth(filter, made.model, alone, dt=made.dt, inputs=u, backend="native")
    assert np.array_equal(one.mean, a.mean[1])


def test_a_failing_track_leaves_its_neighbours_alone():
    def motion(x, dt):
        return jnp.stack([x[0] + dt * x[1], x[1]]) / jnp.where(x[0] > 50, 0.0, 1.0)

    model = sigmax.Model(motion=motion, sensor=lambda x: x[:1], Q=[0.1, 0.1], R=[1.0], state=("x", "v"))
    mean = np.zeros((11, 2))
    mean[4] = 45.0, 3.0
    z = np.zeros((11, 6, 1))
    z[4] = 60.0
    priors = sigmax.Gaussian(mean, np.eye(2))
    results = [sigmax.run("SRUKFB", model, priors, z, backend=backend) for backend in ("native", "xla")]
    for result in results:
        assert result.ok[[k for k in range(11) if k != 4]].all()
        assert not result.ok[4].all()
    assert np.array_equal(results[0].fault, results[1].fault)
    healthy = sigmax.run("SRUKFB", model, sigmax.Gaussian(mean[:1], np.eye(2)), z[:1], backend="native")
    assert np.array_equal(healthy.mean[0], results[0].mean[3])


def test_several_sensors_agree_and_one_that_is_silent_is_skipped():
    model = sigmax.Model(
        motion=lambda x, dt: jnp.stack([x[0] + dt * x[1], x[1]]),
        sensor={"near": lambda x: jnp.stack([x[0], x[0] * x[1]]), "far": lambda x: jnp.sqrt(1 + x[:1] ** 2)},
        Q=[0.1, 0.1],
        R={"near": [0.5, 0.5], "far": [0.2]},
        state=("x", "v"),
    )
    rng = np.random.default_rng(0)
    z = {"near": rng.standard_normal((9, 20, 2)), "far": 1 + rng.uniform(0, 1, (9, 20, 1))}
    z["near"][:, 1::2] = np.nan
    z["far"][3] = np.nan
    prior = sigmax.Gaussian([0.5, 1.0], np.eye(2))
    a, b = (sigmax.run("SRCKFB", model, prior, z, backend=backend) for backend in ("native", "xla"))
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(a.nis, b.nis, rtol=1e-8)
    assert np.array_equal(a.dof, b.dof)
    for sensor in z:
        np.testing.assert_allclose(a.innovation_cov[sensor], b.innovation_cov[sensor], rtol=1e-8, atol=1e-12)
    alone = {s: v[3] for s, v in z.items()}
    single = sigmax.run("SRCKFB", model, prior, alone, backend="native")
    assert np.array_equal(single.mean, a.mean[3])
    assert np.array_equal(single.innovation_cov["far"], a.innovation_cov["far"][3])


def test_numbers_of_the_noise_are_no_reason_to_compile_again(monkeypatch):
    made, z, _ = record("radar-ct", tracks=1)
    sigmax.run("SREKFB", made.model, made.prior, z, backend="native")
    monkeypatch.setattr("sigmax.engine.lowered.steps", None)
    other = sigmax.Model(
        motion=made.model.motion,
        sensor=made.model.sensors[""],
        Q=2 * made.model.Q.entries,
        R=3 * made.model.R[""].entries,
        state=made.model.state,
        measurement=made.model.measurement[""],
    )
    a, b = (sigmax.run("SREKFB", other, made.prior, z, backend=backend) for backend in ("native", "xla"))
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-9)


def test_a_saved_state_moves_between_the_engines():
    made, z, _ = record("radar-ct", tracks=1)
    lives = [sigmax.Live("EIF", made.model, made.prior, backend=backend) for backend in ("native", "xla")]
    for t in range(5):
        lives[0].step(z[0, t], made.dt)
    lives[1].restore(lives[0].save())
    assert np.array_equal(lives[0].mean, lives[1].mean)
    for live in lives:
        live.step(z[0, 5], made.dt)
    np.testing.assert_allclose(lives[0].mean, lives[1].mean, rtol=1e-10)


@pytest.mark.slow
def test_large_models_compile_in_pieces():
    n, m = 12, 4

    def motion(x, dt):
        return x + 0.1 * dt * jnp.sin(jnp.roll(x, -1)) * jnp.cos(x)

    def sensor(x):
        return jnp.sqrt(1 + x[:m] ** 2)

    model = sigmax.Model(motion=motion, sensor=sensor, Q=np.full(n, 0.01), R=np.full(m, 0.1))
    z = 1 + np.abs(np.random.default_rng(0).standard_normal((2, 5, m)))
    a, b = (
        sigmax.run("SREKFB", model, sigmax.Gaussian(np.ones(n), np.eye(n)), z, backend=backend)
        for backend in ("native", "xla")
    )
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(a.cov, b.cov, rtol=1e-9, atol=1e-12)


def test_a_forked_process_has_threads_of_its_own():
    made, z, _ = record("radar-ct", tracks=4000, steps=12)

    def run():
        return sigmax.run("SRCKFB", made.model, made.prior, z, dt=made.dt, backend="native").mean

    here = run()
    # Enough work that every thread was started; idle ones are what a fork leaves behind without noticing.
    time.sleep(0.2)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        os.write(writing, run().tobytes())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        there = pipe.read()
    assert os.waitpid(child, 0)[1] == 0
    assert there == here.tobytes()
