"""R of every row: the exact Kalman filter with it, on both engines, in every form; what else takes it."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from tests.laws.problems import APART, DT, TURNING, TURNING_PRIOR, covariance, linear, made, turning_record
from tests.laws.test_linear import gap
from tests.laws.test_time import FLAT, START, WORLDS

FORMS = {sigmax.get(name).form.name: name for name in reversed(sigmax.names())}
QUICK = {*FORMS.values(), "KF"}
EACH = [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in sigmax.names()]


def noises(rng, steps, m=2):
    return np.array([covariance(rng, m, 10 ** rng.uniform(-2, 1)) for _ in range(steps)])


@pytest.mark.parametrize("name", EACH)
def test_every_filter_is_the_kalman_filter_with_the_noise_of_each_row(name):
    """A batch of covariances, each of its own, with holes whose R is not known."""
    p, rng = linear(), np.random.default_rng(0)
    R = np.stack([noises(rng, len(p.z)) for _ in range(3)])
    z = np.stack([p.z, p.z + 1, p.z - 1])
    z[1, 2], z[2, 3, 0] = np.nan, np.nan
    unknown = R.copy()
    unknown[1, 2], unknown[2, 3, 0], unknown[2, 3, :, 0] = np.nan, np.nan, np.nan
    got = sigmax.run(made(name), p.model(), sigmax.Gaussian(p.x0, p.P0), z, dt=DT, R=unknown)
    assert got.ok.all()
    for i in range(3):
        off_mean, off_cov = gap(got.mean[i], got.cov[i], p.exact(z[i], R=R[i]))
        assert off_mean < 1e-9
        assert off_cov < 1e-9


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
def test_variances_covariances_and_batches_are_one(backend):
    p, rng = linear(), np.random.default_rng(1)
    variances = 10 ** rng.uniform(-2, 1, (2, len(p.z), p.m))
    full = variances[..., None] * np.eye(p.m)
    both = np.stack([p.z, p.z])
    prior = sigmax.Gaussian(p.x0, p.P0)

    def mean(z, R):
        return sigmax.run("SRCKFB", p.model(), prior, z, dt=DT, R=R, backend=backend).mean

    wanted = np.array([p.exact(p.z, R=R)[0] for R in full])
    for z, R in ((both, variances), (both, full), (p.z, variances), (p.z, full)):
        assert np.allclose(mean(z, R), wanted, rtol=1e-9)
    for z, R, of in ((both, variances[0], [0, 0]), (both, full[1], [1, 1]), (p.z, variances[1], 1), (p.z, full[0], 0)):
        assert np.allclose(mean(z, R), wanted[of], rtol=1e-9)


def stepped(filter, model, prior, z, u, R):
    live, told = sigmax.Live(filter, model, prior), []
    for k in range(len(u)):
        live.predict(DT, u=u[k])
        for s, rows in z.items():
            said = live.update(rows[k], s or None, R=R[s][k] if s in R else None, u=u[k])
        told.append((live.mean, live.cov, said.nis))
    return (np.array(a) for a in zip(*told, strict=True))


@pytest.mark.parametrize("backend", ["native", pytest.param("xla", marks=pytest.mark.slow)])
def test_it_is_what_live_takes_with_each_measurement(backend):
    """Beside inputs, angles, a bias and a second sensor that keeps its own."""
    z, rng = turning_record(), np.random.default_rng(2)
    prior, u = sigmax.Gaussian(*TURNING_PRIOR), rng.normal(size=(len(z), 1))
    R = noises(rng, len(z)) / 30
    wanted = stepped("SRUKF", TURNING, prior, {"": z}, u, {"": R})
    got = sigmax.run("SRUKF", TURNING, prior, z, dt=DT, inputs=u, R=R, backend=backend)
    for one, other in zip((got.mean, got.cov, got.nis), wanted, strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)
    assert np.array_equal(got.inputs, u)
    apart, own = {"antenna": z[:, :1], "ruler": z[:, 1:]}, {"ruler": rng.uniform(0.01, 0.3, (len(z), 1))}
    wanted = stepped("TSCKF", APART, prior, apart, u, own)
    got = sigmax.run("TSCKF", APART, prior, apart, dt=DT, inputs=u, R=own, backend=backend)
    for one, other in zip((got.mean, got.cov), wanted, strict=False):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["modes", "attitude"])
def test_modes_and_curved_spaces_take_it(name):
    world, rng = WORLDS[name], np.random.default_rng(3)
    steps = 8
    sensor = next(s for s in world.sensors if s != "bearing")
    z = np.array([world.sensors[sensor](rng)[0] for _ in range(steps)])
    z[4] = np.nan
    R = rng.uniform(0.5, 2, z.shape) * world.model.models[0].R[sensor].entries if name == "modes" else None
    R = rng.uniform(0.005, 0.02, z.shape) if R is None else R
    given = np.where(np.isnan(z), np.nan, R)
    got = sigmax.run(world.filter, world.model, world.prior, {sensor: z}, dt=DT, R={sensor: given})
    live = sigmax.Live(world.filter, world.model, world.prior)
    for k in range(steps):
        live.predict(DT)
        live.update(z[k], sensor, R=R[k])
        assert np.allclose(got.mean[k], live.mean, rtol=1e-9)
        assert np.allclose(got.cov[k], live.cov, rtol=1e-9, atol=1e-12)


def test_smoothing_follows_it():
    """The textbook's smoother over the exact filter's moments."""
    p, rng = linear(), np.random.default_rng(4)
    R = noises(rng, len(p.z))
    run = sigmax.run("SRCKF", p.model(), sigmax.Gaussian(p.x0, p.P0), p.z, dt=DT, R=R)
    got = sigmax.smooth("SRCKF", p.model(), run)
    means, covs = p.exact(p.z, R=R)
    x, P = means[-1], covs[-1]
    for k in reversed(range(len(p.z) - 1)):
        ahead = p.A @ covs[k] @ p.A.T + DT * p.Q
        C = covs[k] @ p.A.T @ np.linalg.inv(ahead)
        x, P = means[k] + C @ (x - p.A @ means[k]), covs[k] + C @ (P - ahead) @ C.T
        assert np.allclose(got.mean[k], x, rtol=1e-9, atol=1e-12)
        assert np.allclose(got.cov[k], P, rtol=1e-9, atol=1e-12)


def test_a_fit_takes_it():
    """What is fitted beside it is at the top of the likelihood that `run` gives with it."""
    rng = np.random.default_rng(5)
    x, R = rng.normal(0, 0.5, 200).cumsum(), rng.uniform(0.01, 4, (200, 1))
    z = x[:, None] + rng.normal(size=(200, 1)) * np.sqrt(R)

    def build(parameters):
        return sigmax.Model(
            motion=sigmax.motions.random_walk(("x",)), sensor=lambda x: x, Q=parameters["q"][None], R=[1.0]
        ), sigmax.Gaussian([0.0], [1.0])

    found = sigmax.fit("KF", build, {"q": 1.0}, z, R=R, positive=["q"])
    best = float(found.parameters["q"])
    assert 0.15 < best < 0.4

    def likelihood(q):
        return sigmax.run("KF", *build({"q": np.asarray(q)}), z, R=R).log_likelihood

    assert likelihood(best) == pytest.approx(found.log_likelihood, rel=1e-9)
    assert likelihood(best) > max(likelihood(0.97 * best), likelihood(1.03 * best))


def squares():
    return sigmax.Model(
        motion=sigmax.motions.random_walk(("a", "b")), sensor=lambda x: x, Q=[1, 1], R=[1, 1], measurement=("a", "b")
    )


@pytest.mark.parametrize(
    ("model", "z", "R", "words"),
    [
        (squares(), np.zeros((4, 2)), np.ones((3, 2)), r"R must have the shape \(4, 2\) for variances or \(4, 2, 2\)"),
        (squares(), np.zeros((4, 2)), np.ones(2), "one R for all rows belongs to the model"),
        (squares(), np.zeros((2, 2, 2)), np.ones((2, 2, 2)), "both fit: write the batch of 2 out"),
        (squares(), np.zeros((4, 2)), [[1, 1]] * 3 + [[1, -1]], r"variances at least 0.* it has -1.0 at \[3, 1\]"),
        (squares(), np.zeros((4, 2)), [[1, np.nan]] * 4, r"must be finite.* nan at \[0, 1\]"),
        (squares(), np.zeros((4, 2)), [[[1, 2], [0, 1]]] * 4, "R must be symmetric"),
        (squares(), np.zeros((3, 4, 2)), np.ones((5, 4, 2)), "R must have the shape"),
        (FLAT, {"place": np.zeros((4, 2))}, np.ones((4, 2)), "must be a dict by sensor name"),
        (FLAT, {"place": np.zeros((4, 2))}, {"bearing": np.ones((4, 1))}, "bearing"),
        (sigmax.models.fused(FLAT), {"place": np.zeros((4, 2))}, {"place": np.ones((4, 2))}, "the sensors are fused"),
    ],
)
def test_what_does_not_fit_is_a_message(model, z, R, words):
    prior = START if model.size == 4 else sigmax.Gaussian([0, 0], [1, 1])
    with pytest.raises(sigmax.InputError, match=words):
        sigmax.run("EKF", model, prior, z, R=R)


def test_a_model_by_row_is_compiled_once():
    """Other numbers, other rows: nothing is traced again."""
    traced = []

    def sensor(x):
        traced.append(1)
        return jnp.stack([x[0] * x[1]])

    model = sigmax.Model(motion=sigmax.motions.random_walk(("a", "b")), sensor=sensor, Q=[1, 1], R=[1])
    counts = []
    for k in range(3):
        sigmax.run("EKF", model, sigmax.Gaussian([1, 1], [1, 1]), np.ones((5, 1)), R=np.full((5, 1), 1.0 + k))
        counts.append(len(traced))
    assert counts[1] == counts[2] > 0
