"""The forms that correct by reflections: at once with one block array, or with two triangularisations."""

import jax

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, absorb, identity, solve_lower, tria
from sigmax.algebra.rotations import rotate
from sigmax.forms.form import Corrected, Form
from sigmax.forms.noise import noise_factor, predict, predict_squared
from sigmax.rules.linearization import Linearization


def _correct_block(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """[[R̃, E], [0, S]] turned at once to [[S_y, 0], [K S_y, S⁺]], S staying the triangle that it is."""
    Lr, sound = noise_factor(line, Lr)
    Sy, gain, rest = rotate(Lr, line.slope, S)
    whitened = solve_lower(Sy, nu)
    return Corrected(times(gain, whitened), rest, whitened, Sy, sound)


def _correct_twice(S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    """Two triangularisations, of innovation and state: [[R̃, E], [0, I]] → [[S_y, 0], [W, T]] and S⁺ = tria[S T].

    T Tᵀ = I − Eᵀ P_yy⁻¹ E, from reflections: S − K E would be a difference, and S_y⁻¹ E is not at most 1 where
    two components measure nearly the same.
    """
    Lr, sound = noise_factor(line, Lr)
    Sy, gain, rest = absorb(Lr, line.slope, identity(S))
    whitened = solve_lower(Sy, nu)
    return Corrected(times(S, times(gain, whitened)), tria(product(S, rest)), whitened, Sy, sound)


# Functions with names, so that a filter can be pickled.
covariance = Form("covariance", predict_squared, _correct_block)
square_root = Form("square root", predict, _correct_twice)
block = Form("square root, block", predict, _correct_block)
