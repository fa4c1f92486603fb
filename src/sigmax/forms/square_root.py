"""The square-root forms: only factors, with two triangularisations or with one block array."""

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import outer, product, times
from sigmax.algebra.factor import Diagonal, Matrix, absorb, add, dense, downdate, inverse_lower, solve_lower, tria
from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.rules.linearization import Linearization


def _noise(line: Linearization, L: Matrix) -> tuple[Matrix, jax.Array]:
    """Factor of what is not explained by the slope, N Nᵀ − D Dᵀ + L Lᵀ, and whether it exists."""
    sound = jnp.ones(line.mean.shape[1:], bool)
    if line.residual.shape[1]:
        L = add(L, line.residual)
    if line.deficit.shape[1]:
        L, sound = downdate(dense(L), line.deficit)
    return L, sound


def _predict(line: Linearization, Lq: Matrix) -> Predicted:
    """S = tria[L_q, E, N], less the columns D: the downdate comes last, from the largest triangle."""
    S = add(Lq, jnp.concatenate([line.slope, line.residual], axis=1))
    sound = jnp.ones(line.mean.shape[1:], bool)
    if line.deficit.shape[1]:
        S, sound = downdate(S, line.deficit)
    return Predicted(S, (), sound)


def _correct_twice(S: jax.Array, carried: tuple[()], line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Two triangularisations: S_y = tria[E, R̃] and S⁺ = tria[S − K E, K R̃], with R̃ = tria[L_r, N]."""
    Lr, sound = _noise(line, Lr)
    Sy = add(Lr, line.slope)
    G = solve_lower(Sy, outer(line.slope, S))
    K = product(G.swapaxes(0, 1), inverse_lower(Sy))
    whitened = solve_lower(Sy, nu)
    factor = tria(jnp.concatenate([S - product(K, line.slope), product(K, dense(Lr))], axis=1))
    return Corrected(times(G.swapaxes(0, 1), whitened), factor, (), whitened, Sy, sound)


def _correct_block(S: jax.Array, carried: tuple[()], line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """[[R̃, E], [0, S]] triangularised at once to [[S_y, 0], [K S_y, S⁺]]."""
    Lr, sound = _noise(line, Lr)
    Sy, gain, rest = absorb(Lr, line.slope, S)
    whitened = solve_lower(Sy, nu)
    return Corrected(times(gain, whitened), tria(rest), (), whitened, Sy, sound)


def _correct_information(S: jax.Array, carried: tuple[()], line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """The sum of information in units of S: S⁺ = S D, D Dᵀ = (I + Gᵀ G)⁻¹, G = R̃⁻¹ E; no inverse of S or P."""
    Lr, sound = _noise(line, Lr)
    whitening = dense(Lr)
    G, weighted = solve_lower(whitening, line.slope), solve_lower(whitening, nu)
    one = Diagonal(jnp.ones(G.shape[1:], G.dtype))
    # The factor of I + Gᵀ G with rows and columns reversed is upper; the transposed inverse of that is lower.
    upper = add(one, G.swapaxes(0, 1)[::-1])[::-1, ::-1]
    D = inverse_lower(upper.swapaxes(0, 1))
    shift = times(S, times(D, times(D.swapaxes(0, 1), times(G.swapaxes(0, 1), weighted))))
    Sy = add(Lr, line.slope)
    return Corrected(shift, product(S, D), (), solve_lower(Sy, nu), Sy, sound)


def _nothing(S: jax.Array) -> tuple[()]:
    return ()


square_root = Form("square root", _nothing, _predict, _correct_twice)
block = Form("square root, block", _nothing, _predict, _correct_block)
root_information = Form("square root, information", _nothing, _predict, _correct_information)
