"""Laws of a bank of filters: against exact posteriors on a grid, the one filter, and itself in other ways to run it."""

import pickle
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.algebra.arrays import outer
from sigmax.filters import Bank, ModeFilters
from sigmax.functions.current import current_model
from sigmax.mixtures.bank_steps import BankSteps
from sigmax.mixtures.merging import merged
from sigmax.mixtures.mixture import normalised
from sigmax.mixtures.splitting import bent, split
from sigmax.running import Fault, contribution
from sigmax.spaces import moments

# Some have too few members on purpose: what they share with others must hold all the same.
pytestmark = pytest.mark.filterwarnings("ignore::sigmax.errors.BendingWarning")
ENGINES = ["native", pytest.param("xla", marks=pytest.mark.slow)]
PRIOR = sigmax.Gaussian([1.0, 0.0], [4.0, 1.0])


def moved(x, dt):
    return jnp.stack([x[0] + dt * x[1], x[1]])


def to_beacon(x):
    return jnp.hypot(x[0], 3.0)[None]


def ranged(noise=0.5, **options):
    """A vehicle on a line that ranges to a beacon 3 m beside it: before or behind it is not said."""
    return sigmax.Model(
        motion=moved,
        sensor=to_beacon,
        Q=[0.01, 0.01],
        R=[noise**2],
        state=("p", "v"),
        measurement=("range",),
        **options,
    )


def ranges(tracks, steps, prior=PRIOR):
    rng = np.random.default_rng(0)
    x = rng.multivariate_normal(prior.mean, prior.cov, tracks)
    truth, z = np.empty((tracks, steps, 2)), np.empty((tracks, steps, 1))
    for k in range(steps):
        x = x @ np.array([[1, 0], [0.5, 1]]) + rng.normal(size=x.shape) * np.sqrt(0.5 * 0.01)
        truth[:, k] = x
        z[:, k, 0] = np.hypot(x[:, 0], 3.0) + 0.5 * rng.normal(size=tracks)
    return truth, z


@pytest.mark.parametrize("backend", ENGINES)
@pytest.mark.parametrize("name", ["KF", "SREKFB", "CKF", "SRUKF", "CIF", "SRCIF"])
@pytest.mark.one_in(3)
def test_where_nothing_bends_it_is_the_one_filter(name, backend):
    model = sigmax.Model(
        motion=moved, sensor=lambda x: x[:1], Q=[0.01, 0.1], R=[0.3], state=("p", "v"), measurement=("p",)
    )
    z = np.random.default_rng(1).normal(size=(3, 12, 1))
    z[1, 4] = np.nan
    one, many = (sigmax.run(f, model, PRIOR, z, dt=0.5, backend=backend) for f in (name, sigmax.bank(name)))
    assert many.ok.all()
    assert np.allclose(many.mean, one.mean, atol=1e-12)
    assert np.allclose(many.cov, one.cov, atol=1e-12)
    assert np.allclose(many.log_likelihood, one.log_likelihood, atol=1e-11)
    assert np.allclose(many.nis, one.nis, atol=1e-11, equal_nan=True)


def heavy(rng, n):
    A = rng.normal(size=(n, n)) * np.exp(rng.normal(size=(n, 1)))
    return np.linalg.cholesky(A @ A.T)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_splits_and_merges_keep_mean_and_covariance(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    bends = rng.normal(size=(2, n, n)) * 3
    model = sigmax.Model(
        motion=lambda x, dt: x, sensor=lambda x: jnp.einsum("mij,i,j->m", bends, x, x), Q=[1.0] * n, R=[0.01] * 2
    )
    bank = sigmax.bank("SRCKFB")
    steps = BankSteps(bank, current_model(model))
    belief, _ = steps.begin(jnp.asarray(rng.normal(size=n)), jnp.asarray(heavy(rng, n) @ heavy(rng, n).T))
    slots = split(bank, model.space, bent(model, "", model.R[""], belief, jnp.zeros(2), None))
    shares, _ = normalised([s.log_weight for s in slots])
    assert (shares > 0).sum() == 1 + 2 * bank.splits

    def mixture(beliefs, weights):
        mean, factor = moments(model.space, [b.mean for b in beliefs], [b.factor for b in beliefs], jnp.stack(weights))
        return mean, outer(factor, factor)

    scale = np.sqrt(np.diag(outer(belief.factor, belief.factor)))
    mean, cov = mixture([s.belief for s in slots], list(shares))
    assert np.allclose((mean - belief.mean) / scale, 0, atol=1e-12)
    assert np.allclose((cov - outer(belief.factor, belief.factor)) / np.outer(scale, scale), 0, atol=1e-12)
    # Other weights and other means, as after a measurement.
    beliefs = [s.belief._replace(mean=s.belief.mean + scale * rng.normal(size=n)) for s in slots]
    logs = [s.log_weight + rng.normal() for s in slots]
    members, left = merged(model.space, beliefs, logs, bank.kept)
    assert len(members) == bank.kept
    before = mixture(beliefs, list(normalised(logs)[0]))
    after = mixture(members, list(normalised(left)[0]))
    spread = np.sqrt(np.diag(before[1]))
    assert np.allclose((after[0] - before[0]) / spread, 0, atol=1e-12)
    assert np.allclose((after[1] - before[1]) / np.outer(spread, spread), 0, atol=1e-12)


def exact(sensor, noise, prior, z, half=8.0, points=4001):
    """Mean, variance and log-likelihood of a scalar posterior, on a grid."""
    x = np.linspace(prior.mean[0] - half, prior.mean[0] + half, points)
    log_prior = -0.5 * (x - prior.mean[0]) ** 2 / prior.cov[0, 0] - 0.5 * np.log(2 * np.pi * prior.cov[0, 0])
    density = np.exp(log_prior - 0.5 * (z - sensor(x)) ** 2 / noise**2) / np.sqrt(2 * np.pi) / noise
    total = np.trapezoid(density, x)
    mean = np.trapezoid(x * density, x) / total
    return mean, np.trapezoid((x - mean) ** 2 * density, x) / total, np.log(total)


SHAPES = {
    "square": (lambda x: x**2 / 2, 0.5),
    "exponential": (lambda x: np.exp(x / 2), 0.3),
    "range": (lambda x: np.sqrt(x**2 + 1), 0.2),
    "bearing": (lambda x: np.arctan2(1.0, x + 3), 0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_it_comes_near_the_exact_posterior_where_one_filter_does_not(shape):
    sensor, noise = SHAPES[shape]
    of_jax = {
        "square": lambda x: x**2 / 2,
        "exponential": lambda x: jnp.exp(x / 2),
        "range": lambda x: jnp.sqrt(x**2 + 1),
        "bearing": lambda x: jnp.arctan2(1.0, x + 3),
    }[shape]
    rng = np.random.default_rng(7)
    prior = sigmax.Gaussian([0.5], [[1.0]])
    z = sensor(0.5 + rng.normal(size=60)) + noise * rng.normal(size=60)
    model = sigmax.Model(motion=lambda x, dt: x, sensor=of_jax, Q=[0.0], R=[noise**2], state=("x",), measurement=("z",))
    want = np.array([exact(sensor, noise, prior, one) for one in z])

    def apart(filter):
        got = sigmax.run(filter, model, prior, z[:, None, None])
        deviation = np.sqrt(want[:, 1])
        found = np.column_stack(
            [
                (got.mean[:, 0, 0] - want[:, 0]) / deviation,
                np.log(got.cov[:, 0, 0, 0] / want[:, 1]),
                got.log_likelihood - want[:, 2],
            ]
        )
        return np.sqrt((found**2).mean(0))

    one, few, many = apart("SRCKFB"), apart(sigmax.bank("SRCKFB", 5)), apart(sigmax.bank("SRCKFB", 31, bend=0.2))
    assert (many < 0.4 * one).all(), (one, many)
    assert (few < 0.9 * one).all(), (one, few)


@pytest.mark.parametrize("backend", ENGINES)
def test_it_runs_alike_however_it_is_run(backend):
    filter, model = sigmax.bank("SRCKFB", 7), ranged()
    _, z = ranges(3, 12)
    z[1, 5] = np.nan
    together = sigmax.run(filter, model, PRIOR, z, dt=0.5, backend=backend)
    for track, rows in enumerate(z):
        alone = sigmax.run(filter, model, PRIOR, rows, dt=0.5, backend=backend)
        assert np.allclose(alone.mean, together.mean[track], atol=1e-12)
    live = sigmax.Live(filter, model, PRIOR, backend=backend)
    for k, row in enumerate(z[1]):
        said = live.step(row, dt=0.5)
        assert np.allclose(live.mean, together.mean[1, k], atol=1e-12)
        assert np.allclose(live.cov, together.cov[1, k], atol=1e-12)
        assert np.allclose(said.nis, together.nis[1, k], equal_nan=True)
        if k == 6:
            live = pickle.loads(pickle.dumps(live))
    late = sigmax.Live(filter, model, PRIOR, backend=backend, window=4.0, lag=1.0)
    for k in (0, 2, 1, 3, 5, 4):
        late.update(z[0, k], time=0.5 * (k + 1))
    assert np.array_equal(late.mean, together.mean[0, 5]) or backend == "xla"
    assert np.allclose(late.mean, together.mean[0, 5], atol=1e-12)
    back = sigmax.smooth(filter, model, sigmax.run(filter, model, PRIOR, z[0, :6], dt=0.5), backend=backend)
    assert np.allclose(late.lagged.mean, back.mean[3], atol=1e-9)
    # Nothing heard, nothing changed.
    live.predict(0.5)
    before = live.mean.copy(), live.cov.copy()
    live.update([np.nan])
    assert np.array_equal(live.mean, before[0])
    assert np.array_equal(live.cov, before[1])


@pytest.mark.slow
def test_engines_and_precisions_agree():
    filter, (_, z) = sigmax.bank("SREKFB", 5), ranges(20, 15)
    native, xla, single = (
        sigmax.run(filter, ranged(), PRIOR, z, dt=0.5, **how)
        for how in ({"backend": "native"}, {"backend": "xla"}, {"dtype": "float32"})
    )
    # Also where two merges cost the same but for rounding.
    assert np.abs((xla.mean - native.mean) / native.std).max() < 1e-7
    assert np.abs(np.log(xla.std / native.std)).max() < 1e-7
    assert np.median(np.abs(single.mean - native.mean) / native.std) < 1e-3


def test_it_is_better_and_more_honest_where_the_side_of_a_beacon_is_not_known():
    truth, z = ranges(400, 30)
    found = {}
    for name, filter in (("one", sigmax.get("SRCKFB")), ("bank", sigmax.bank("SRCKFB"))):
        got = sigmax.run(filter, ranged(), PRIOR, z, dt=0.5)
        assert not (got.fault > 0).any()
        d = truth - got.mean
        nees = np.einsum("bti,btij,btj->bt", d, np.linalg.inv(got.cov), d) / 2
        found[name] = np.sqrt((d[..., 0] ** 2).mean()), nees.mean(), got.log_likelihood.mean()
    one, bank = found["one"], found["bank"]
    assert bank[0] < 0.9 * one[0]
    assert bank[1] < 4 < 100 < one[1]
    assert bank[2] > one[2] + 10


@pytest.mark.parametrize("name", ["SRCKFB", *(pytest.param(n, marks=pytest.mark.slow) for n in ("TSCKF", "MTSCKF"))])
def test_a_bias_is_carried_by_every_member(name):
    bias = sigmax.Bias(sensor=[[1.0]], Q=[1e-6], prior=sigmax.Gaussian([0.0], [0.01]), names=["offset"])
    _, z = ranges(2, 8)
    got = sigmax.run(sigmax.bank(name, 5), ranged(bias=bias), PRIOR, z, dt=0.5)
    assert got.ok.all()
    assert got.bias_mean.shape == (2, 8, 1)


def test_angles_and_several_sensors():
    _, z = ranges(2, 8)
    several = sigmax.Model(
        motion=moved,
        sensor={"range": lambda x: jnp.hypot(x[0], 3.0)[None], "bearing": lambda x: jnp.arctan2(3.0, x[0])[None]},
        Q=[0.01, 0.01],
        R={"range": [0.01], "bearing": [0.01]},
        state=("p", "v"),
        measurement={"range": ("r",), "bearing": (sigmax.angle("b"),)},
    )
    both = {"range": z, "bearing": np.full(z.shape, 2 * np.pi + 1.0)}
    turned = both | {"bearing": both["bearing"] - 4 * np.pi}
    one, other = (sigmax.run(sigmax.bank("SREKFB", 5), several, PRIOR, a, dt=0.5) for a in (both, turned))
    assert np.allclose(one.mean, other.mean, atol=1e-9)


@pytest.mark.slow
def test_the_other_sign_of_a_quaternion_is_the_same_attitude():
    def seen(q):
        return sigmax.spaces.rotate(sigmax.spaces.conjugate(q), jnp.array([1.0, 0.0, 0.0]))

    attitude = sigmax.Model(
        motion=lambda x, dt: x, sensor=seen, Q=[1e-4] * 3, R=[1e-4] * 3, state=[sigmax.rotation("attitude")],
        measurement=("a", "b", "c"),
    )  # fmt: skip
    pointed = np.random.default_rng(1).normal(size=(6, 3)) * 0.01 + [0.8, -0.6, 0.0]
    ends = [sigmax.run(sigmax.bank("SRCKFB", 5), attitude, sigmax.Gaussian([s, 0, 0, 0], [1.0] * 3), pointed)
            for s in (1.0, -1.0)]  # fmt: skip
    assert ends[0].ok.all()
    assert np.allclose(ends[0].cov, ends[1].cov, atol=1e-9)
    assert np.allclose(np.linalg.norm(ends[0].mean, axis=1), 1)


@pytest.mark.parametrize("backend", ENGINES)
def test_a_member_that_fails_leaves_the_others(backend):
    model = sigmax.Model(
        motion=lambda x, dt: x,
        sensor=lambda x: jnp.where(x[:1] > 1.5, jnp.nan, x[:1] ** 2),
        Q=[0.0],
        R=[0.01],
        state=("x",),
        measurement=("z",),
    )
    z = np.array([[0.25]])
    got = sigmax.run(sigmax.bank("SREKFB"), model, sigmax.Gaussian([0.5], [[0.49]]), z, backend=backend)
    assert got.fault[0] == Fault.MEMBER_FAILED
    assert np.isfinite(got.mean).all()
    far = sigmax.Gaussian([3.0], [[0.01]])
    lost = sigmax.run(sigmax.bank("SREKFB"), model, far, z, backend=backend)
    assert lost.fault[0] == Fault.SENSOR_NOT_FINITE
    assert np.allclose(lost.mean, far.mean)


def test_it_is_smoothed_by_the_filter_of_its_members():
    beyond = sigmax.Gaussian([6.0, 0.5], [4.0, 0.25])
    truth, z = ranges(100, 20, beyond)
    filter = sigmax.bank("SRCKFB")
    got = sigmax.run(filter, ranged(), beyond, z, dt=0.5)
    back = sigmax.smooth(filter, ranged(), got)
    assert back.ok.all()
    assert np.allclose(back.mean[:, -1], got.mean[:, -1])
    assert ((truth - back.mean) ** 2).mean() < 0.9 * ((truth - got.mean) ** 2).mean()


@pytest.mark.parametrize(
    ("unit", "dtype"),
    [
        (1e-9, "float32"),
        *(pytest.param(*o, marks=pytest.mark.slow) for o in ((1e9, "float64"), (1e9, "float32"), (1e-9, "float64"))),
    ],
)  # fmt: skip
def test_units_of_state_and_sensor_change_nothing(unit, dtype):
    _, z = ranges(3, 10)

    def scaled(a, b):
        return sigmax.run(
            sigmax.bank("SRCKFB", 5),
            sigmax.Model(
                motion=moved,
                sensor=lambda x: to_beacon(x / a) * b,
                Q=np.array([0.01, 0.01]) * a**2,
                R=[0.25 * b**2],
                state=("p", "v"),
                measurement=("range",),
            ),
            sigmax.Gaussian(PRIOR.mean * a, PRIOR.cov * a**2),
            z * b,
            dt=0.5,
            dtype=dtype,
        )

    one, other = scaled(1.0, 1.0), scaled(unit, 1 / unit)
    near = 1e-9 if dtype == "float64" else 1e-2
    assert np.allclose(other.mean / unit, one.mean, atol=near)
    assert np.allclose(other.nis, one.nis, atol=10 * near)


def test_a_sensor_without_noise_is_no_number_beyond_all():
    model = sigmax.Model(motion=lambda x, dt: x, sensor=lambda x: x**2, Q=[0.0], R=[0.0])
    for dtype in ("float64", "float32"):
        got = sigmax.run(sigmax.bank("SREKFB"), model, sigmax.Gaussian([1.0], [[0.1]]), np.ones((2, 1)), dtype=dtype)
        assert np.isfinite(got.mean).all()


@pytest.mark.slow
def test_the_likelihood_differentiates():
    _, z = ranges(1, 6)

    def likelihood(noise):
        return sigmax.run(sigmax.bank("SREKFB", 5), ranged(noise), PRIOR, z[0], dt=0.5).log_likelihood

    slope = jax.grad(likelihood)(0.1)
    assert np.isclose(slope, (likelihood(0.1 + 1e-6) - likelihood(0.1 - 1e-6)) / 2e-6, rtol=1e-3)


def test_exported_it_is_the_same_filter(tmp_path):
    sigmax.export_c(sigmax.bank("SREKFB", 5), ranged(), PRIOR, tmp_path, dt=0.5)
    done = subprocess.run(["make", "-C", str(tmp_path), "test"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rest[" in (tmp_path / "filter.h").read_text()


def test_by_name_it_is_the_same():
    assert sigmax.get("SRUKFB", members=9, alpha=0.5) == sigmax.bank(sigmax.get("SRUKFB", alpha=0.5))
    assert sigmax.bank("SRCKFB").name == "SRCKFB(members=9)"
    assert isinstance(sigmax.bank("KF"), Bank)
    sizes = [(sigmax.bank("EKF", m).kept, sigmax.bank("EKF", m).splits) for m in range(5, 32, 2)]
    assert all(kept + 2 * splits == m for (kept, splits), m in zip(sizes, range(5, 32, 2), strict=True))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: sigmax.bank("EKF", 8), "odd number from 5 to 31; it is 8"),
        (lambda: sigmax.bank("EKF", 3), "odd number from 5 to 31; it is 3"),
        (lambda: sigmax.bank("EKF", 33), "odd number"),
        (lambda: sigmax.bank("EKF", True), "odd number"),
        (lambda: sigmax.bank("EKF", "9"), "odd number"),
        (lambda: sigmax.bank("EKF", float("nan")), "odd number"),
        (lambda: sigmax.bank("EKF", 9, bend=0), "bend of a bank is a number above 0"),
        (lambda: sigmax.bank("EKF", 9, bend=float("nan")), "bend of a bank"),
        (lambda: sigmax.bank("ECF"), "unknown filter"),
        (lambda: sigmax.bank(sigmax.bank("EKF")), "a filter of one belief"),
        (lambda: sigmax.bank(ModeFilters.of([sigmax.get("EKF")])), "a filter of one belief"),
        (lambda: sigmax.bank(None), "a filter of one belief"),
        (lambda: sigmax.get("EKF", member=9), "update, members"),
        (
            lambda: sigmax.run(sigmax.bank("EKF"), sigmax.imm({"a": ranged(), "b": ranged()}), PRIOR, np.ones((3, 1))),
            "a mode has one belief, and a bank several",
        ),
        (lambda: sigmax.run(sigmax.bank("EKF"), ranged(), PRIOR, np.ones((3, 1))).weight, "run one alone"),
        pytest.param(
            lambda: contribution(sigmax.Live(sigmax.bank("EKF"), ranged(), PRIOR), [1.0], ""),
            "take one",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(call, said):
    with pytest.raises(sigmax.InputError, match=said):
        call()
