"""The information forms: measurements add to the inverse of the covariance, in units of its factor."""

from collections.abc import Callable
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class _WithoutOmega:
    """A correction that counts R alone in its gain, and R + Ω in what it says of the innovation."""

    correct: Callable[[jax.Array, Linearization, Matrix, jax.Array], Corrected]

    def __call__(self, S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
        noise, sound = noise_factor(line, Lr)
        bare = line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0])
        Sy = add(noise, line.slope)
        return self.correct(S, bare, Lr, nu)._replace(whitened=solve_lower(Sy, nu), innovation_factor=Sy, sound=sound)


def without_omega(form: Form) -> Form:
    """A form whose correction drops Ω, Y⁺ = Y + Aᵀ R⁻¹ A as Zhang et al. print it: the filter is overconfident."""
    return replace(form, name=f"{form.name}, as printed", correct=_WithoutOmega(form.correct), omega=False)


information = Form("information", predict_squared, _exact)
root_information = Form("square root, information", predict, _exact)
