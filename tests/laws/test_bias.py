"""A random bias: every way to estimate it is the augmented filter, or on a linear model the Kalman filter."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax.engine.rows import RowSteps
from sigmax.modelling.evaluate import moving
from sigmax.rules import cubature, gauss_hermite, projected, scaled, sigma_set, simplex
from tests.laws.problems import DT, Linear

STEPS = 200
B = np.array([[0.3, -0.1], [0.0, 0.2], [0.1, 0.0]])
F = np.array([[1.0, 0.0], [0.2, 1.0]])
QB = np.array([[2e-3, 5e-4], [5e-4, 1e-3]])
B0, PB0 = np.array([0.1, -0.05]), np.array([[0.04, 0.01], [0.01, 0.02]])
R = np.array([[0.02, 0.005], [0.005, 0.05]])
Q = np.array([[0.01, 0.002, 0], [0.002, 0.01, 0], [0, 0, 0.02]])
X0, P0 = np.array([0.3, 0.2, 5.0]), np.array([[0.05, 0.01, 0], [0.01, 0.04, 0], [0, 0, 0.3]])
TWO_STAGE = ["TSEKF", "TSCKF", "TSHCKF", "TSCIF", "TSHCIF"]
MARGINAL = ["MTSCKF", "MTSHCKF", "MTSCIF", "MTSHCIF"]


def motion(x, dt):
    pull = 0.3 * jnp.sin(x[0])
    return jnp.stack([x[0] + x[1] * dt, 0.9 * x[1] - pull * dt, x[2] + 0.05 * (5 - x[2]) + 0.2 * jnp.cos(x[0])])


def sensor(x):
    return jnp.stack([x[0] + 0.05 * x[1] ** 2, x[2] * jnp.cos(0.3 * x[1])])


def put_together(X, dt):
    return jnp.concatenate([motion(X[:3], dt) + jnp.asarray(B) @ X[3:], X[3:]])


NAMES = (sigmax.angle("azimuth"), "rate", "distance")
SEEN = (sigmax.angle("azimuth"), "distance")
PRIOR = sigmax.Gaussian(X0, P0)


def model(prior=None, noise=QB):
    bias = sigmax.Bias(motion=B, sensor=F, Q=noise, prior=prior or sigmax.Gaussian(B0, PB0), names=("drift", "offset"))
    return sigmax.Model(motion=motion, sensor=sensor, Q=Q, R=R, state=NAMES, measurement=SEEN, bias=bias)


BIASED = model()
WITHOUT = sigmax.Model(motion=motion, sensor=sensor, Q=Q, R=R, state=NAMES, measurement=SEEN)
ZERO = np.zeros((3, 2))
BY_HAND = sigmax.Model(
    motion=put_together,
    sensor=lambda X: sensor(X[:3]) + jnp.asarray(F) @ X[3:],
    Q=np.block([[Q, ZERO], [ZERO.T, QB]]),
    R=R,
    state=(*NAMES, "drift", "offset"),
    measurement=SEEN,
)
BY_HAND_PRIOR = sigmax.Gaussian(np.r_[X0, B0], np.block([[P0, ZERO], [ZERO.T, PB0]]))


@cache
def record():
    """Simulated with a drifting bias; a few measurements are missing."""
    rng = np.random.default_rng(4)
    x, b, z = np.r_[X0], np.r_[B0], []
    for _ in range(STEPS):
        x = np.asarray(motion(x, DT)) + B @ b + rng.multivariate_normal(np.zeros(3), Q * DT)
        b = b + rng.multivariate_normal(np.zeros(2), QB * DT)
        z.append(np.asarray(sensor(x)) + F @ b + rng.multivariate_normal(np.zeros(2), R))
    z = np.array(z)
    z[20] = np.nan
    z[30, 0] = z[40, 1] = np.nan
    return z


@cache
def answer(filter):
    return sigmax.run(filter, BIASED, PRIOR, record(), dt=DT)


@cache
def by_hand(filter):
    return sigmax.run(filter, BY_HAND, BY_HAND_PRIOR, record(), dt=DT)


def gap(got, want):
    """Largest differences of means and of covariances, state and bias, in standard deviations."""
    parts = [(got.mean, got.cov, want.mean, want.cov, want.std)]
    parts += [(got.bias_mean, got.bias_cov, want.bias_mean, want.bias_cov, want.bias_std)]
    worst = 0.0
    for x, P, y, S, sd in parts:
        worst = max(worst, np.abs((x - y) / sd).max())
        worst = max(worst, np.abs((P - S) / (sd[..., :, None] * sd[..., None, :])).max())
    return worst


@pytest.mark.parametrize("name", ["EKF", "CKF", "SRCKFB", pytest.param("SRHCIF", marks=pytest.mark.slow)])
def test_a_filter_without_stages_runs_augmented(name):
    """The root is that of [x; b]; state and bias come out apart, by name."""
    got, want = answer(name), by_hand(name)
    assert got.ok.all()
    assert (got.state, got.bias) == (NAMES, ("drift", "offset"))
    assert np.abs((got.mean - want.mean[:, :3]) / got.std).max() < 1e-9
    assert np.abs((got.bias_mean - want.mean[:, 3:]) / got.bias_std).max() < 1e-9
    assert np.allclose(got.cov, want.cov[:, :3, :3], rtol=1e-9, atol=1e-12)
    assert np.allclose(got.bias_cov, want.cov[:, 3:, 3:], rtol=1e-9, atol=1e-12)
    assert np.allclose(got.factor @ got.factor.swapaxes(-1, -2), got.cov, rtol=1e-12)
    assert got.log_likelihood == pytest.approx(want.log_likelihood, rel=1e-10)


def augmented(name, bias_first):
    """The filter of the same rules, its covariance whole, with the bias before or behind the state in its root."""
    known = sigmax.get(name)
    rules = [getattr(rule, "rule", rule) for rule in (known.predict, known.correct)]
    return sigmax.Filter(*rules, replace(sigmax.forms.covariance, bias_first=bias_first))


@pytest.mark.parametrize("name", TWO_STAGE)
@pytest.mark.one_in(2)
def test_two_stages_are_the_augmented_filter_of_the_same_root(name):
    got = answer(name)
    assert got.ok.all()
    assert gap(got, answer(augmented(name, True))) < 1e-9
    assert np.allclose(np.triu(got.factor, 1), 0)
    assert np.allclose(got.factor @ got.factor.swapaxes(-1, -2), got.cov, rtol=1e-9)


@pytest.mark.parametrize("name", ["TSCKF", "TSHCKF"])
def test_the_root_matters_to_points(name):
    """Two references exist: only linearisation by derivatives does not see in which order the root is taken."""
    assert gap(answer(name), answer(augmented(name, False))) > 1e-4
    assert gap(answer("TSEKF"), answer("EKF")) < 1e-9


@pytest.mark.parametrize("name", MARGINAL)
def test_the_marginal_filter_with_projected_points_is_the_augmented_filter(name):
    got = answer(sigmax.get(name, points="projected"))
    assert got.ok.all()
    assert gap(got, answer(augmented(name, False))) < 1e-9


def test_drawn_in_the_best_order_the_ways_to_treat_a_bias_are_one():
    """The root is then that of the components that bend, wherever the bias stands; its points are the same in all."""
    permuted = answer(sigmax.get("HCKF", permute=True))
    assert gap(permuted, answer("HCKF")) > 1e-6
    assert gap(answer(sigmax.get("MTSHCKF", points="projected", permute=True)), permuted) < 1e-9
    assert gap(answer(sigmax.get("TSHCKF", permute=True)), permuted) < 1e-9


@pytest.mark.parametrize("name", ["TSCIF", "TSHCIF"])
def test_two_stages_as_printed_are_the_information_filter_as_printed(name):
    printed = answer(sigmax.get(name, information="paper"))
    rules = sigmax.get(name)
    form = replace(sigmax.forms.without_omega(sigmax.forms.information), bias_first=True)
    assert gap(printed, answer(sigmax.Filter(rules.predict, rules.correct, form))) < 1e-9
    assert gap(printed, answer(name)) > 1e-3


def test_points_on_the_state_alone_are_another_filter_near_by():
    far = gap(answer("MTSHCKF"), answer("HCKF"))
    assert 1e-6 < far < 0.5


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("p", [1, 3])
def test_projected_points(n, p):
    """2n² + 2n + 1 points for any number of biases, with the moments of the normal distribution to degree 5."""
    made = projected(n, of=cubature, biases=p, degree=5)
    assert made.evaluations <= 2 * n * n + 2 * n + 1
    points = np.concatenate([made.pairs, -made.pairs, np.zeros((1, n))])
    weights = np.r_[made.pair_weights, made.pair_weights, made.centre or 0.0]
    sigma_set(points, weights)
    for i in range(n):
        assert weights @ points[:, i] ** 4 == pytest.approx(3)
        assert all(weights @ (points[:, i] ** 2 * points[:, j] ** 2) == pytest.approx(1) for j in range(i))
    assert projected(n, of=cubature, biases=p, degree=3).evaluations == 2 * n + 1
    whole, part = scaled(n + p), projected(n, of=scaled, biases=p)
    assert part.centre_covariance - part.centre == pytest.approx(whole.centre_covariance - whole.centre)


def test_what_cannot_be_projected_is_refused():
    with pytest.raises(sigmax.InputError, match="symmetric"):
        projected(2, of=simplex, biases=1)
    rule = sigmax.rules.Marginal(sigmax.rules.Taylor1(), exact=True)
    with pytest.raises(sigmax.InputError, match="only a sigma set"):
        sigmax.run(sigmax.Filter(rule, rule, sigmax.forms.block), BIASED, PRIOR, record())
    mixed = sigmax.Filter(
        sigmax.rules.Marginal(sigmax.rules.Taylor1()),
        sigmax.rules.Taylor1(),
        sigmax.forms.two_stage(sigmax.forms.information),
    )
    with pytest.raises(sigmax.InputError, match="marginal rule takes the bias behind"):
        sigmax.run(mixed, BIASED, PRIOR, record())
    assert projected(2, of=gauss_hermite, biases=1).evaluations == 9


def test_no_negative_weights_up_to_four_components_of_the_state():
    """A set of n + p = 5 dimensions has them; the marginal filter's has n = 4."""
    assert (cubature(5, 5).pair_weights < 0).any()
    for n in range(1, 5):
        made = sigmax.get("MTSHCKF").on(3).predict.rule.points(n)
        assert (made.pair_weights > 0).all()
        assert made.centre > 0


class Augmented(Linear):
    """A linear problem of five components, the last two a bias: constant but for noise, added to motion and sensor."""

    def __init__(self):
        super().__init__(5, 2, seed=8)
        self.A[3:] = np.eye(5)[3:]
        for M in (self.Q, self.P0):
            M[:3, 3:] = M[3:, :3].T * 0
            M[3:, :3] = 0

    def model(self):
        A, H, Q = self.A, self.H, self.Q
        bias = sigmax.Bias(
            motion=A[:3, 3:], sensor=H[:, 3:], Q=Q[3:, 3:], prior=sigmax.Gaussian(self.x0[3:], self.P0[3:, 3:])
        )
        return sigmax.Model(motion=self.moved, sensor=self.seen, Q=Q[:3, :3], R=self.R, bias=bias)

    def moved(self, x, dt):
        return jnp.asarray(self.A[:3, :3]) @ x

    def seen(self, x):
        return jnp.asarray(self.H[:, :3]) @ x


LINEAR = Augmented()


@pytest.mark.parametrize("name", [*TWO_STAGE, *MARGINAL, "KF", "SRHCKFB", "SREIF"])
@pytest.mark.one_in(2)
def test_on_a_linear_model_every_filter_is_the_kalman_filter(name):
    p = LINEAR
    z = p.z.copy()
    z[2] = np.nan
    z[4, 1] = np.nan
    got = sigmax.run(name, p.model(), sigmax.Gaussian(p.x0[:3], p.P0[:3, :3]), z, dt=DT)
    means, covs = p.exact(z)
    sd = np.sqrt(np.einsum("...ii->...i", covs))
    assert got.ok.all()
    assert np.abs((np.c_[got.mean, got.bias_mean] - means) / sd).max() < 1e-10
    assert np.allclose(got.cov, covs[:, :3, :3], rtol=1e-9)
    assert np.allclose(got.bias_cov, covs[:, 3:, 3:], rtol=1e-9)


@pytest.mark.parametrize(("name", "plain"), [("EKF", "EKF"), ("MTSCKF", "CKF"), ("TSCKF", None)])
def test_a_bias_that_is_known_to_be_zero_is_none(name, plain):
    """Where points stand on the state alone, or there are none; else more dimensions move them."""
    none = model(sigmax.Gaussian(np.zeros(2), np.zeros((2, 2))), np.zeros(2))
    got = sigmax.run(name, none, PRIOR, record(), dt=DT)
    assert got.ok.all()
    assert np.abs(got.bias_mean).max() == 0
    assert np.abs(got.bias_cov).max() == 0
    if plain is not None:
        want = sigmax.run(plain, WITHOUT, PRIOR, record(), dt=DT)
        assert np.abs((got.mean - want.mean) / want.std).max() < 1e-9
        assert np.allclose(got.cov, want.cov, rtol=1e-9)


def test_without_a_bias_the_filters_with_stages_are_the_others():
    for name, plain in (("TSCKF", "CKF"), ("MTSCIF", "CIF"), ("TSCIF", "CIF")):
        assert sigmax.get(name).on(0).form is sigmax.get(plain).form
        assert sigmax.get(name).on(0).predict == sigmax.get(plain).predict
    assert sigmax.run("TSCKF", WITHOUT, PRIOR, record(), dt=DT).bias == ()


@pytest.mark.parametrize("name", ["TSCIF", "MTSCKF"])
def test_a_batch_is_a_loop_and_live_is_the_record(name):
    """Each track with its own prior of state and bias."""
    z = record()[15:45]
    means, biases = np.array([X0, X0 + 0.1]), np.array([B0, -B0])
    both = model(sigmax.Gaussian(biases, PB0))
    batch = sigmax.run(name, both, sigmax.Gaussian(means, P0), np.array([z, z]), dt=DT)
    live = sigmax.Live(name, model(sigmax.Gaussian(biases[1], PB0)), sigmax.Gaussian(means[1], P0))
    alone = sigmax.run(name, model(sigmax.Gaussian(biases[1], PB0)), sigmax.Gaussian(means[1], P0), z, dt=DT)
    assert batch.bias_mean.shape == (2, 30, 2)
    assert batch.bias_cov.shape == (2, 30, 2, 2)
    for k, row in enumerate(z):
        live.step(row, DT)
        for got, want in ((live.mean, batch.mean[1, k]), (live.bias_mean, batch.bias_mean[1, k])):
            assert np.allclose(got, want, rtol=1e-12, atol=1e-12)
        assert np.allclose(live.bias_cov, batch.bias_cov[1, k], rtol=1e-10)
        assert np.allclose(live.std, batch.std[1, k], rtol=1e-10)
    assert np.array_equal(alone.bias_mean, batch.bias_mean[1])
    assert not np.allclose(batch.bias_mean[0], batch.bias_mean[1])


def test_a_turned_angle_turns_the_answer():
    """The azimuth's offset belongs to the sensor, so a measurement on the other side of ±180° changes nothing."""
    z = record().copy()
    z[:, 0] += 2 * np.pi * np.random.default_rng(0).integers(-2, 3, len(z))
    assert gap(sigmax.run("TSCKF", BIASED, PRIOR, z, dt=DT), answer("TSCKF")) < 1e-9


def test_smoothing_state_and_bias():
    """On a linear model the smoother of the two-stage filter is that of the augmented one; it lowers the variance."""
    p = LINEAR
    prior = sigmax.Gaussian(p.x0[:3], p.P0[:3, :3])
    smoothed = {}
    for name in ("TSEKF", "MTSCKF"):
        filtered = sigmax.run(name, p.model(), prior, p.z, dt=DT)
        smoothed[name] = sigmax.smooth(name, p.model(), filtered, dt=DT)
    a, b = smoothed.values()
    assert gap(a, b) < 1e-9
    assert (a.bias_std[0] < filtered.bias_std[0]).all()
    with pytest.raises(sigmax.InputError, match="another order"):
        sigmax.smooth("TSEKF", p.model(), filtered, dt=DT)


def scaled_range(x, u):
    return jnp.hypot(x[0] - u[0], x[1] - u[1])[None]


def test_functions_of_interval_input_and_estimate():
    """B(dt), and F(x, u) = range: a scale of the ranges, linearised, of one sensor of two."""
    cv = sigmax.motions.constant_velocity()
    rng = np.random.default_rng(3)
    bias = sigmax.Bias(
        motion=lambda dt: jnp.zeros((4, 2)).at[2:, 0].set(dt),
        sensor={"beacon": lambda x, u: jnp.concatenate([jnp.zeros(1), scaled_range(x, u)])[None]},
        prior=sigmax.Gaussian([0.0, 0.0], [0.05**2, 0.1**2]),
        names=("acceleration", "scale"),
    )
    two = sigmax.Model(
        motion=cv,
        sensor={"beacon": scaled_range, "fix": lambda x: x[:2]},
        Q=cv.noise(1e-4),
        R={"beacon": [0.1**2], "fix": [1.0, 1.0]},
        bias=bias,
    )
    dt = rng.uniform(0.5, 1.5, 150)
    t = np.cumsum(dt)
    truth = np.c_[3 * t, 2 * t] + 0.5 * 0.03 * t[:, None] ** 2
    u = np.where(np.arange(150)[:, None] % 2, [400.0, 0.0], [0.0, 500.0])
    ranges = 1.04 * np.hypot(*(truth - u).T) + 0.1 * rng.standard_normal(150)
    z = {"beacon": ranges[:, None], "fix": truth + rng.standard_normal((150, 2))}
    z["fix"][40:] = np.nan
    prior = sigmax.Gaussian([0.0, 0.0, 3.0, 2.0], [4.0, 4.0, 1.0, 1.0])
    got = sigmax.run("MTSCKF", two, prior, z, dt=dt, inputs=u)
    assert got.ok.all()
    want = np.array([0.03, 0.04])
    assert np.abs((got.bias_mean[-1] - want) / got.bias_std[-1]).max() < 3
    assert (got.bias_std[-1] < [2e-3, 2e-3]).all()
    assert np.abs(got.mean[-1, :2] - truth[-1]).max() < 1


@pytest.mark.slow
@pytest.mark.parametrize("what", ["Q beside a function", "matrices"])
def test_derivatives_go_through_what_functions_of_both_capture(what):
    """Numbers that end in a function of state and bias together: those beside a noise that is one, and B and F."""

    def likelihood(q):
        bias = sigmax.Bias(
            motion=0.1 * jnp.ones((3, 2)) * (q if what == "matrices" else 1.0),
            sensor=jnp.ones((2, 2)) * (q if what == "matrices" else 1.0),
            Q=(lambda dt: jnp.ones(2) * dt) if what != "matrices" else None,
            prior=sigmax.Gaussian(np.zeros(2), np.ones(2)),
        )
        noise = jnp.ones(3) * (q if what != "matrices" else 0.1)
        made = sigmax.Model(
            motion=lambda x, dt: 0.9 * x,
            sensor=lambda x: x[:2],
            Q=noise,
            R=[1.0, 1.0],
            state=("a", "b", "c"),
            bias=bias,
        )
        z = np.random.default_rng(0).standard_normal((6, 2))
        return sigmax.run("EKF", made, sigmax.Gaussian(np.zeros(3), np.ones(3)), z).log_likelihood

    exact = jax.grad(likelihood)(0.3)
    assert exact == pytest.approx((likelihood(0.3 + 1e-6) - likelihood(0.3 - 1e-6)) / 2e-6, rel=1e-5)


@pytest.mark.slow
def test_derivatives_go_through_a_bias():
    """A noise of the bias is fitted by the likelihood like any other number."""

    def build(p):
        return model(noise=jnp.ones(2) * p["q"]), PRIOR

    def negative(q):
        return -sigmax.run("EKF", *build({"q": q}), record()[:20], dt=DT).log_likelihood

    exact = jax.grad(negative)(1e-3)
    step = 1e-6
    assert exact == pytest.approx((negative(1e-3 + step) - negative(1e-3 - step)) / (2 * step), rel=1e-4)


def model_with(prior, **given):
    bias = sigmax.Bias(prior=prior, **given)
    return sigmax.Model(motion=motion, sensor=sensor, Q=Q, R=R, state=NAMES, measurement=SEEN, bias=bias)


def run_with(prior, **given):
    return sigmax.run("EKF", model_with(prior, **given), PRIOR, record(), dt=DT)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motion": np.ones((2, 2))}, "B must have 3 rows"),
        ({"motion": np.ones((3, 3))}, "a column for each of the 2 components"),
        ({"sensor": {"radar": np.ones((2, 2))}}, "one sensor: give sensor=F itself"),
        ({}, "must act on something"),
        ({"sensor": F, "names": ("rate", "b")}, "state and bias have components of the same name: \\['rate'\\]"),
        ({"sensor": {}}, "must act on something"),
        ({"sensor": {"radar": None}}, "must act on something"),
        ({"sensor": F, "names": ("b",)}, "2 different names"),
        ({"sensor": F, "names": ("b", "c", "c")}, "2 different names"),
        ({"sensor": F, "names": (1, 2)}, "one or several names in quotes"),
        ({"sensor": F, "Q": [-1.0, 1.0]}, "bias's Q must be positive semidefinite"),
        ({"sensor": F, "Q": lambda dt: jnp.ones(3)}, "bias's Q\\(…\\) must give a covariance of shape \\(2, 2\\)"),
        ({"sensor": F, "Q": lambda x, dt: -jnp.ones(2)}, "bias's Q\\(…\\) at the start must be positive semidefinite"),
        ({"sensor": lambda x: jnp.ones((2, 1))}, "F must have the shape \\(2, 2\\)"),
    ],
)
def test_what_does_not_fit_is_refused(given, said):
    with pytest.raises(sigmax.InputError, match=said):
        run_with(sigmax.Gaussian(B0, PB0), **given)


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_live_refuses_a_function_with_too_many_columns(backend):
    """Found when the filter is made."""
    made = model_with(sigmax.Gaussian(B0, PB0), sensor=lambda x: jnp.ones((2, 3)))
    with pytest.raises(sigmax.InputError, match=r"the sensor's bias F must have the shape \(2, 2\); it has \(2, 3\)"):
        sigmax.Live("EKF", made, PRIOR, backend=backend).update(record()[0])


def test_a_function_that_fails_is_named():
    with pytest.raises(TypeError) as failed:
        run_with(sigmax.Gaussian(B0, PB0), sensor=lambda x: x["north"])
    assert any("evaluating the sensor's bias F" in note for note in failed.value.__notes__)


@pytest.mark.parametrize(("name", "fault"), [("HCKF", "PREDICTION_WIDENED"), ("MTSHCKF", "NONE")])
def test_a_covariance_that_negative_weights_make_indefinite_is_told(name, fault):
    """In 4 + 2 dimensions Var(x⁴) comes out negative; the points on the four of the state have no such weights."""
    steep = sigmax.Model(
        motion=lambda x, dt: x.at[0].add(x[0] ** 4),
        sensor=lambda x: x[1:2],
        Q=np.full(4, 0.01),
        R=[0.1],
        bias=sigmax.Bias(sensor=np.ones((1, 2)), prior=sigmax.Gaussian(np.zeros(2), np.eye(2))),
    )
    got = sigmax.run(name, steep, sigmax.Gaussian(np.zeros(4), np.eye(4)), np.full((1, 1), np.nan))
    assert got.fault.tolist() == [int(sigmax.running.Fault[fault])]
    assert got.ok.tolist() == [fault == "NONE"]
    assert np.linalg.eigvalsh(got.cov[0]).min() > 0
    assert got.cov[0, 0, 0] > 1


def test_what_knows_states_alone_refuses_a_bias_in_words():
    """Rows, as trackers have them, hold no bias; nothing forgets one."""
    with pytest.raises(sigmax.InputError, match="augment"):
        RowSteps("EKF", BIASED)
    with pytest.raises(sigmax.InputError, match="augment"):
        sigmax.start(BIASED, record()[:3])
    with pytest.raises(sigmax.InputError, match="into the state first"):
        moving(BIASED, np.zeros(3), 1.0, None)
