"""Two stages: a bias first, the state given the bias second; their covariances apart and the coupling between them.

With P = T(V) diag(P₁, P₂) T(V)ᵀ, T(V) = [[I, V], [0, I]], P₂ is the covariance of the bias b, P₁ that of the
state where b is known, and V the regression of the state on b. The lower factor of the order [b; x],

    S = [[L₂, 0], [V L₂, L₁]],   P₁ = L₁ L₁ᵀ,   P₂ = L₂ L₂ᵀ,

holds all three, and in its coordinates the formulas of the two-stage filters need no inverse of a covariance:
the columns of the slope E = [E₂, E₁] are N L₂ and H L₁ of the page on two stages. A correction multiplies
L₁ and L₂ by small triangles that differ little from I.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, identity, solve_lower
from sigmax.algebra.rotations import rotate
from sigmax.forms.form import Corrected, Form
from sigmax.forms.information import without_omega
from sigmax.forms.noise import noise_factor, predict_squared
from sigmax.forms.square_root import covariance
from sigmax.rules.linearization import Linearization


class Stages(NamedTuple):
    """What a correction does to the stages.

    Attributes:
        coupled: (V⁺) L₂, the new coupling times the old factor of the bias (n, p, ...).
        bias: D₂, L₂⁺ = L₂ D₂ (p, p, ...).
        state: D₁, L₁⁺ = L₁ D₁ (n, n, ...).
        shift: of the bias in units of L₂ (p, ...), and of the state where the bias is known (n, ...).
        whitened: S_y⁻¹ ν.
        innovation_factor: S_y.
        sound: whether all the factors exist.
    """

    coupled: jax.Array
    bias: jax.Array
    state: jax.Array
    shift: tuple[jax.Array, jax.Array]
    whitened: jax.Array
    innovation_factor: jax.Array
    sound: jax.Array


Blocks = tuple[jax.Array, jax.Array]  # V L₂ and L₁


def _corrected(
    blocks: Blocks, slopes: tuple[jax.Array, jax.Array], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Stages:
    """Two gains, K₁ = P₁ Hᵀ S₁⁻¹ of the state where the bias is known, K₂ = P₂ Nᵀ P_zz⁻¹ of the bias.

    D₁ and D₂ are what rotations leave of I in each stage: I − E₁ᵀ (S₁ S₁ᵀ)⁻¹ E₁ = (I + E₁ᵀ (R + Ω)⁻¹ E₁)⁻¹, the sum
    of information of the stage, without a difference or an inverse.
    """
    C, L1 = blocks
    E2, E1 = slopes
    noise, sound = noise_factor(line, Lr)
    known, cross1, D1 = rotate(noise, E1, identity(L1))
    Sy, cross2, D2 = rotate(known, E2, identity(E2))
    whitened = solve_lower(Sy, nu)

    def gained(v: jax.Array) -> jax.Array:
        return product(L1, product(cross1, solve_lower(known, v)))

    shift = times(cross2, whitened), gained(nu[:, None])[:, 0]
    return Stages(C - gained(E2), D2, D1, shift, whitened, Sy, sound)


@dataclass(frozen=True)
class _Stages:
    """The correction of [b; x] with so many biases."""

    biases: int

    def __call__(self, S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
        p = self.biases
        L2, L1 = S[:p, :p], S[p:, p:]
        done = _corrected((S[p:, :p], L1), (line.slope[:, :p], line.slope[:, p:]), line, Lr, nu)
        of_bias, of_state = done.shift
        shift = jnp.concatenate([times(L2, of_bias), of_state + times(done.coupled, of_bias)])
        upper = jnp.concatenate([product(L2, done.bias), jnp.zeros_like(S[:p, p:])], axis=1)
        lower = jnp.concatenate([product(done.coupled, done.bias), product(L1, done.state)], axis=1)
        factor = jnp.concatenate([upper, lower])
        return Corrected(shift, factor, done.whitened, done.innovation_factor, done.sound)


@dataclass(frozen=True)
class _On:
    """Two stages for so many biases; without any there is one stage, and it is the form alone."""

    name: str
    alone: Form

    def __call__(self, biases: int) -> Form:
        return _staged(self, biases) if biases else self.alone


@lru_cache(maxsize=64)
def _staged(on: _On, biases: int) -> Form:
    form = Form(on.name, predict_squared, _Stages(biases))
    return replace(form if on.alone.omega else without_omega(form), name=on.name, bias_first=True)


def two_stage(form: Form) -> Form:
    """A form in two stages, where the model has a bias: that of the covariance or of the information."""
    name = "two stages" if form == covariance else f"two stages, {form.name}"
    return replace(form, name=name, bias_first=True, biased=_On(name, form))
