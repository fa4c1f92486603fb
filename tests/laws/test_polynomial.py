"""The polynomial family: exact for quadratic models, each of its four terms a switch, models by their matrices."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sigmax
from sigmax import InputError, rules
from sigmax.rules import SigmaPoints, Taylor, Taylor1, Taylor2

rng = np.random.default_rng(7)
N, M = 3, 2
PHI = rng.standard_normal(N) * 0.1, np.eye(N) + 0.1 * rng.standard_normal((N, N)), 0.05 * rng.standard_normal((N, N, N))
H = rng.standard_normal(M), rng.standard_normal((M, N)), 0.3 * rng.standard_normal((M, N, N))
MEAN = rng.standard_normal(N)
FACTOR = np.tril(0.4 * rng.standard_normal((N, N))) + 0.5 * np.eye(N)


def moments(line):
    E, R, D = (np.asarray(a) for a in (line.slope, line.residual, line.deficit))
    return np.asarray(line.mean), E @ E.T + R @ R.T - D @ D.T, FACTOR @ E.T


MOTION, SENSOR = sigmax.motions.quadratic(*PHI), sigmax.sensors.quadratic(*H)
MODEL = sigmax.Model(motion=MOTION, sensor=SENSOR, Q=MOTION.noise(np.full(N, 0.01)), R=np.full(M, 0.1))


def moved(x):
    return MOTION.function(x, 0.3)


@pytest.mark.parametrize("g", [moved, SENSOR.function])
def test_moments_of_quadratic_functions_are_exact(g):
    columns = jax.vmap(g, in_axes=-1, out_axes=-1)

    def over_points(x):
        return g(x) if x.ndim == 1 else columns(x)

    x, S, plain = jnp.asarray(MEAN), jnp.asarray(FACTOR), (False,) * len(g(jnp.asarray(MEAN)))
    exact = moments(SigmaPoints(rules.gauss_hermite, order=3)(over_points, x, S, plain))
    for mine, theirs in zip(moments(Taylor2()(over_points, x, S, plain)), exact, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, atol=1e-12)
    draws = np.random.default_rng(0).standard_normal((N, 400_000))
    y = np.asarray(columns(x[:, None] + S @ draws))
    mean, cov, cross = exact
    scale = np.sqrt(np.diag(cov))
    np.testing.assert_allclose(y.mean(1) / scale, mean / scale, atol=8e-3)
    np.testing.assert_allclose(np.cov(y) / np.outer(scale, scale), cov / np.outer(scale, scale), atol=2e-2)
    np.testing.assert_allclose(FACTOR @ draws @ (y - y.mean(1)[:, None]).T / draws.shape[1], cross, atol=2e-2)


def polynomial(n, degree, seed):
    """Three random polynomials of n variables."""
    powers = np.array([e for e in product(range(degree + 1), repeat=n) if sum(e) <= degree])
    A = np.random.default_rng(seed).standard_normal((3, len(powers)))
    return lambda x: jnp.asarray(A) @ jnp.prod(x[None] ** jnp.asarray(powers), axis=1)


@pytest.mark.parametrize(
    ("n", "order"),
    [
        pytest.param(n, order, marks=[pytest.mark.slow] * (n + order not in (4, 5)))
        for n, order in product((1, 2, 3), (1, 2, 3, 4))
    ],
)
@pytest.mark.one_in(2)
def test_the_taylor_rule_of_an_order_is_exact_for_polynomials_of_that_degree(n, order):
    """Mean, slope and covariance are the integrals over a grid of Gauss and Hermite, and not beyond that degree."""
    x, S = MEAN[:n], np.tril(np.random.default_rng(order).standard_normal((n, n)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(order + 2)
    xi = np.array(list(product(nodes, repeat=n)))
    w = np.prod(list(product(weights / weights.sum(), repeat=n)), axis=1)

    def apart(degree):
        g = polynomial(n, degree, seed=n)
        y = np.asarray(jax.vmap(g)(x + xi @ S.T))
        mean = w @ y
        slope, cov = (y - mean).T @ (w[:, None] * xi), (y - mean).T @ (w[:, None] * (y - mean))
        line = Taylor(order)(g, jnp.asarray(x), jnp.asarray(S), (False,) * 3)
        E, R = np.asarray(line.slope), np.asarray(line.residual)
        pairs = ((line.mean, mean), (E, slope), (E @ E.T + R @ R.T, cov))
        return max(np.abs(a - b).max() / np.abs(b).max() for a, b in pairs)

    assert apart(order) < 1e-13
    assert apart(order + 1) > 1e-3


@pytest.mark.parametrize(("order", "rule"), [(1, Taylor1()), (2, Taylor2())])
def test_orders_one_and_two_are_the_rules_of_their_own(order, rule):
    given = SENSOR.function, jnp.asarray(MEAN), jnp.asarray(FACTOR), (False,) * M
    for mine, theirs in zip(moments(Taylor(order)(*given)), moments(rule(*given)), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-13)


def test_quadratic_models_take_known_inputs():
    U, u = np.arange(6.0).reshape(N, 2), np.array([0.5, -2.0])
    moved_by = sigmax.motions.quadratic(*PHI, Phi_u=U).function(MEAN, 0.3, u)
    np.testing.assert_allclose(moved_by, np.asarray(moved(MEAN)) + U @ u, rtol=1e-13)
    seen = sigmax.sensors.quadratic(*H, H_u=U[:M]).function(MEAN, u)
    np.testing.assert_allclose(seen, np.asarray(SENSOR.function(MEAN)) + U[:M] @ u, rtol=1e-13)
    with pytest.raises(InputError, match="Phi_u must have the shape"):
        sigmax.motions.quadratic(*PHI, Phi_u=U.T)


def test_matrices_mean_what_the_formula_says():
    for function, (c, L, B) in ((moved, PHI), (SENSOR.function, H)):
        value = function(jnp.asarray(MEAN))
        wanted = [c[j] + L[j] @ MEAN + MEAN @ B[j] @ MEAN for j in range(len(c))]
        np.testing.assert_allclose(value, wanted, rtol=1e-13)


def filtered(name, **switches):
    z = np.random.default_rng(1).standard_normal((8, M)) + np.asarray(H[0])
    chosen = sigmax.get(name, **switches)
    return sigmax.run(chosen, MODEL, sigmax.Gaussian(MEAN, FACTOR @ FACTOR.T), z)


@pytest.mark.parametrize(
    "family", [("PF", "SRPF", "SRPFB", "PIF"), ("SOKF", "SRSOKF", "SRSOKFB", "SOIF"), ("TKF", "SRTKF", "SRTKFB")]
)
def test_all_forms_agree(family):
    first, *others = (filtered(name) for name in family)
    for other in others:
        np.testing.assert_allclose(other.mean, first.mean, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(other.cov, first.cov, rtol=1e-8, atol=1e-11)


def test_each_term_is_a_switch():
    whole = filtered("PF")
    switches = ("d_motion", "D_motion", "d_sensor", "D_sensor")
    for switch in switches:
        assert np.abs(filtered("PF", **{switch: False}).mean - whole.mean).max() > 1e-3
    np.testing.assert_array_equal(filtered("PF", D_motion=False).mean, filtered("SOKF").mean)
    np.testing.assert_array_equal(filtered("PF", D_motion=0).cov, filtered("SOKF").cov)
    extended = filtered("PF", **dict.fromkeys(switches, False))
    np.testing.assert_allclose(extended.mean, filtered("EKF").mean, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(extended.cov, filtered("EKF").cov, rtol=1e-11, atol=1e-13)
    with pytest.raises(InputError, match="SOKF has no parameter 'D_motion'"):
        sigmax.get("SOKF", D_motion=True)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ((PHI[0], PHI[1], PHI[2][:2]), "must have the shapes"),
        ((PHI[0][:2], PHI[1], PHI[2]), "must have the shapes"),
        ((PHI[0], PHI[1] * np.nan, PHI[2]), "Phi_x must be finite"),
        ((PHI[0], "text", PHI[2]), "Phi_x must be an array of real numbers"),
    ],
)
def test_matrices_that_do_not_fit_are_refused(given, says):
    with pytest.raises(InputError, match=says):
        sigmax.motions.quadratic(*given)


@pytest.mark.parametrize("name", ["PF", "SRPFB"])
def test_the_polynomial_filter_is_an_ekf_with_more_noise(name):
    """Stepanov et al., (37)-(38): d as known inputs, D as variances of more noise; recursion written out by hand."""
    f, h = (lambda x: 1 + 0.8 * x - 0.2 * x**2), (lambda x: x + 0.5 * x**2)
    df, dh, f2, h2, q, r = (lambda x: 0.8 - 0.4 * x), (lambda x: 1 + x), -0.4, 1.0, 0.3, 0.02
    z = np.random.default_rng(3).normal(2.0, 1.0, (30, 1))
    model = sigmax.Model(motion=lambda x, dt: f(x), sensor=h, Q=[q], R=[r])
    own = sigmax.run(name, model, sigmax.Gaussian([1.0], [1.0]), z)
    x, P = 1.0, 1.0
    for k, (measured,) in enumerate(z):
        known, more = 0.5 * f2 * P, 0.5 * (f2 * P) ** 2
        ahead, before = f(x) + known, df(x) ** 2 * P + q + more  # an EKF of f + d and q + D
        seen, doubt = 0.5 * h2 * before, 0.5 * (h2 * before) ** 2
        K = before * dh(ahead) / (dh(ahead) ** 2 * before + r + doubt)
        x, P = ahead + K * (measured - h(ahead) - seen), (1 - K * dh(ahead)) * before
        assert abs(own.mean[k, 0] - x) < 1e-11 * np.sqrt(P)
        assert abs(own.cov[k, 0, 0] / P - 1) < 1e-10
