"""Prediction and correction of small factors compiled to C: what the forms say, in a microsecond instead of thirty."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer, product, times
from sigmax.algebra.factor import absorb, inverse_lower, solve_lower, square, tria
from sigmax.engine.backend import natively
from sigmax.engine.vectorized import bound
from sigmax.forms.noise import noise_factor, predict
from sigmax.native import Refused, Unavailable
from sigmax.native.calls import extension
from sigmax.rules.linearization import Linearization

# Multiplications, about: beyond it compiling takes longer than a second, and LAPACK is quick enough.
_LARGEST = 2000


class Predicted(NamedTuple):
    """Factor S (n, n) and covariance S Sᵀ, and whether they exist."""

    factor: Any
    cov: Any
    sound: Any


class Corrected(NamedTuple):
    """What a measurement does.

    Attributes:
        shift: K y (n,), what it adds to the mean.
        factor: S⁺ (n, n).
        cov: S⁺ S⁺ᵀ.
        gain: K (n, m).
        whitened: S_y⁻¹ y (m,).
        innovation_factor: S_y (m, m).
        innovation: S_y S_yᵀ.
        sound: whether they exist.
    """

    shift: Any
    factor: Any
    cov: Any
    gain: Any
    whitened: Any
    innovation_factor: Any
    innovation: Any
    sound: Any


Shape = tuple[int, ...]


@lru_cache(maxsize=128)
def predicting(E: Shape, N: Shape, D: Shape, Lq: Shape) -> Callable[..., Predicted] | None:
    """The prediction for arrays of these shapes, None where it should not or cannot be compiled."""
    made: Callable[..., Predicted] | None = _bound(predicted, (E, N, D, Lq), Predicted)
    return made


@lru_cache(maxsize=128)
def correcting(S: Shape, E: Shape, N: Shape, D: Shape, Lr: Shape, y: Shape) -> Callable[..., Corrected] | None:
    """The correction for arrays of these shapes, None as in `predicting`."""
    made: Callable[..., Corrected] | None = _bound(corrected, (S, E, N, D, Lr, y), Corrected)
    return made


def _bound(function: Callable[..., Any], shapes: tuple[Shape, ...], kind: type[Any]) -> Any:
    rows = max(shape[0] for shape in shapes)
    columns = sum(shape[1] for shape in shapes if len(shape) == 2)
    # Only an extension fills the arrays of a call and reads them without another thread between.
    if rows * rows * columns > _LARGEST or extension() is None:
        return None
    try:
        with natively():
            return bound(function, shapes, kind)
    except (Refused, Unavailable):
        return None


def _line(slope: jax.Array, residual: jax.Array, deficit: jax.Array) -> Linearization:
    return Linearization(jnp.zeros(len(slope)), slope, residual, deficit)


def predicted(slope: jax.Array, residual: jax.Array, deficit: jax.Array, Lq: jax.Array) -> Predicted:
    """The prediction by a line (see `steps.Line`) and a factor of the noise, to be compiled."""
    made = predict(_line(slope, residual, deficit), Lq)
    return Predicted(made.factor, square(made.factor), _number(made.sound, made.factor))


def corrected(
    S: jax.Array, slope: jax.Array, residual: jax.Array, deficit: jax.Array, Lr: jax.Array, y: jax.Array
) -> Corrected:
    """The correction of S Sᵀ by a line, a factor of the noise and an innovation, to be compiled."""
    noise, exists = noise_factor(_line(slope, residual, deficit), Lr)
    # S may have more columns than rows.
    Sy, cross, rest = absorb(noise, slope, S)
    whitened, factor = solve_lower(Sy, y), tria(rest)
    half = solve_lower(Sy, outer(slope, S))
    gain = product(half.swapaxes(0, 1), inverse_lower(Sy))
    # A pivot within rounding of zero is none.
    pivots = jnp.stack([Sy[i, i] ** 2 for i in range(len(y))])
    sound = exists & (pivots > 1e-30 * (Sy * Sy).sum(1)).all()
    shift = times(cross, whitened)
    return Corrected(shift, factor, square(factor), gain, whitened, Sy, square(Sy), _number(sound, factor))


def _number(sound: jax.Array, factor: jax.Array) -> jax.Array:
    return (sound & jnp.isfinite(factor.sum())).astype(np.float64)
