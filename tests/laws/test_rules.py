"""Rules are exact to their degree and not beyond; what users bring is checked."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sigmax
from sigmax.rules import Taylor1, Taylor2, cubature, gauss_hermite, scaled, sigma_set, simplex, unscented
from sigmax.rules.sigma import SigmaPoints


def points_of(unit):
    pairs, singles = (unit.pairs, unit.pair_weights), (unit.singles, unit.single_weights)
    points = np.concatenate([pairs[0], -pairs[0], singles[0]])
    weights = np.concatenate([pairs[1], pairs[1], singles[1]])
    if unit.centre is not None:
        points, weights = np.vstack([points, np.zeros(unit.dimension)]), np.append(weights, unit.centre)
    return points, weights


def moment(powers):
    """E Π ξ_i^p_i of independent standard normal variables."""
    return np.prod([0.0 if p % 2 else float(np.prod(np.arange(p - 1, 0, -2))) for p in powers])


def worst(unit, degree):
    points, weights = points_of(unit)
    n = unit.dimension
    exponents = [p for p in itertools.product(range(degree + 1), repeat=n) if sum(p) == degree]
    return max(abs(weights @ np.prod(points**p, axis=1) - moment(p)) for p in np.array(exponents))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
@pytest.mark.parametrize(
    ("family", "parameters", "degree"),
    [
        (unscented, {}, 3),
        (unscented, {"w0": 0.3}, 3),
        (scaled, {"alpha": 0.5, "beta": 2, "kappa": 1}, 3),
        (cubature, {"degree": 5}, 5),
        (gauss_hermite, {"order": 3}, 5),
        (simplex, {}, 2),
    ],
)
def test_sets_are_exact_to_their_degree_and_not_beyond(family, parameters, degree, n):
    unit = family(n, **parameters)
    for d in range(degree + 1):
        assert worst(unit, d) < 1e-10
    assert max(worst(unit, degree + 1), worst(unit, degree + 2)) > 1e-3


def test_the_number_of_points():
    assert cubature(5).evaluations == 10
    assert cubature(4, degree=5).evaluations == 25
    assert cubature(5, degree=5).evaluations == 51
    assert simplex(5).evaluations == 6
    assert gauss_hermite(3, order=3).evaluations == 27
    assert scaled(5).evaluations == 11


def test_the_first_component_of_a_simplex_takes_two_values():
    points, _ = points_of(simplex(7))
    assert [len(np.unique(np.round(points[:, : i + 1], 12), axis=0)) for i in range(7)] == [2, 3, 4, 5, 6, 7, 8]


def quadratic(c, B, A):
    """g(x) = c + B x + xᵀ A x for x (n, ...)."""

    def g(x):
        constant = c.reshape((len(c),) + (1,) * (x.ndim - 1))
        return constant + jnp.tensordot(B, x, 1) + jnp.einsum("mij,i...,j...->m...", A, x, x)

    return g


def random_quadratic(rng, n, m):
    A = rng.standard_normal((m, n, n))
    return rng.standard_normal(m), rng.standard_normal((m, n)), A + A.swapaxes(1, 2)


def regression(rule):
    """The rule on quadratic functions given by their coefficients, compiled once."""
    return jax.jit(lambda x, S, c, B, A: rule(quadratic(c, B, A), x, S, (False,) * 2))


SECOND_ORDER = regression(Taylor2())
OF_SETS = {
    "pairs, negative weights": (regression(SigmaPoints(cubature, degree=5)), cubature(5, degree=5)),
    "points without twins": (regression(SigmaPoints(simplex)), simplex(5)),
}


def triangle(rng, n):
    S = np.tril(rng.standard_normal((n, n)))
    np.fill_diagonal(S, np.abs(np.diagonal(S)) + 0.1)
    return S


@given(st.integers(0, 10**6))
def test_second_order_is_exact_for_quadratic_functions(seed):
    """Mean, covariance and cross covariance of c + Bx + xᵀAx, x normal, by their closed forms."""
    rng = np.random.default_rng(seed)
    c, B, A = random_quadratic(rng, 3, 2)
    x, S = rng.standard_normal(3), triangle(rng, 3)
    P = S @ S.T
    line = SECOND_ORDER(x, S, c, B, A)
    slope = B + 2 * A @ x
    mean = c + B @ x + np.einsum("mij,i,j->m", A, x, x) + np.einsum("mij,ij->m", A, P)
    cov = slope @ P @ slope.T + 2 * np.einsum("aij,jk,bkl,li->ab", A, P, A, P)
    scale = np.abs(cov).max() + 1
    assert np.allclose(line.mean, mean, atol=1e-10 * scale)
    assert np.allclose(line.slope @ line.slope.T + line.residual @ line.residual.T, cov, atol=1e-10 * scale)
    assert np.allclose(S @ line.slope.T, P @ slope.T, atol=1e-10 * scale)


def test_each_extra_term_of_second_order_can_be_left_out():
    rng = np.random.default_rng(3)
    c, B, A = random_quadratic(rng, 3, 2)
    x, S = rng.standard_normal(3), np.eye(3) * 0.3
    rules = (Taylor2(), Taylor2(mean=False), Taylor2(covariance=False), Taylor1())
    full, without_mean, without_covariance, first = (regression(rule)(x, S, c, B, A) for rule in rules)
    assert np.allclose(without_mean.mean, first.mean)
    assert not np.allclose(full.mean, first.mean)
    assert np.allclose(without_covariance.mean, full.mean)
    assert without_covariance.residual.shape == (2, 0)
    assert np.allclose(without_mean.residual, full.residual)


@pytest.mark.parametrize("kind", OF_SETS)
@given(seed=st.integers(0, 10**6))
def test_regression_of_any_set_gives_the_moments_of_its_points(kind, seed):
    """Folded pairs, single points and negative weights give the plain weighted sums."""
    rule, unit = OF_SETS[kind]
    rng = np.random.default_rng(seed)
    c, B, A = random_quadratic(rng, 5, 2)
    points, weights = points_of(unit)
    x, S = rng.standard_normal(5), triangle(rng, 5)
    line = rule(x, S, c, B, A)
    at = x[:, None] + S @ points.T
    y = c[:, None] + B @ at + np.einsum("mij,ik,jk->mk", A, at, at)
    mean = y @ weights
    deviation = y - mean[:, None]
    scale = np.abs(deviation).max() ** 2 + 1
    plain = (deviation * weights) @ deviation.T
    signed = line.slope @ line.slope.T + line.residual @ line.residual.T - line.deficit @ line.deficit.T
    assert np.allclose(line.mean, mean, atol=1e-10 * scale)
    assert np.allclose(signed, plain, atol=1e-9 * scale)
    assert np.allclose(S @ line.slope.T, S @ (deviation * weights @ points).T, atol=1e-9 * scale)


def test_a_simplex_leaves_nothing_over():
    rule = SigmaPoints(simplex)
    line = rule(jnp.sin, jnp.ones(3), jnp.eye(3), (False,) * 3)
    assert line.residual.shape == (3, 0)


def own(n):
    return sigma_set(np.vstack([np.eye(n), -np.eye(n)]) * np.sqrt(n), np.full(2 * n, 1 / (2 * n)))


def test_a_set_of_ones_own_is_used_like_the_built_in_ones():
    x, S = jnp.asarray([0.3, -0.2]), jnp.asarray([[0.5, 0.0], [0.1, 0.4]])
    mine, theirs = (rule(jnp.exp, x, S, (False, False)) for rule in (SigmaPoints(own), SigmaPoints(cubature, degree=3)))
    assert np.allclose(mine.mean, theirs.mean)
    assert np.allclose(mine.slope, theirs.slope)


@pytest.mark.parametrize(
    ("points", "weights", "says"),
    [
        (np.eye(2), [0.5, 0.5], "mean"),
        ([[1.0], [-1.0]], [0.4, 0.4], "sum of weights"),
        ([[2.0], [-2.0]], [0.5, 0.5], "covariance"),
        ([[1.0], [-1.0]], [1.0], "one weight a point"),
    ],
)
def test_a_set_that_is_none_is_refused_with_what_it_gives(points, weights, says):
    with pytest.raises(ValueError, match=says):
        sigma_set(points, weights)


def test_names_and_parameters_that_are_not_known_get_a_suggestion():
    with pytest.raises(sigmax.InputError, match=r"did you mean.*SRCKFB"):
        sigmax.get("SRCKBF")
    with pytest.raises(sigmax.InputError, match="alpha, beta, kappa, w0"):
        sigmax.get("UKF", gamma=1)
    with pytest.raises(sigmax.InputError, match="one kind"):
        sigmax.get("UKF", w0=0.1, alpha=1)
    with pytest.raises(sigmax.InputError, match="exact"):
        sigmax.get("CIF", information="exakt")
