"""The information form: the inverse of the covariance, to which measurements add."""

import jax

from sigmax.algebra.arrays import inner, product, times
from sigmax.algebra.factor import Matrix, cholesky, inverse_lower, solve_lower, square
from sigmax.forms.covariance import spread_of
from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.rules.linearization import Linearization


def _invert(S: jax.Array) -> jax.Array:
    inverse = inverse_lower(S)
    return inner(inverse, inverse)


def factor_of_inverse(Y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Lower S with S Sᵀ = Y⁻¹, from the factor of Y with rows and columns reversed: no P is formed."""
    flipped, sound = cholesky(Y[::-1, ::-1])
    upper = flipped[::-1, ::-1]
    return inverse_lower(upper.swapaxes(0, 1)), sound


def _predict(line: Linearization, Lq: Matrix) -> Predicted:
    S, sound = cholesky(spread_of(line, Lq))
    return Predicted(S, _invert(S), sound)


def _correct(exact: bool, S: jax.Array, Y: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    unexplained = line._replace(slope=line.slope[:, :0])
    Lw, weight_sound = cholesky(spread_of(unexplained, Lr) if exact else square(Lr))
    A = product(line.slope, inverse_lower(S))
    root = solve_lower(Lw, A)
    information = Y + inner(root, root)
    factor, sound = factor_of_inverse(information)
    gradient = times(root.swapaxes(0, 1), solve_lower(Lw, nu))
    shift = times(factor, times(factor.swapaxes(0, 1), gradient))
    Sy, innovation_sound = cholesky(spread_of(line, Lr))
    return Corrected(shift, factor, information, solve_lower(Sy, nu), Sy, weight_sound & sound & innovation_sound)


def _exact(S: jax.Array, Y: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ (R + Ω)⁻¹ A with A = E S⁻¹: equal to the covariance form."""
    return _correct(True, S, Y, line, Lr, nu)


def _paper(S: jax.Array, Y: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ R⁻¹ A as printed by Zhang et al.: Ω is dropped, so the filter is overconfident."""
    return _correct(False, S, Y, line, Lr, nu)


information = {
    "exact": Form("information", _invert, _predict, _exact),
    "paper": Form("information, as printed", _invert, _predict, _paper, omega=False),
}
