"""Laws of updates: straight sensors change nothing, Taylor rules give the textbook's IEKF, outliers weigh little."""

from dataclasses import dataclass, replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import sigmax
from sigmax.filters import WEIGHTS, Update, Weighed, named
from tests.laws.problems import APART, DT, TURNING, TURNING_PRIOR, linear, scaled_gap, textbook, turning_record

UPDATES = {
    "once": sigmax.once,
    "iterated": sigmax.iterated(3),
    "unguarded": sigmax.iterated(2, guarded=False),
    **{kind: sigmax.robust(kind) for kind in WEIGHTS},
    **{f"iterated {kind}": sigmax.robust(kind, sigmax.iterated(2)) for kind in WEIGHTS},
}
FIVE = ("EKF", "SREKF", "SREKFB", "EIF", "SREIF")
BEACONS = np.array([[0.0, 0.0], [0.0, 10.0]])
PRIOR = sigmax.Gaussian([6.0, 2.0, 0.0, 0.0], [4.0, 4.0, 0.1, 0.1])
RADAR_R = np.array([0.05**2, np.deg2rad(0.5) ** 2])


def radar(x):
    return jnp.stack([jnp.hypot(x[0], x[1]), jnp.arctan2(x[1], x[0])])


def bearings(x):
    return jnp.stack([jnp.arctan2(x[1] - b[1], x[0] - b[0]) for b in BEACONS])


def straight_on(x, dt):
    return jnp.stack([x[0] + x[2] * dt, x[1] + x[3] * dt, x[2], x[3]])


def model(sensor, R, angles):
    noise = 1e-3 * np.array([[1 / 3, 0, 1 / 2, 0], [0, 1 / 3, 0, 1 / 2], [1 / 2, 0, 1, 0], [0, 1 / 2, 0, 1]])
    names = [sigmax.angle(f"z{i}") if turns else f"z{i}" for i, turns in enumerate(angles)]
    return sigmax.Model(
        motion=straight_on, sensor=sensor, Q=noise, R=R, state=("x", "y", "vx", "vy"), measurement=names
    )


RADAR = model(radar, RADAR_R, (False, True))
BEARINGS = model(bearings, np.full(2, np.deg2rad(0.5) ** 2), (True, True))


def drawn(model, R, tracks, steps, seed, outliers=0.0):
    """Truths and measurements of a model of four components, a share of the noises being twenty times as large."""
    rng = np.random.default_rng(seed)
    x = np.asarray(PRIOR.mean) + rng.standard_normal((tracks, 4)) * np.sqrt([4.0, 4.0, 0.1, 0.1])
    root = np.linalg.cholesky(np.asarray(model.Q))
    sensor = jax.vmap(model.sensors[""])
    truth, z = [], []
    for _ in range(steps):
        x = np.asarray(jax.vmap(lambda s: straight_on(s, 1.0))(x)) + rng.standard_normal((tracks, 4)) @ root.T
        noise = rng.standard_normal((tracks, 2)) * np.where(rng.random((tracks, 1)) < outliers, 20, 1) * np.sqrt(R)
        truth.append(x)
        z.append(np.asarray(sensor(x)) + noise)
    return np.stack(truth, 1), np.stack(z, 1)


def quality(result, truth):
    """Error of the position (tracks, steps) and NEES a component."""
    error = result.mean - truth
    nees = np.einsum("...i,...i", error, np.linalg.solve(result.cov, error[..., None])[..., 0])
    return np.hypot(error[..., 0], error[..., 1]), nees / error.shape[-1]


@pytest.mark.parametrize("update", [sigmax.iterated(k, guarded) for k in (1, 4) for guarded in (True, False)], ids=str)
@pytest.mark.parametrize("name", ["EKF", "SRCKFB", "CIF", "SRUKF", "SRPFB"])
@pytest.mark.one_in(4)
def test_iterating_changes_nothing_where_the_sensor_is_straight(name, update):
    problem = linear(4, 2)
    z = problem.z.copy()
    z[1, 0] = z[3] = np.nan
    prior = sigmax.Gaussian(problem.x0, problem.P0)
    once, again = (
        sigmax.run(sigmax.get(name, update=u), problem.model(), prior, z, dt=DT) for u in (sigmax.once, update)
    )
    assert max(scaled_gap(again, once)) < 1e-12
    assert np.allclose(again.nis, once.nis, rtol=1e-10, equal_nan=True)
    assert np.allclose(again.step_log_likelihood, once.step_log_likelihood, rtol=1e-10)
    means, covs = problem.exact(z)
    assert np.abs((again.mean - means) / once.std).max() < 1e-11
    assert np.allclose(again.cov, covs, rtol=1e-9, atol=1e-12)


def iekf(sensor, R, mean, P, z, turns, times):
    """Gauss–Newton on |x − x̂|² in P⁻¹ and |z − h(x)|² in R⁻¹, linearised again so many times (Bell and Cathey)."""
    x, prior, H = mean, np.linalg.inv(P), jax.jacfwd(sensor)
    for _ in range(times + 1):
        J = np.asarray(H(jnp.asarray(x)))
        off = z - np.asarray(sensor(jnp.asarray(x)))
        off = off - turns * 2 * np.pi * np.round(off / (2 * np.pi))
        posterior = np.linalg.inv(prior + J.T @ np.linalg.solve(R, J))
        x = mean + posterior @ J.T @ np.linalg.solve(R, off + J @ (x - mean))
    return x, posterior


@pytest.mark.parametrize("times", [pytest.param(1, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("name", FIVE)
@pytest.mark.one_in(2)
def test_taylor_iterated_is_the_textbook(name, times):
    _, z = drawn(RADAR, RADAR_R, 6, 4, seed=3)
    filter = sigmax.get(name, update=sigmax.iterated(times, guarded=False))
    got = sigmax.run(filter, RADAR, PRIOR, z, dt=1.0)
    F, R, turns = np.eye(4) + np.eye(4, k=2), np.diag(RADAR_R), np.array([0, 1])
    for track in range(len(z)):
        x, P = np.asarray(PRIOR.mean), np.diag([4.0, 4.0, 0.1, 0.1])
        for step in range(4):
            x, P = iekf(radar, R, F @ x, F @ P @ F.T + np.asarray(RADAR.Q), z[track, step], turns, times)
            deviation = np.sqrt(np.diag(P))
            assert np.abs((got.mean[track, step] - x) / deviation).max() < 1e-9
            assert np.abs((got.cov[track, step] - P) / np.outer(deviation, deviation)).max() < 1e-9


def iplf(sensor, R, mean, P, z, turns, times):
    """Statistical linear regression by 2n cubature points about the posterior, so many times (García-Fernández)."""
    n = len(mean)
    at, spread = mean, P
    for _ in range(times + 1):
        root = np.linalg.cholesky(spread)
        points = at[:, None] + np.sqrt(n) * np.hstack([root, -root])
        values = np.asarray(jax.vmap(sensor, 1, 1)(jnp.asarray(points)))
        y = values.mean(1)
        slope = (values - y[:, None]) @ (points - at[:, None]).T / (2 * n) @ np.linalg.inv(spread)
        omega = (values - y[:, None]) @ (values - y[:, None]).T / (2 * n) - slope @ spread @ slope.T
        off = z - (y + slope @ (mean - at))
        off = off - turns * 2 * np.pi * np.round(off / (2 * np.pi))
        Sy = slope @ P @ slope.T + omega + R
        K = P @ slope.T @ np.linalg.inv(Sy)
        at, spread = mean + K @ off, P - K @ Sy @ K.T
    return at, spread


@pytest.mark.parametrize("name", ["CKF", "SRCKFB", "SRCIF"])
def test_sigma_points_iterated_are_posterior_linearisation(name):
    _, z = drawn(RADAR, RADAR_R, 6, 4, seed=4)
    got = sigmax.run(sigmax.get(name, update=sigmax.iterated(2, guarded=False)), RADAR, PRIOR, z, dt=1.0)
    F, R, turns = np.eye(4) + np.eye(4, k=2), np.diag(RADAR_R), np.array([0, 1])
    for track in range(len(z)):
        x, P = np.asarray(PRIOR.mean), np.diag([4.0, 4.0, 0.1, 0.1])
        for step in range(4):
            x, P = iplf(radar, R, F @ x, F @ P @ F.T + np.asarray(RADAR.Q), z[track, step], turns, 2)
            deviation = np.sqrt(np.diag(P))
            assert np.abs((got.mean[track, step] - x) / deviation).max() < 1e-7
            assert np.abs((got.cov[track, step] - P) / np.outer(deviation, deviation)).max() < 1e-7


@cache
def turning(filter, backend=None):
    z = turning_record()
    z[2] = z[3, 0] = np.nan
    z[4] += 3
    start = sigmax.Gaussian(*TURNING_PRIOR)
    return sigmax.run(filter, TURNING, start, z, dt=DT, inputs=np.zeros((len(z), 1)), backend=backend)


@pytest.mark.parametrize(
    ("name", "update"),
    [
        pytest.param(name, update, marks=[pytest.mark.slow] * (update != quick))
        for name, quick in {
            "SREKFB": "iterated", "SREIF": "iterated huber", "SRCKF": "iterated", "CIF": "iterated huber",
            "PF": "iterated", "SRUKFB": "iterated huber",
        }.items()
        for update in ("iterated", "student", "iterated huber")
    ],
)  # fmt: skip
@pytest.mark.one_in(2)
def test_every_form_is_the_covariance_form_with_every_update(name, update):
    filter = sigmax.get(name, update=UPDATES[update])
    same = replace(filter, form=textbook(False), name="textbook")
    assert max(scaled_gap(turning(filter), turning(same, "xla"))) < 1e-9
    for field in ("nis", "step_log_likelihood", "dof"):
        got, want = (getattr(r, field) for r in (turning(filter), turning(same, "xla")))
        assert np.allclose(got, want, rtol=1e-8, atol=1e-8, equal_nan=True)


@pytest.mark.parametrize("update", ["unguarded", "iterated huber"])
@pytest.mark.parametrize("name", ["TSEKF", "TSCKF"])
@pytest.mark.one_in(4)
def test_two_stages_are_the_covariance_form_with_every_update(name, update):
    filter = sigmax.get(name, update=UPDATES[update])
    z = turning_record()
    record = {"antenna": z[:, :1], "ruler": z[:, 1:]}
    got, want = (
        sigmax.run(f, APART, sigmax.Gaussian(*TURNING_PRIOR), record, dt=DT, inputs=np.zeros((6, 1)), backend=backend)
        for f, backend in ((filter, None), (replace(filter, form=textbook(True)), "xla"))
    )
    assert max(scaled_gap(got, want)) < 1e-9
    assert np.abs((got.bias_mean - want.bias_mean) / want.bias_std).max() < 1e-9


@pytest.mark.parametrize(
    "update", [pytest.param("iterated", marks=pytest.mark.slow), "student", "gate", "iterated huber"]
)
@pytest.mark.one_in(3)
def test_a_live_filter_and_a_batch_are_the_record(update):
    filter = sigmax.get("SRCKFB", update=UPDATES[update])
    _, z = drawn(RADAR, RADAR_R, 3, 5, seed=5, outliers=0.3)
    record = sigmax.run(filter, RADAR, PRIOR, z, dt=1.0)
    xla = sigmax.run(filter, RADAR, PRIOR, z, dt=1.0, backend="xla")
    assert max(scaled_gap(record, xla)) < 1e-9
    live = sigmax.Live(filter, RADAR, PRIOR)
    for step, value in enumerate(z[1]):
        live.predict(1.0)
        told = live.update(value)
        assert np.allclose(live.mean, record.mean[1, step], rtol=0, atol=1e-10)
        assert np.isclose(told.log_likelihood, record.step_log_likelihood[1, step])
        assert told.dof == record.dof[1, step]


@pytest.mark.parametrize("kind", WEIGHTS)
@pytest.mark.parametrize("m", [1, 2])
def test_the_density_of_a_weight_has_an_integral_of_one(kind, m):
    """Over all innovations; what a gate refuses has the probability of all that lies beyond it."""
    weight, axis = WEIGHTS[kind](), np.sinh(np.linspace(-8, 8, 2001))
    e = np.stack(np.meshgrid(*[axis] * m, indexing="ij"))
    told = weight(jnp.asarray(e), jnp.full(e.shape[1:], m))
    mass = np.where((np.asarray(told.weights) > 0).all(0), np.exp(np.asarray(told.log_density)), 0)
    for _ in range(m):
        mass = np.trapezoid(mass, axis)
    refused = 1 - weight.probability if kind == "gate" else 0
    assert abs(mass + refused - 1) < 2e-3


def test_weights_are_those_of_the_textbook():
    e = np.array([0.3, -5.0])
    student = WEIGHTS["student"](3.0)(jnp.asarray(e), jnp.asarray(2))
    assert np.allclose(student.weights, min(1, 5 / (3 + e @ e)))
    assert np.isclose(student.log_density, stats.multivariate_t(np.zeros(2), np.eye(2), df=3).logpdf(e))
    assert np.allclose(WEIGHTS["huber"](2.0)(jnp.asarray(e), jnp.asarray(2)).weights, [1, 2 / 5])
    beyond = np.sqrt(stats.chi2.ppf(0.99, 2))
    for length, passes in ((beyond - 1e-6, 1), (beyond + 1e-6, 0)):
        gate = WEIGHTS["gate"](0.99)(jnp.asarray([length, 0]), jnp.asarray(2))
        assert np.array_equal(gate.weights, [passes, passes])


def test_iterating_finds_the_posterior_where_a_line_about_the_prior_does_not():
    """Two bearings from a wide prior: NEES above 3 with one line, as it should be with the guard."""
    truth, z = drawn(BEARINGS, np.full(2, np.deg2rad(0.5) ** 2), 400, 5, seed=6)
    for name, most in (("SREKFB", 3.0), ("SRCKFB", 1.8)):
        once, wild, guarded = (
            quality(sigmax.run(sigmax.get(name, update=u), BEARINGS, PRIOR, z, dt=1.0), truth)
            for u in (sigmax.once, sigmax.iterated(8, guarded=False), sigmax.iterated(8))
        )
        assert once[1][:, 0].mean() > most
        assert guarded[1][:, 0].mean() < 1.2
        assert 0.85 < guarded[1][:, -1].mean() < 1.15
        assert np.sqrt((guarded[0][:, -1] ** 2).mean()) < 0.5 * np.sqrt((once[0][:, -1] ** 2).mean())
        assert guarded[1][:, 0].mean() < wild[1][:, 0].mean()


@pytest.mark.parametrize("name", ["SRCKFB", "SREKFB"])
def test_outliers_do_not_carry_the_estimate_away(name):
    truth, z = drawn(RADAR, RADAR_R, 400, 60, seed=7, outliers=0.1)
    clean_truth, clean = drawn(RADAR, RADAR_R, 400, 60, seed=8)

    def end(update, truth, z):
        error = quality(sigmax.run(sigmax.get(name, update=update), RADAR, PRIOR, z, dt=1.0), truth)[0][:, -1]
        return np.sqrt((error**2).mean()), (error > 1).mean()

    once, student, huber = (end(u, truth, z) for u in ("once", "student", "iterated(1) huber"))
    assert once[1] > 0.1
    assert student[0] < 0.3 * once[0]
    assert student[1] < 0.01
    assert huber[0] < 0.4 * once[0]
    assert end("student", clean_truth, clean)[0] < 1.06 * end("once", clean_truth, clean)[0]


def test_a_gate_refuses_and_finds_its_way_back():
    """What is refused leaves the mean, counts nothing and widens; a filter that is wrong is not wrong for ever."""
    gps = model(lambda x: x[:2], np.array([0.01, 0.01]), (False, False))
    z = np.tile([0.0, 0.0], (40, 1))
    z[10] = [50.0, 0.0]
    z[20:] = [30.0, -20.0]
    prior = sigmax.Gaussian(np.zeros(4), np.full(4, 0.01))
    gate, locked = (
        sigmax.run(sigmax.get("SREKFB", update=sigmax.robust("gate", growth=g)), gps, prior, z, dt=1.0)
        for g in (1.5, 1.0)
    )
    once = sigmax.run("SREKFB", gps, prior, z, dt=1.0)
    assert gate.dof[10] == 0
    assert np.isnan(gate.nis[10])
    assert np.isfinite(gate.step_log_likelihood[10])
    assert np.abs(gate.mean[10, :2]).max() < 0.5
    assert np.abs(once.mean[10, :2]).max() > 5
    assert (gate.std[10] > 1.4 * gate.std[9]).all()
    assert (locked.dof[20:] == 0).sum() > (gate.dof[20:] == 0).sum()
    assert np.abs(gate.mean[-1, :2] - [30, -20]).max() < 1
    assert gate.ok.all()


TOGETHER = sigmax.Model(
    motion=straight_on,
    sensor={"radar": radar, "bearings": bearings},
    Q=RADAR.Q,
    R={"radar": RADAR_R, "bearings": np.full(2, np.deg2rad(0.5) ** 2)},
    state=("x", "y", "vx", "vy"),
    measurement={"radar": ("r", sigmax.angle("a")), "bearings": (sigmax.angle("b0"), sigmax.angle("b1"))},
)


@pytest.mark.parametrize("backend", [None, "xla"])
@pytest.mark.one_in(2)
def test_each_sensor_has_the_update_that_is_its_own(backend):
    """One filter with two updates is two filters in turn, each correcting with its own sensor."""
    _, z = drawn(RADAR, RADAR_R, 1, 6, 5, outliers=0.5)
    _, angles = drawn(BEARINGS, np.full(2, np.deg2rad(0.5) ** 2), 1, 6, 6)
    chosen = sigmax.get("SRCKFB", update={"radar": "student(2)", "bearings": "iterated(2)"})
    together = sigmax.run(chosen, TOGETHER, PRIOR, {"radar": z[0], "bearings": angles[0]}, dt=DT, backend=backend)
    first, second = (
        sigmax.Live(sigmax.get("SRCKFB", update=update), TOGETHER, PRIOR, backend=backend)
        for update in ("student(2)", "iterated(2)")
    )
    for k in range(6):
        first.predict(DT)
        first.update(z[0, k], "radar")
        second.put(first.belief, 0)
        second.update(angles[0, k], "bearings")
        first.put(second.belief, 0)
        assert np.abs((first.mean - together.mean[k]) / together.std[k]).max() < 1e-10
    same = [sigmax.get("EKF", update=u) for u in ({"radar": "student"}, sigmax.filters.by_sensor({"radar": "student"}))]
    assert same[0] == same[1]
    assert str(same[0].update) == "radar: student(4)"
    others = sigmax.filters.by_sensor({"radar": "gate"}, others="huber")
    assert others.of("bearings") == sigmax.robust("huber")


@dataclass(frozen=True)
class Half:
    """Half of every measurement."""

    def __call__(self, e, seen):
        return Weighed(jnp.full_like(e, 0.5), -0.5 * (e * e).sum(0))


def test_a_weight_of_ones_own_divides_the_noise():
    """Half a measurement is one of twice the variance."""
    problem = linear(3, 2)
    prior = sigmax.Gaussian(problem.x0, problem.P0)
    half = sigmax.get("SRCKFB", update=sigmax.robust(Half()))
    got = sigmax.run(half, problem.model(), prior, problem.z, dt=DT)
    want = sigmax.run("SRCKFB", problem.model(R=2 * problem.R), prior, problem.z, dt=DT)
    assert max(scaled_gap(got, want)) < 1e-12


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.one_in(3)
def test_single_precision_is_near(update):
    filter = sigmax.get("SRCKFB", update=UPDATES[update])
    _, z = drawn(RADAR, RADAR_R, 20, 6, seed=9, outliers=0.1)
    double, single = (sigmax.run(filter, RADAR, PRIOR, z, dt=1.0, dtype=d) for d in ("float64", "float32"))
    assert np.median(np.abs(single.mean - double.mean) / double.std) < 1e-2


@pytest.mark.parametrize(
    "text", ["once", "iterated(5)", "student(2)", "huber(1.5)", "gate(0.99)", "iterated(2) student(4)"]
)
def test_an_update_reads_what_it_says(text):
    assert str(named(text)) == text
    assert named(str(named(text))) == named(text)
    assert sigmax.get("EKF", update=text) == sigmax.get("EKF", update=named(text))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (lambda: named("stundent"), "did you mean student"),
        (lambda: named("student(x)"), "must be a number"),
        (lambda: named("iterated(1.5)"), "whole number"),
        (lambda: named("student huber"), "twice"),
        (lambda: named(3), "sigmax.once"),
        (lambda: sigmax.iterated(0), "at least one"),
        (lambda: sigmax.iterated(1.0), "whole number"),
        (lambda: sigmax.robust("gate", probability=1.0), "between 0 and 1"),
        (lambda: sigmax.robust("gate", growth=0.5), "at least 1"),
        (lambda: sigmax.robust("student", dof=0), "above 0"),
        (lambda: sigmax.robust("student", c=3), "it takes dof"),
        (lambda: sigmax.robust(WEIGHTS["student"]), "hashable"),
        (lambda: Update(weight=[]), "hashable"),
        (lambda: sigmax.get("EKF", update={}), "a dict such as"),
        (lambda: sigmax.get("EKF", update={"radar": {"a": "once"}}), "the update of one sensor"),
        (
            lambda: sigmax.run(sigmax.get("EKF", update={"radr": "gate"}), TOGETHER, PRIOR, {"radar": np.ones((1, 2))}),
            "did you mean radar",
        ),
        (
            lambda: sigmax.Live(sigmax.get("EKF", update={"radar": "gate"}), sigmax.models.fused(TOGETHER), PRIOR),
            "corrected as one",
        ),
        (
            lambda: sigmax.Filter(sigmax.rules.Taylor1(), sigmax.rules.Taylor1(), sigmax.forms.block, update="student"),
            "sigmax.once",
        ),
    ],
)
def test_what_is_no_update_is_refused(given, says):
    with pytest.raises(sigmax.InputError, match=says):
        given()
