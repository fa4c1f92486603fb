"""The numerics that can fail, on random triangles, also ones without full rank."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmax.algebra.factor import Diagonal, absorb, add, cholesky, downdate, inverse_lower, solve_lower, tria
from sigmax.algebra.rotations import rotate

N, K = 4, 6
seeds = st.integers(0, 2**32 - 1)
functions = {
    f.__name__: jax.jit(f) for f in (absorb, add, cholesky, downdate, inverse_lower, rotate, solve_lower, tria)
}


def triangle(rng, spread=3.0):
    L = np.tril(rng.standard_normal((N, N))) * 10 ** rng.uniform(-spread, spread, (N, 1))
    np.fill_diagonal(L, np.abs(np.diagonal(L)))
    return L


def scale(P):
    d = np.sqrt(np.diagonal(P))
    return np.outer(d, d) + 1e-300


def is_factor_of(L, P, tolerance=1e-13):
    L = np.asarray(L)
    assert (np.triu(L, 1) == 0).all()
    assert (np.diagonal(L) >= 0).all()
    assert (np.abs(L @ L.T - P) / scale(P)).max() < tolerance


@given(seeds)
def test_cholesky(seed):
    L = triangle(np.random.default_rng(seed))
    found, sound = functions["cholesky"](L @ L.T)
    assert sound
    is_factor_of(found, L @ L.T)


@given(seeds, st.integers(1, N - 1))
def test_cholesky_of_a_matrix_without_full_rank(seed, rank):
    A = np.random.default_rng(seed).standard_normal((N, rank))
    P = A @ A.T
    found, sound = functions["cholesky"](P)
    assert sound
    is_factor_of(found, P, 1e-7)


def test_cholesky_says_when_there_is_none():
    P = np.array([[1.0, 2, 0, 0], [2, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert not functions["cholesky"](P)[1]
    assert not functions["cholesky"](P * np.nan)[1]


@given(seeds)
def test_triangularisation(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((N, K)) * 10 ** rng.uniform(-3, 3, (N, 1))
    is_factor_of(functions["tria"](A), A @ A.T)


@given(seeds, st.booleans())
def test_absorbing_columns(seed, diagonal):
    """[[L, A], [0, B]] keeps its products: sum of covariances, gain and correction."""
    rng = np.random.default_rng(seed)
    L = np.abs(np.diag(rng.standard_normal(N))) if diagonal else triangle(rng, 1.0)
    A, B = rng.standard_normal((N, K)), rng.standard_normal((3, K))
    got = functions["absorb"](Diagonal(jnp.asarray(np.diagonal(L).copy())) if diagonal else L, A, B)
    is_factor_of(got.factor, L @ L.T + A @ A.T)
    assert np.allclose(got.cross @ got.factor.T, B @ A.T, atol=1e-11)
    assert np.allclose(got.cross @ got.cross.T + got.rest @ got.rest.T, B @ B.T, atol=1e-11)


@given(seeds, st.booleans())
def test_rotating_keeps_a_triangle(seed, diagonal):
    """The same as absorbing, and what is left of a lower triangle is one."""
    rng = np.random.default_rng(seed)
    L = np.abs(np.diag(rng.standard_normal(N))) if diagonal else triangle(rng, 1.0)
    A, B = rng.standard_normal((N, K)), np.tril(rng.standard_normal((K, K)))
    np.fill_diagonal(B, np.abs(np.diagonal(B)))
    got = functions["rotate"](Diagonal(jnp.asarray(np.diagonal(L).copy())) if diagonal else L, A, B)
    is_factor_of(got.factor, L @ L.T + A @ A.T)
    assert np.allclose(got.cross @ got.factor.T, B @ A.T, atol=1e-11)
    is_factor_of(got.rest, B @ B.T - got.cross @ got.cross.T, 1e-11)


def test_absorbing_into_nothing_and_nothing():
    zero = Diagonal(jnp.zeros(N))
    got = functions["add"](zero, jnp.zeros((N, K)))
    assert not np.asarray(got).any()


@given(seeds, st.integers(1, 3))
def test_downdate(seed, columns):
    rng = np.random.default_rng(seed)
    L, V = triangle(rng, 1.0) + 0.1 * np.eye(N), rng.standard_normal((N, columns))
    full = functions["add"](L, V)
    found, sound = functions["downdate"](full, V)
    assert sound
    is_factor_of(found, L @ L.T, 1e-9)


def test_downdate_says_when_there_is_no_factor():
    _, sound = functions["downdate"](np.eye(N), np.full((N, 1), 0.6))
    assert not sound
    kept, sound = functions["downdate"](np.diag([1.0, 0, 1, 1]), np.array([[0.5], [0], [0], [0]]))
    assert sound
    assert kept[1, 1] == 0


@given(seeds)
def test_solving(seed):
    rng = np.random.default_rng(seed)
    L, b = triangle(rng, 1.0) + np.eye(N), rng.standard_normal((N, 2))
    assert np.allclose(L @ functions["solve_lower"](L, b), b)
    assert np.allclose(L @ functions["inverse_lower"](L), np.eye(N))


@pytest.mark.parametrize("name", ["tria", "cholesky", "add"])
def test_derivatives_also_where_the_argument_is_triangular_already(name):
    """The exact derivative of L(t) with L Lᵀ = A(t) A(t)ᵀ, by differences, at a triangular A."""
    rng = np.random.default_rng(4)
    L, D = triangle(rng, 0.3) + np.eye(N), rng.standard_normal((N, N))

    def value(t):
        A = jnp.asarray(L) + t * jnp.asarray(D)
        if name == "cholesky":
            return cholesky(A @ A.T)[0]
        return tria(A) if name == "tria" else add(Diagonal(jnp.ones(N)), A)

    exact, value = jax.jit(jax.jacfwd(value))(0.0), jax.jit(value)
    step = 1e-6
    assert np.allclose(exact, (value(step) - value(-step)) / (2 * step), atol=1e-7)
