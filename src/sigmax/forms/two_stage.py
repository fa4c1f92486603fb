"""Two stages: a bias first, the state given the bias second; their covariances apart and the coupling between them.

With P = T(V) diag(P₁, P₂) T(V)ᵀ, T(V) = [[I, V], [0, I]], P₂ is the covariance of the bias b, P₁ that of the
state where b is known, and V the regression of the state on b. The lower factor of the order [b; x],

    S = [[L₂, 0], [V L₂, L₁]],   P₁ = L₁ L₁ᵀ,   P₂ = L₂ L₂ᵀ,

holds all three, and in its coordinates the formulas of the two-stage filters need no inverse of a covariance:
the columns of the slope E = [E₂, E₁] are N L₂ and H L₁ of the page on two stages. A correction multiplies
L₁ and L₂ by small triangles that differ little from I.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, add, identity, solve_lower
from sigmax.algebra.rotations import rotate
from sigmax.forms.form import Corrected, Form
from sigmax.forms.information import information
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
Update = Callable[[Blocks, tuple[jax.Array, jax.Array], Linearization, Matrix, jax.Array], Stages]


def _exact(
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


def _paper(
    blocks: Blocks, slopes: tuple[jax.Array, jax.Array], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Stages:
    """The same with R in place of R + Ω, as printed."""
    noise, sound = noise_factor(line, Lr)
    done = _exact(blocks, slopes, line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0]), Lr, nu)
    Sy = add(noise, line.slope)
    return done._replace(whitened=solve_lower(Sy, nu), innovation_factor=Sy, sound=sound)


def _correct(update: Update, p: int, S: jax.Array, line: Linearization, Lr: Matrix, nu: jax.Array) -> Corrected:
    L2, L1 = S[:p, :p], S[p:, p:]
    done = update((S[p:, :p], L1), (line.slope[:, :p], line.slope[:, p:]), line, Lr, nu)
    of_bias, of_state = done.shift
    shift = jnp.concatenate([times(L2, of_bias), of_state + times(done.coupled, of_bias)])
    upper = jnp.concatenate([product(L2, done.bias), jnp.zeros_like(S[:p, p:])], axis=1)
    lower = jnp.concatenate([product(done.coupled, done.bias), product(L1, done.state)], axis=1)
    factor = jnp.concatenate([upper, lower])
    return Corrected(shift, factor, done.whitened, done.innovation_factor, done.sound)


@lru_cache(maxsize=64)
def _staged(name: str, update: Update, alone: Form, biases: int) -> Form:
    """The form for so many biases; without any there is one stage, and it is the form `alone`."""
    if not biases:
        return alone
    return Form(name, predict_squared, partial(_correct, update, biases), omega=alone.omega, bias_first=True)


# Functions with a name, not partial ones: a form is equal to its copy out of a pickle.
def _gains_on(biases: int) -> Form:
    return _staged("two stages", _exact, covariance, biases)


def _exact_on(biases: int) -> Form:
    return _staged("two stages, information", _exact, information["exact"], biases)


def _paper_on(biases: int) -> Form:
    return _staged("two stages, information as printed", _paper, information["paper"], biases)


def _form(on: Callable[[int], Form]) -> Form:
    alone = on(0)
    return Form(on(1).name, alone.predict, alone.correct, omega=alone.omega, bias_first=True, biased=on)


two_stage = {"covariance": _form(_gains_on), "exact": _form(_exact_on), "paper": _form(_paper_on)}
