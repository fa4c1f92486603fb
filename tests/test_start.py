"""Where the prior stands: one step before the first measurement, or at it, whatever the motion."""

import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax import motions, sensors

F = np.array([[0.8, 0.1], [-0.2, 0.9]])
PRIOR = sigmax.Gaussian([1.0, -1.0], [[10.0, 2.0], [2.0, 4.0]])
Q, R = np.diag([0.3, 0.2]), 0.7
Z = np.array([[2.0], [1.0], [np.nan], [3.0], [2.5]])


def discrete(**changes):
    """A motion from step to step, whatever dt says, with inputs and a noise of the whole step."""
    given = dict(motion=moved, sensor=lambda x: x[:1], Q=lambda dt: jnp.asarray(Q), R=[R], state=("a", "b"))
    return sigmax.Model(**given | changes)


def moved(x, dt):
    return jnp.asarray(F) @ x


MODEL = discrete()


def by_hand(z, model_F=F, cov=PRIOR.cov, mean=PRIOR.mean):
    """The Kalman filter and smoother written out: filtered, then smoothed, the first measurement without a motion."""
    x, P = np.asarray(mean), np.asarray(cov)
    filtered, before, total = [], [], 0.0
    for k, value in enumerate(z[:, 0]):
        if k:
            x, P = model_F @ x, model_F @ P @ model_F.T + Q
        before.append((x, P))
        if not np.isnan(value):
            s = P[0, 0] + R
            total -= 0.5 * ((value - x[0]) ** 2 / s + np.log(2 * np.pi * s))
            x, P = x + P[:, 0] * (value - x[0]) / s, P - np.outer(P[:, 0], P[0]) / s
        filtered.append((x, P))
    smoothed = [filtered[-1]]
    for (x, P), (x_next, P_next) in zip(filtered[-2::-1], before[:0:-1], strict=True):
        G = P @ model_F.T @ np.linalg.inv(P_next)
        smoothed.append((x + G @ (smoothed[-1][0] - x_next), P + G @ (smoothed[-1][1] - P_next) @ G.T))
    return filtered, smoothed[::-1], total


DT = {"a number": 1.0, "as many": np.ones(5), "one less": np.ones(4), "the first missing": [np.nan, 1, 1, 1, 1]}


@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("name", ["EKF", "SREKFB", "EIF"])
@pytest.mark.parametrize("kind", DT)
@pytest.mark.one_in(2)
def test_a_prior_at_the_first_measurement_is_not_moved(name, backend, kind):
    filtered, smoothed, total = by_hand(Z)
    got = sigmax.run(name, MODEL, PRIOR, Z, dt=DT[kind], update_first=True, backend=backend)
    back = sigmax.smooth(name, MODEL, got, dt=DT[kind], backend=backend)
    assert got.ok.all()
    assert back.ok.all()
    assert got.log_likelihood == pytest.approx(total)
    for k in range(len(Z)):
        for record, want in ((got, filtered), (back, smoothed)):
            np.testing.assert_allclose(record.mean[k], want[k][0], atol=1e-9)
            np.testing.assert_allclose(record.cov[k], want[k][1], atol=1e-9)


def test_a_batch_begins_so_too_and_a_live_filter_with_an_update():
    filtered, _, _ = by_hand(Z)
    batch = sigmax.run("EKF", MODEL, PRIOR, np.stack([Z] * 3), dt=np.ones((3, 4)), update_first=True)
    np.testing.assert_allclose(batch.mean[1], [x for x, _ in filtered], atol=1e-9)
    live = sigmax.Live("EKF", MODEL, PRIOR)
    live.update(Z[0])
    for z in Z[1:]:
        live.step(z, 1.0)
    np.testing.assert_allclose(live.mean, filtered[-1][0], atol=1e-9)


def test_an_interval_of_zero_is_an_interval_like_any_other():
    """The motion is called with dt = 0: one from step to step moves all the same."""
    got = sigmax.run("EKF", MODEL, PRIOR, Z, dt=[0.0, 1, 1, 1, 1])
    want = sigmax.run("EKF", MODEL, PRIOR, Z, dt=1.0)
    np.testing.assert_allclose(got.mean, want.mean)


@pytest.mark.parametrize("name", ["constant_velocity", "singer", "coordinated_turn_cartesian"])
def test_where_motions_follow_time_it_is_an_interval_of_zero(name):
    motion = getattr(motions, name)()
    n = len(motion.state)
    noise = motion.noise(0.3, 0.1) if n == 5 else motion.noise(0.3)
    model = sigmax.Model(motion=motion, sensor=sensors.position(), Q=noise, R=[1.0, 2.0])
    prior = sigmax.Gaussian(np.arange(n) / 2, np.eye(n))
    z = np.array([[0.1, 0.2], [0.3, 0.1], [0.5, 0.9]])
    got = sigmax.run("CKF", model, prior, z, dt=[0.5, 2.0], update_first=True)
    want = sigmax.run("CKF", model, prior, z, dt=[0.0, 0.5, 2.0])
    np.testing.assert_allclose(got.mean, want.mean, atol=1e-9)
    np.testing.assert_allclose(got.cov, want.cov, atol=1e-9)


def test_parameters_of_such_a_record_are_fitted():
    def build(parameters):
        f = parameters["f"]
        return discrete(motion=lambda x, dt: jnp.stack([f * x[0] + 0.1 * x[1], -0.2 * x[0] + 0.9 * x[1]])), PRIOR

    found = sigmax.fit("EKF", build, {"f": 0.5}, Z, dt=np.ones(4), update_first=True)
    grid = np.linspace(-1.5, 1.5, 3001)
    best = grid[np.argmax([by_hand(Z, np.array([[f, 0.1], [-0.2, 0.9]]))[2] for f in grid])]
    assert float(found.parameters["f"]) == pytest.approx(best, abs=2e-3)


def test_a_described_record_begins_at_its_first_row(tmp_path):
    """Its prior stands there, and a function of the user's that moves by steps is not called before."""
    from sigmax.records.load import load
    from sigmax.records.tracking import track

    (tmp_path / "steps.py").write_text("def step(x, dt):\n    return 0.8 * x\n")
    (tmp_path / "data.csv").write_text("t,z\n0,2\n1,1\n2,3\n")
    (tmp_path / "record.toml").write_text(
        'data = "data.csv"\ntime = "t"\nfilters = ["EKF"]\n'
        '[motion]\nkind = "steps.py:step"\nstate = { a = "m" }\nnoise = [[0.1]]\n'
        '[sensors.s]\nkind = "position"\nat = ["a"]\ncolumns = { a = "z" }\nnoise = { a = 1 }\n'
        "[prior.a]\nmean = 0\nstd = 3.1622776601683795\n"
    )
    record = load(str(tmp_path / "record.toml"))
    result = track(record, record.trials[0]).result
    assert result.mean[0, 0, 0] == pytest.approx(2 * 10 / 11)
