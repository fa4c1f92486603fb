"""The noise of a linearisation, what its slope does not explain, and the prediction, which adds the two."""

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import outer
from sigmax.algebra.factor import Matrix, add, cholesky, dense, downdate, square
from sigmax.forms.form import Predicted
from sigmax.rules.linearization import Linearization


def noise_factor(line: Linearization, L: Matrix) -> tuple[Matrix, jax.Array]:
    """R̃ with R̃ R̃ᵀ = N Nᵀ − D Dᵀ + L Lᵀ, and whether it exists (...)."""
    if line.residual.shape[1]:
        L = add(L, line.residual)
    if line.deficit.shape[1]:
        return downdate(dense(L), line.deficit)
    return L, jnp.ones(line.mean.shape[1:], bool)


def predict(line: Linearization, Lq: Matrix) -> Predicted:
    """S = tria[L_q, E, N], less the columns D: the downdate comes last, from the largest triangle."""
    return _less(add(Lq, jnp.concatenate([line.slope, line.residual], axis=1)), line.deficit)


def predict_squared(line: Linearization, Lq: Matrix) -> Predicted:
    """The same with N Nᵀ + Q as a covariance, which is cheaper for many columns N; E is never squared."""
    if line.residual.shape[1]:
        Lq, _ = cholesky(outer(line.residual, line.residual) + square(Lq))
    return _less(add(Lq, line.slope), line.deficit)


def _less(S: jax.Array, deficit: jax.Array) -> Predicted:
    if deficit.shape[1]:
        return Predicted(*downdate(S, deficit))
    return Predicted(S, jnp.ones(S.shape[2:], bool))
