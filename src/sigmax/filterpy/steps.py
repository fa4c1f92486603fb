"""Prediction, correction and smoothing of a factor, given what a linearisation says: compiled once a shape.

Where a covariance is not positive definite these raise `numpy.linalg.LinAlgError`, as FilterPy's users expect.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer, product
from sigmax.algebra.factor import cholesky, downdate, inverse_lower, solve_lower, square, tria
from sigmax.forms import block
from sigmax.rules import Linearization


class Line(NamedTuple):
    """A function of N(x̂, S Sᵀ) as a line: Cov(y) = E Eᵀ + N Nᵀ − D Dᵀ, Cov(x, y) = S Eᵀ.

    Attributes:
        slope: E (m, n).
        residual: N (m, r), r ≥ 0.
        deficit: D (m, q), q ≥ 0.
    """

    slope: Any
    residual: Any
    deficit: Any


def straight(slope: np.ndarray) -> Line:
    """A line that misses nothing."""
    return Line(slope, slope[:, :0], slope[:, :0])


def factor(P: np.ndarray) -> np.ndarray:
    """Lower S with S Sᵀ = P (n, n), zero columns where P is singular.

    Raises:
        numpy.linalg.LinAlgError: where P has a negative eigenvalue.
    """
    S, sound = _factor(P)
    _refuse(sound, "P is not positive semidefinite: it has a negative eigenvalue beyond rounding")
    return np.asarray(S)


def predict(line: Line, Q: np.ndarray) -> np.ndarray:
    """The factor of the predicted covariance."""
    S, sound = _predict(line, Q)
    _refuse(sound, "the predicted covariance is not positive definite; a sigma point of negative weight took too much")
    return np.asarray(S)


class Corrected(NamedTuple):
    """Factor of the covariance S, gain K (n, m), whitened innovation (m,), factor of its covariance (m, m)."""

    factor: np.ndarray
    gain: np.ndarray
    whitened: np.ndarray
    innovation_factor: np.ndarray


def correct(S: np.ndarray, line: Line, R: np.ndarray, y: np.ndarray) -> Corrected:
    """The effect of a measurement with innovation y (m,) and noise R (m, m)."""
    *made, sound = _correct(S, line, R, y)
    _refuse(sound, "the covariance of the innovation is not positive definite; R may be zero or a weight too negative")
    return Corrected(*(np.asarray(a) for a in made))


def smooth(S: np.ndarray, line: Line, Q: np.ndarray, later: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Backwards over one prediction: factor of the smoothed covariance, gain, predicted covariance."""
    *made, sound = _smooth(S, line, Q, later)
    _refuse(sound, "a predicted or smoothed covariance is not positive definite")
    root, gain, predicted = (np.asarray(a) for a in made)
    return root, gain, predicted


def _refuse(sound: Any, why: str) -> None:
    if not sound:
        raise np.linalg.LinAlgError(why)


_factor = jax.jit(cholesky)


def _linearization(line: Line) -> Linearization:
    return Linearization(line.slope[:, 0], *(jnp.asarray(part) for part in line))


@jax.jit
def _predict(line: Line, Q: jax.Array) -> tuple[jax.Array, jax.Array]:
    Lq, noise_sound = cholesky(Q)
    S, _, sound = block.predict(_linearization(line), Lq)
    return S, sound & noise_sound & jnp.isfinite(S.sum())


@jax.jit
def _correct(S: jax.Array, line: Line, R: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
    Lr, noise_sound = cholesky(R)
    made = block.correct(S, (), _linearization(line), Lr, y)
    Sy = made.innovation_factor
    gain = product(solve_lower(Sy, outer(line.slope, S)).swapaxes(0, 1), inverse_lower(Sy))
    sound = made.sound & noise_sound & jnp.isfinite(made.factor.sum() + gain.sum())
    return made.factor, gain, made.whitened, Sy, sound


@jax.jit
def _smooth(S: jax.Array, line: Line, Q: jax.Array, later: jax.Array) -> tuple[jax.Array, ...]:
    """G = S Eᵀ P⁻¹ and S_s = tria[S − G E, G L_q, G N, G S_later], less G D."""
    Lq, sound = cholesky(Q)
    predicted, _, exists = block.predict(_linearization(line), Lq)
    half = solve_lower(predicted, outer(line.slope, S))
    gain = product(half.swapaxes(0, 1), inverse_lower(predicted))
    beside = [product(gain, part) for part in (Lq, line.residual, later) if part.shape[1]]
    root = tria(jnp.concatenate([S - product(gain, line.slope), *beside], axis=1))
    if line.deficit.shape[1]:
        root, less = downdate(root, product(gain, line.deficit))
        exists &= less
    return root, gain, square(predicted), sound & exists & jnp.isfinite(root.sum())
