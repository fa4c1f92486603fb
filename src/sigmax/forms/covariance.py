"""The covariance form: P itself, and its factor for the next points."""

import jax

from sigmax.algebra.arrays import inner, outer, times
from sigmax.algebra.factor import Matrix, cholesky, solve_lower, square
from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.rules.linearization import Linearization


def spread_of(line: Linearization, noise: Matrix) -> jax.Array:
    """E Eᵀ + N Nᵀ − D Dᵀ + noise noiseᵀ: the covariance of what was linearised."""
    P = square(noise)
    for columns in (line.slope, line.residual):
        if columns.shape[1]:
            P = P + outer(columns, columns)
    if line.deficit.shape[1]:
        P = P - outer(line.deficit, line.deficit)
    return P


def _predict(line: Linearization, Lq: Matrix) -> Predicted:
    P = spread_of(line, Lq)
    S, sound = cholesky(P)
    return Predicted(S, P, sound)


def _correct(S: jax.Array, P: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """P⁺ = P − K P_yy Kᵀ, with K P_yy Kᵀ = GᵀG, G = S_y⁻¹ P_yx."""
    Sy, innovation_sound = cholesky(spread_of(line, Lr))
    G = solve_lower(Sy, outer(line.slope, S))
    whitened = solve_lower(Sy, nu)
    corrected = P - inner(G, G)
    factor, sound = cholesky(corrected)
    shift = times(G.swapaxes(0, 1), whitened)
    return Corrected(shift, factor, corrected, whitened, Sy, innovation_sound & sound)


def _start(S: jax.Array) -> jax.Array:
    return outer(S, S)


# Functions with names, so that a filter can be pickled.
covariance = Form("covariance", _start, _predict, _correct)
