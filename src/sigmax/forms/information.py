"""The information forms: measurements add to the inverse of the covariance, in units of its factor."""

import jax

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, add, identity, solve_lower
from sigmax.algebra.rotations import rotate
from sigmax.forms.form import Corrected, Form
from sigmax.forms.noise import noise_factor, predict, predict_squared
from sigmax.rules.linearization import Linearization


def _exact(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ (R + Ω)⁻¹ A with A = E S⁻¹: S⁺ = S D, D Dᵀ = (I + Eᵀ (R + Ω)⁻¹ E)⁻¹.

    D is what rotations leave of I in [[R̃, E], [0, I]] → [[S_y, 0], [W, D]]: neither Y nor R̃ is inverted,
    and a component known exactly, whose information is infinite, is one like any other.
    """
    Lr, sound = noise_factor(line, Lr)
    Sy, gain, D = rotate(Lr, line.slope, identity(S))
    whitened = solve_lower(Sy, nu)
    return Corrected(times(S, times(gain, whitened)), product(S, D), whitened, Sy, sound)


def _paper(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Y⁺ = Y + Aᵀ R⁻¹ A as printed by Zhang et al.: Ω is dropped, so the filter is overconfident."""
    noise, sound = noise_factor(line, Lr)
    done = _exact(S, line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0]), Lr, nu)
    Sy = add(noise, line.slope)
    return done._replace(whitened=solve_lower(Sy, nu), innovation_factor=Sy, sound=sound)


information = {
    "exact": Form("information", predict_squared, _exact),
    "paper": Form("information, as printed", predict_squared, _paper, omega=False),
}
root_information = Form("square root, information", predict, _exact)
