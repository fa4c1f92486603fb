"""The information forms: measurements add to the inverse of the covariance, in units of its factor."""

import jax

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, add, dense, inverse_lower, rotated, solve_lower
from sigmax.forms.form import Corrected, Form
from sigmax.forms.noise import noise_factor, predict, predict_squared
from sigmax.rules.linearization import Linearization


def sum_of_information(G: jax.Array, rows: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Lower D (n, n, ...) with D Dᵀ = (I + Gᵀ G)⁻¹, and what G (m, n, ...) explains and leaves of `rows` (k, m, ...).

    Returns D, Y with D Yᵀ = (I + Gᵀ G)⁻¹ Gᵀ rowsᵀ, and V with V Vᵀ = rows (I + G Gᵀ)⁻¹ rowsᵀ: a least squares that
    forms no Gᵀ G and no Gᵀ rowsᵀ, whose rounding would be that of |G|².
    """
    # The factor of I + Gᵀ G with rows and columns reversed is upper; the transposed inverse of that is lower.
    flipped, explained, left = rotated(G.swapaxes(0, 1)[::-1], rows)
    return inverse_lower(flipped[::-1, ::-1].swapaxes(0, 1)), explained[:, ::-1], left


def _correct(
    S: jax.Array, line: Linearization, weight: Matrix, noise: Matrix, nu: jax.Array, sound: jax.Array
) -> Corrected:
    whitening = dense(weight)
    G, weighted = solve_lower(whitening, line.slope), solve_lower(whitening, nu)
    D, explained, _ = sum_of_information(G, weighted[None])
    Sy = add(noise, line.slope)
    return Corrected(times(S, times(D, explained[0])), product(S, D), solve_lower(Sy, nu), Sy, sound)


def _exact(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ (R + Ω)⁻¹ A with A = E S⁻¹, equal to the covariance form: S⁺ = S D, G = R̃⁻¹ E."""
    noise, sound = noise_factor(line, Lr)
    return _correct(S, line, noise, noise, nu, sound)


def _paper(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ R⁻¹ A as printed by Zhang et al.: Ω is dropped, so the filter is overconfident."""
    noise, sound = noise_factor(line, Lr)
    return _correct(S, line, Lr, noise, nu, sound)


information = {
    "exact": Form("information", predict_squared, _exact),
    "paper": Form("information, as printed", predict_squared, _paper, omega=False),
}
root_information = Form("square root, information", predict, _exact)
