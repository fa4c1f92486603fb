"""Running: live, smoothing, several sensors, and what is refused at the edge."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.filters import names
from tests.laws.problems import DT, TURNING, TURNING_PRIOR, linear, made, turning_record

PRIOR = sigmax.Gaussian(*TURNING_PRIOR)
NO_TURN = np.zeros((6, 1))


@pytest.fixture(scope="module")
def filtered():
    z = turning_record()
    z[2] = np.nan
    return z, sigmax.run("SRCKFB", TURNING, PRIOR, z, dt=DT, inputs=NO_TURN)


@pytest.fixture(scope="module")
def live():
    return sigmax.Live("SRCKFB", TURNING, PRIOR)


def test_live_is_the_record_step_by_step(filtered, live):
    z, record = filtered
    start = live.save()
    for k, row in enumerate(z):
        live.predict(DT, u=[0.0])
        told = live.update(row, u=[0.0])
        assert live.ok
        assert np.allclose(live.mean, record.mean[k], rtol=1e-12, atol=1e-14)
        assert np.allclose(live.cov, record.cov[k], rtol=1e-11, atol=1e-14)
        assert np.isnan(told.nis) == np.isnan(record.nis[k])
    halves = live.mean
    live.restore(start)
    for row in z:
        live.step(row, DT, u=[0.0])
    assert np.allclose(live.mean, halves, rtol=1e-12)


def test_a_saved_state_goes_on_bit_for_bit(live):
    z = turning_record()
    live.step(z[0], DT, u=[0.0])
    saved = live.save()
    live.step(z[1], DT, u=[0.0])
    once = live.mean, live.cov
    other = sigmax.Live("SRCKFB", TURNING, PRIOR)
    other.restore(pickle.loads(pickle.dumps(saved)))
    other.step(z[1], DT, u=[0.0])
    assert np.array_equal(other.mean, once[0])
    assert np.array_equal(other.cov, once[1])
    with pytest.raises(sigmax.InputError, match="no saved state"):
        live.restore(saved[:40])
    with pytest.raises(sigmax.InputError, match="needs"):
        sigmax.Live("EKF", TURNING, PRIOR).restore(saved)


def test_live_takes_another_noise_for_one_measurement(live):
    before = live.save()
    live.update([0.4, 5.0], R=[1e6, 1e6], u=[0.0])
    ignored = live.mean
    live.restore(before)
    assert np.allclose(ignored, live.mean, atol=1e-3)
    live.update([0.4, np.nan], R=[[1e-8, 0], [0, 1]], u=[0.0])
    assert live.mean[0] == pytest.approx(0.4, abs=1e-2)
    for bad, says in (([0.4], "shape"), ([[0.4, 5.0]], "shape")):
        with pytest.raises(sigmax.InputError, match=says):
            live.update(bad, u=[0.0])
    with pytest.raises(sigmax.InputError, match="inputs"):
        live.update([0.4, 5.0])
    with pytest.raises(sigmax.InputError, match="negative"):
        live.predict(-1.0, u=[0.0])
    with pytest.raises(sigmax.InputError, match="semidefinite"):
        live.update([0.4, 5.0], R=[-1.0, 1.0], u=[0.0])
    with pytest.raises(sigmax.InputError, match="it is a function"):
        live.update([0.4, 5.0], R=lambda x: jnp.ones(2), u=[0.0])


def test_live_carries_a_batch():
    p = linear()
    batch = sigmax.Live("SREKFB", p.model(), sigmax.Gaussian(np.stack([p.x0, p.x0 + 1]), p.P0))
    batch.step(np.stack([p.z[0], p.z[1]]), DT)
    assert batch.mean.shape == (2, 3)
    assert batch.cov.shape == (2, 3, 3)
    assert batch.ok.tolist() == [True, True]
    assert np.allclose(batch.std, np.sqrt(np.einsum("bii->bi", batch.cov)))
    alone = sigmax.run("SREKFB", p.model(), sigmax.Gaussian(p.x0, p.P0), p.z[:1], dt=DT)
    assert np.allclose(batch.mean[0], alone.mean[0])
    expected, spread = batch.expect()
    assert expected.shape == (2, 2)
    told = batch.update(expected + 0.1)
    assert np.allclose(told.residual, 0.1)
    assert np.allclose(told.nis, np.einsum("bi,bij,bj->b", told.residual, np.linalg.inv(spread), told.residual))


@pytest.mark.parametrize("name", ["EKF", "SRCKFB", "UIF"])
def test_smoothing_a_linear_model_is_the_posterior_of_the_whole_record(name):
    """Against the joint normal distribution of all states, conditioned on all measurements at once."""
    p = linear()
    z = p.z.copy()
    z[1] = np.nan
    result = sigmax.run(name, p.model(), sigmax.Gaussian(p.x0, p.P0), z, dt=DT)
    got = sigmax.smooth(name, p.model(), result, dt=DT)
    n, T = p.n, len(z)
    mean, cov = [], np.zeros((T * n, T * n))
    x, P = p.x0, p.P0
    for k in range(T):
        x, P = p.A @ x, p.A @ P @ p.A.T + p.Q * DT
        mean.append(x)
        cov[k * n : k * n + n, k * n : k * n + n] = P
        for j in range(k):
            cross = cov[j * n : j * n + n, (k - 1) * n : k * n] @ p.A.T
            cov[j * n : j * n + n, k * n : k * n + n] = cross
            cov[k * n : k * n + n, j * n : j * n + n] = cross.T
    seen = [k for k in range(T) if k != 1]
    H = np.kron(np.eye(T)[seen], p.H)
    S = H @ cov @ H.T + np.kron(np.eye(len(seen)), p.R)
    K = cov @ H.T @ np.linalg.inv(S)
    want = np.concatenate(mean) + K @ (z[seen].ravel() - H @ np.concatenate(mean))
    assert got.ok.all()
    assert np.allclose(got.mean.ravel(), want, atol=1e-9)
    for k in range(T):
        block = (cov - K @ H @ cov)[k * n : k * n + n, k * n : k * n + n]
        assert np.allclose(got.cov[k], block, atol=1e-9)


def test_smoothing_never_knows_less(filtered):
    _, result = filtered
    got = sigmax.smooth("SRCKFB", TURNING, result, dt=DT, inputs=NO_TURN)
    assert (got.std <= result.std * (1 + 1e-9)).all()
    assert np.array_equal(got.mean[-1], result.mean[-1])
    with pytest.raises(sigmax.InputError, match="keep"):
        sigmax.smooth(
            "SRCKFB",
            TURNING,
            sigmax.run("SRCKFB", TURNING, PRIOR, turning_record(), dt=DT, inputs=NO_TURN, keep=["nis"]),
        )


@pytest.mark.parametrize(
    "name", ["EKF", pytest.param("SREUKF", marks=pytest.mark.slow), pytest.param("PIF", marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_the_log_likelihood_differentiates(name):
    """Covariance, signed square root and information form, orders 1 and 2: against differences of the value."""
    z = turning_record(3)

    @jax.jit
    @jax.value_and_grad
    def value(q):
        model = sigmax.Model(
            motion=TURNING.motion, sensor=TURNING.sensors[""], Q=q * jnp.asarray(TURNING.Q), R=TURNING.R[""],
            state=TURNING.state, measurement=TURNING.measurement[""],
        )  # fmt: skip
        return sigmax.run(made(name), model, PRIOR, z, dt=DT, inputs=NO_TURN[:3], keep=[]).log_likelihood

    (above, _), (below, _), (_, exact) = (value(q) for q in (1.3 + 1e-5, 1.3 - 1e-5, 1.3))
    assert float(exact) == pytest.approx(float(above - below) / 2e-5, rel=1e-5)


def test_several_sensors_come_and_go():
    """Two sensors at their own rates give what one record of both gives; what nobody reports costs nothing."""
    p = linear()
    model = sigmax.Model(
        motion=p.motion,
        sensor={"a": lambda x: p.sensor(x)[:1], "b": lambda x: p.sensor(x)[1:]},
        Q=p.Q,
        R={"a": p.R[:1, :1], "b": p.R[1:, 1:]},
        state=["x0", "x1", "x2"],
    )
    prior = sigmax.Gaussian(p.x0, p.P0)
    together = sigmax.run("EKF", p.model(R=np.diag(np.diagonal(p.R))), prior, p.z, dt=DT)
    apart = sigmax.run("EKF", model, prior, {"a": p.z[:, :1], "b": p.z[:, 1:]}, dt=DT)
    assert np.allclose(apart.mean, together.mean, atol=1e-10)
    assert np.allclose(apart.log_likelihood, together.log_likelihood)
    assert apart.innovation["a"].shape == (6, 1)
    only = sigmax.run("EKF", model, prior, {"a": p.z[:, :1]}, dt=DT)
    assert only.dof.tolist() == [1] * 6


def test_times_inputs_and_noises_of_every_kind():
    """Q(dt), Q(x, dt), Q(x, dt, u), R(x), R(x, u), dt by step and by track: constants written as functions agree."""
    p = linear()
    dts = np.array([0.0, 0.5, 2.0, 0.1, 0.7, 0.7])
    prior = sigmax.Gaussian(np.stack([p.x0, p.x0]), p.P0)
    z = np.stack([p.z, p.z[::-1]])
    want = sigmax.run("SREKF", p.model(), prior, z, dt=np.stack([dts, dts[::-1]]))
    inputs = np.ones((6, 2))
    for Q, R in (
        (lambda dt: jnp.asarray(p.Q) * dt, lambda x: jnp.asarray(p.R)),
        (lambda x, dt: jnp.asarray(p.Q) * dt, lambda x, u: jnp.asarray(p.R) * u[0]),
        (lambda x, dt, u: jnp.asarray(p.Q) * dt * u[1], lambda x: jnp.asarray(p.R) + 0 * x[0]),
    ):
        model = sigmax.Model(motion=p.motion, sensor=p.sensor, Q=Q, R=R, state=["a", "b", "c"], measurement=["u", "v"])
        given = inputs if model.motion_driven or model.sensor_driven("") else None
        got = sigmax.run("SREKF", model, prior, z, dt=np.stack([dts, dts[::-1]]), inputs=given)
        assert np.allclose(got.mean, want.mean, atol=1e-10)
        assert np.allclose(got.cov, want.cov, atol=1e-10)
    assert np.isfinite(want.mean).all()


def test_a_large_batch_is_dealt_to_the_cores():
    p = linear(1, 1)
    rng = np.random.default_rng(0)
    z = rng.standard_normal((1001, 2, 1))
    got = sigmax.run("EKF", p.model(), sigmax.Gaussian(p.x0, p.P0), z, dt=DT)
    some = sigmax.run("EKF", p.model(), sigmax.Gaussian(p.x0, p.P0), z[[0, 500, 501, 1000]], dt=DT)
    assert got.mean.shape == (1001, 2, 1)
    assert np.allclose(got.mean[[0, 500, 501, 1000]], some.mean, rtol=1e-12)
    assert np.allclose(got.log_likelihood[[0, 500, 501, 1000]], some.log_likelihood)


REFUSED = {
    "z of one axis": (dict(z=np.zeros(6)), r"z\[:, None\]"),
    "columns": (dict(z=np.zeros((6, 3))), "3 columns, the sensor 2"),
    "a dict for one sensor": (dict(z={"a": np.zeros((6, 2))}), "array"),
    "text": (dict(z=np.array([["a", "b"]] * 6)), "real numbers"),
    "no steps": (dict(z=np.zeros((0, 2))), "no time steps"),
    "batches": (dict(z=np.zeros((4, 6, 2)), prior=sigmax.Gaussian(np.zeros((3, 3)), np.eye(3))), "differ in size"),
    "backwards": (dict(dt=[1, 1, -0.5, 1, 1, 1]), "backwards at step 2"),
    "dt of another length": (dict(dt=[1, 1]), "6 steps"),
    "dt NaN": (dict(dt=np.nan), "finite"),
    "missing inputs": (dict(inputs=None), "give inputs="),
    "inputs of one axis": (dict(inputs=np.zeros(6)), r"inputs\[:, None\]"),
    "prior": (dict(prior=sigmax.Gaussian([0.0], [1.0])), "1 components, the model 3"),
    "filter": (dict(filter=3), "SRCKFB"),
    "name": (dict(filter="SRCFKB"), "did you mean"),
    "dtype": (dict(dtype="int32"), "float64 or float32"),
    "keep": (dict(keep=["means"]), "did you mean mean"),
    "model": (dict(model=3), "sigmax.Model"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_in_words(case):
    changes, says = REFUSED[case]
    given = dict(filter="EKF", model=TURNING, prior=PRIOR, z=turning_record(), dt=DT, inputs=NO_TURN) | changes
    filter, model, prior, z = (given.pop(k) for k in ("filter", "model", "prior", "z"))
    with pytest.raises(sigmax.InputError, match=says):
        sigmax.run(filter, model, prior, z, **given)


def parts(**changes):
    return dict(motion=lambda x, dt: x, sensor=lambda x: x[:1], Q=np.eye(2), R=[1.0], state=("a", "b")) | changes


WRONG_MODELS = {
    "asymmetric": (parts(Q=[[1, 0.5], [0, 1]]), r"symmetric; entries \[0, 1\]"),
    "indefinite": (parts(Q=[[1, 2], [2, 1]]), "eigenvalue -1"),
    "NaN": (parts(R=[[np.nan]]), "finite"),
    "shape": (parts(Q=np.eye(3)), "shape"),
    "negative variance": (parts(R=[-1.0]), "semidefinite"),
    "names twice": (parts(state=("a", "a")), "twice"),
    "no function": (parts(motion=3), "function"),
    "arguments": (parts(sensor=lambda x, u, v: x), "positional arguments"),
    "R for several": (parts(sensor={"s": lambda x: x[:1]}), "dict by sensor"),
    "R of an unknown sensor": (parts(sensor={"s": lambda x: x[:1]}, R={"t": [1.0]}), "no entry for the sensor 's'"),
    "counted from nothing": (parts(state=None, Q=lambda dt: np.eye(2)), "name the components"),
}


@pytest.mark.parametrize("case", WRONG_MODELS)
def test_a_model_that_does_not_fit_is_refused(case):
    given, says = WRONG_MODELS[case]
    with pytest.raises(sigmax.InputError, match=says):
        sigmax.Model(**given)


def test_functions_that_give_the_wrong_shape_are_found_before_the_run():
    prior = sigmax.Gaussian([0.0, 0], np.eye(2))
    for changes, says in (
        ({"motion": lambda x, dt: x[:1]}, r"motion must return the 2 components \['a', 'b'\]"),
        ({"sensor": lambda x: x}, "sensor must return the 1 components"),
        ({"Q": lambda dt: jnp.eye(3)}, "shape"),
        ({"R": lambda x: jnp.array([[-1.0]]), "measurement": ("m",)}, "semidefinite"),
    ):
        with pytest.raises(sigmax.InputError, match=says):
            sigmax.run("EKF", sigmax.Model(**parts(**changes)), prior, np.zeros((3, 1)))
    with pytest.raises(ZeroDivisionError) as caught:
        sigmax.run("EKF", sigmax.Model(**parts(sensor=lambda x: x[:1] / (1 // 0))), prior, np.zeros((3, 1)))
    assert "evaluating sensor" in "".join(caught.value.__notes__)


@pytest.mark.parametrize(
    ("mean", "cov", "says"),
    [
        ([0.0, np.nan], np.eye(2), "mean must be finite"),
        ([0.0, 0], [[1, np.inf], [np.inf, 1]], "covariance must be finite"),
        ([0.0, 0], [[1, 0.5], [0.4, 1]], "symmetric"),
        ([0.0, 0], [[1, 2], [2, 1]], "semidefinite"),
        ([0.0, 0], np.eye(3), "shape"),
        ("north", np.eye(2), "real numbers"),
    ],
)
def test_a_prior_that_is_none_is_refused(mean, cov, says):
    with pytest.raises(sigmax.InputError, match=says):
        sigmax.Gaussian(mean, cov)


def test_one_model_compiles_once():
    """New numbers in Q, R, prior or record find the compiled filter again: the motion is not traced anew."""
    traces = []

    def motion(x, dt):
        traces.append(x)
        return p.motion(x, dt)

    p = linear()
    sensor = p.sensor  # one object: a new one would be a new model
    sigmax.run("SKF", sigmax.Model(motion=motion, sensor=sensor, Q=p.Q, R=p.R), sigmax.Gaussian(p.x0, p.P0), p.z)
    before = len(traces)
    for size in (2.0, 3.0):
        model = sigmax.Model(motion=motion, sensor=sensor, Q=p.Q * size, R=p.R * size)
        sigmax.run("SKF", model, sigmax.Gaussian(p.x0 + size, p.P0), p.z + size, dt=size)
    assert len(traces) == before


@pytest.mark.parametrize("name", names())
def test_a_filter_of_the_catalogue_is_equal_to_its_pickled_copy(name):
    made = sigmax.get(name)
    copied = pickle.loads(pickle.dumps(made))
    assert copied == made
    assert hash(copied) == hash(made)
    # With so many biases too, which are compiled once for both.
    assert copied.form.on(2) is made.form.on(2) or made.form.biased is None
    assert pickle.loads(pickle.dumps(made.form.on(2))).name == made.form.on(2).name


@pytest.mark.parametrize("name", ["TSCIF", "TSHCIF"])
def test_so_is_one_with_parameters(name):
    made = sigmax.get(name, information="paper")
    copied = pickle.loads(pickle.dumps(made))
    assert copied == made
    assert copied != sigmax.get(name)


@pytest.mark.parametrize("name", ["EIF", "SREIF", "SRCKFB", "TSCIF"])
def test_the_information_pair_is_that_of_the_covariance(name):
    """Against NumPy's inverse; batches, live, and with a bias in the filter, which is not in the pair."""
    rng = np.random.default_rng(5)
    walk = sigmax.motions.constant_velocity()
    bias = sigmax.Bias(sensor=np.eye(2), prior=sigmax.Gaussian([0.0, 0.0], [4.0, 4.0]))
    model = sigmax.Model(
        motion=walk,
        sensor=lambda x: x[:2],
        Q=walk.noise(0.1),
        R=[1.0, 2.0],
        bias=bias if name.startswith("TS") else None,
    )
    z = rng.normal(size=(3, 6, 2))
    prior = sigmax.Gaussian(np.zeros(4), np.eye(4))
    found = sigmax.run(name, model, prior, z)
    y, Y = found.information
    np.testing.assert_allclose(Y, np.linalg.inv(found.cov), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.einsum("btij,btj->bti", found.cov, y), found.mean, atol=1e-9)
    live = sigmax.Live(name, model, prior)
    for one in z[0]:
        live.step(one, 1.0)
    np.testing.assert_allclose(live.information[0], y[0, -1], rtol=1e-9)
    np.testing.assert_allclose(live.information[1], Y[0, -1], rtol=1e-9)
