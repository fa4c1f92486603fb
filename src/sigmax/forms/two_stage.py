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

from sigmax.algebra.arrays import inner, outer, product, times
from sigmax.algebra.factor import Diagonal, Matrix, cholesky, dense, solve_lower, square
from sigmax.forms.covariance import covariance, spread_of
from sigmax.forms.form import Corrected, Form, Predicted
from sigmax.forms.information import factor_of_inverse, information
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


def _one(M: jax.Array) -> jax.Array:
    return dense(Diagonal(jnp.ones(M.shape[1:], M.dtype)))


def _known(line: Linearization, slope: jax.Array) -> Linearization:
    """The linearisation with another slope: what is left of it where something is known."""
    return line._replace(slope=slope)


def _gains(
    blocks: Blocks, slopes: tuple[jax.Array, jax.Array], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Stages:
    """Two gains: K₁ = P₁ Hᵀ S₁⁻¹ of the state where the bias is known, K₂ = P₂ Nᵀ P_zz⁻¹ of the bias."""
    C, L1 = blocks
    E2, E1 = slopes
    known, sound_known = cholesky(spread_of(_known(line, E1), Lr))
    Sy, sound = cholesky(spread_of(line, Lr))
    G1, G2 = solve_lower(known, E1), solve_lower(Sy, E2)
    whitened = solve_lower(Sy, nu)
    D1, sound_state = cholesky(_one(E1) - inner(G1, G1))
    D2, sound_bias = cholesky(_one(E2) - inner(G2, G2))

    def gained(v: jax.Array) -> jax.Array:
        return product(L1, product(G1.swapaxes(0, 1), solve_lower(known, v)))

    shift = times(G2.swapaxes(0, 1), whitened), gained(nu[:, None])[:, 0]
    return Stages(C - gained(E2), D2, D1, shift, whitened, Sy, sound & sound_known & sound_state & sound_bias)


def _weighted(
    exact: bool,
    blocks: Blocks,
    slopes: tuple[jax.Array, jax.Array],
    line: Linearization,
    Lr: Matrix,
    nu: jax.Array,
) -> Stages:
    """Sums of information in the stages' own units: J₁₁ = I + E₁ᵀ W E₁ and so on, no information vector."""
    C, L1 = blocks
    E2, E1 = slopes
    Lw, sound_weight = cholesky(spread_of(_known(line, E1[:, :0]), Lr) if exact else square(Lr))
    G1, G2, weighted = solve_lower(Lw, E1), solve_lower(Lw, E2), solve_lower(Lw, nu)
    D1, sound_state = factor_of_inverse(_one(E1) + inner(G1, G1))
    inverse = outer(D1, D1)
    J12, r1 = inner(G1, G2), times(G1.swapaxes(0, 1), weighted)
    K = product(inverse, J12)
    D2, sound_bias = factor_of_inverse(_one(E2) + inner(G2, G2) - inner(J12, K))
    r2 = times(G2.swapaxes(0, 1), weighted) - times(K.swapaxes(0, 1), r1)
    shift = times(outer(D2, D2), r2), times(L1, times(inverse, r1))
    Sy, sound = cholesky(spread_of(line, Lr))
    sound = sound & sound_weight & sound_state & sound_bias
    return Stages(C - product(L1, K), D2, D1, shift, solve_lower(Sy, nu), Sy, sound)


def _exact(
    blocks: Blocks, slopes: tuple[jax.Array, jax.Array], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Stages:
    return _weighted(True, blocks, slopes, line, Lr, nu)


def _paper(
    blocks: Blocks, slopes: tuple[jax.Array, jax.Array], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Stages:
    return _weighted(False, blocks, slopes, line, Lr, nu)


def _nothing(S: jax.Array) -> tuple[()]:
    return ()


def _predict(line: Linearization, Lq: Matrix) -> Predicted:
    """P₂ = P_bb, V = P_xb P_bb⁻¹, P₁ = P_xx − V P₂ Vᵀ: what the factor of the order [b; x] consists of."""
    S, sound = cholesky(spread_of(line, Lq))
    return Predicted(S, (), sound)


def _correct(
    update: Update, p: int, S: jax.Array, carried: tuple[()], line: Linearization, Lr: Matrix, nu: jax.Array
) -> Corrected:
    L2, L1 = S[:p, :p], S[p:, p:]
    done = update((S[p:, :p], L1), (line.slope[:, :p], line.slope[:, p:]), line, Lr, nu)
    of_bias, of_state = done.shift
    shift = jnp.concatenate([times(L2, of_bias), of_state + times(done.coupled, of_bias)])
    upper = jnp.concatenate([product(L2, done.bias), jnp.zeros_like(S[:p, p:])], axis=1)
    lower = jnp.concatenate([product(done.coupled, done.bias), product(L1, done.state)], axis=1)
    factor = jnp.concatenate([upper, lower])
    return Corrected(shift, factor, (), done.whitened, done.innovation_factor, done.sound)


@lru_cache(maxsize=64)
def _staged(name: str, update: Update, alone: Form, biases: int) -> Form:
    """The form for so many biases; without any there is one stage, and it is the form `alone`."""
    if not biases:
        return alone
    return Form(name, _nothing, _predict, partial(_correct, update, biases), omega=alone.omega, bias_first=True)


# Functions with a name, not partial ones: a form is equal to its copy out of a pickle.
def _gains_on(biases: int) -> Form:
    return _staged("two stages", _gains, covariance, biases)


def _exact_on(biases: int) -> Form:
    return _staged("two stages, information", _exact, information["exact"], biases)


def _paper_on(biases: int) -> Form:
    return _staged("two stages, information as printed", _paper, information["paper"], biases)


def _form(on: Callable[[int], Form]) -> Form:
    alone = on(0)
    start, predict, correct = alone.start, alone.predict, alone.correct
    return Form(on(1).name, start, predict, correct, omega=alone.omega, bias_first=True, biased=on)


two_stage = {"covariance": _form(_gains_on), "exact": _form(_exact_on), "paper": _form(_paper_on)}
