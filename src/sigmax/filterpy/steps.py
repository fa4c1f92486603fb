"""Prediction, correction and smoothing of a factor, given what a linearisation says.

Small ones are compiled (see `compiled`); large ones, and all where there is no compiler, are LAPACK called from NumPy
and do the same. Where a covariance is not positive definite they raise `numpy.linalg.LinAlgError`, as FilterPy's users
expect.
"""

from functools import cache
from math import isfinite
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dgeqrf, dpotrf

from sigmax.algebra.factor import cholesky
from sigmax.filterpy.compiled import Corrected, Predicted, correcting, predicting
from sigmax.modelling.checks import symmetric_semidefinite


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
    nothing = _no_columns(len(slope))
    return Line(slope, nothing, nothing)


def factor(P: np.ndarray, name: str = "P") -> np.ndarray:
    """Lower S with S Sᵀ = P (n, n), zero columns where P is singular; `name` is for the error.

    Raises:
        numpy.linalg.LinAlgError: where P has a negative eigenvalue.
        InputError: where P is not symmetric; its lower triangle alone would be used.
    """
    S, failed = dpotrf(P, lower=1, clean=1)
    if failed:
        S, sound = _semidefinite(P)
        _refuse(sound, f"{name} is not positive semidefinite: it has a negative eigenvalue beyond rounding")
    if not (P == P.T).all():
        symmetric_semidefinite(name, P)
    return np.asarray(S)


class Kept:
    """The factor of a covariance that mostly is the one of the call before; it may change in place.

    Attributes:
        of: the very array it is of, where that is known.
        content: its numbers.
        made: the factor.
    """

    __slots__ = ("content", "made", "name", "of")

    def __init__(self, name: str) -> None:
        self.name = name
        self.of: Any = self  # no array is this
        self.content = b""
        self.made: np.ndarray = np.empty(0)

    def factor(self, P: np.ndarray) -> np.ndarray:
        """Lower S with S Sᵀ = P."""
        if P.tobytes() != self.content:
            self.keep(P, factor(P, self.name))
        return self.made

    def keep(self, P: np.ndarray, S: np.ndarray) -> None:
        """Take S for the factor of P."""
        self.of, self.made, self.content = P, S, P.tobytes()


def predict(line: Line, Lq: np.ndarray) -> Predicted:
    """The predicted covariance and its factor, with the factor of the noise (n, n)."""
    why = (
        "the predicted covariance is not positive definite: P, F or what fx gives is not finite, "
        "or a sigma point of negative weight took too much"
    )
    slope, residual, deficit = line
    step = predicting(slope.shape, residual.shape, deficit.shape, Lq.shape)
    if step is not None:
        made = step(slope, residual, deficit, Lq)
        _refuse(made.sound, why)
        return made
    S = _less(_tria((line.slope, line.residual, Lq), why), line.deficit, why)
    return Predicted(S, S @ S.T, True)


def correct(S: np.ndarray, line: Line, Lr: np.ndarray, y: np.ndarray) -> Corrected:
    """The effect of a measurement with innovation y (m,) and a factor of its noise (m, m), on S Sᵀ, S (n, l), l ≥ n.

    [[R̃, E], [0, S]] triangularised at once to [[S_y, 0], [K S_y, S⁺]], with R̃ = tria[L_r, N] less D.
    """
    why = (
        "the covariance of the innovation is not positive definite: R may be zero, a weight too negative, "
        "or what the sensor gives not finite"
    )
    slope, residual, deficit = line
    step = correcting(S.shape, slope.shape, residual.shape, deficit.shape, Lr.shape, y.shape)
    if step is not None:
        at_once = step(S, slope, residual, deficit, Lr, y)
        _refuse(at_once.sound, why)
        return at_once
    m, n = line.slope.shape[0], S.shape[0]
    if line.deficit.shape[1]:
        Lr = _less(_tria((Lr, line.residual), why), line.deficit, why)
        beside = [Lr]
    else:
        beside = [Lr, line.residual]
    wide = sum(part.shape[1] for part in beside)
    whole = np.zeros((m + n, wide + S.shape[1]))
    whole[:m] = np.concatenate([*beside, line.slope], axis=1)
    whole[m:, wide:] = S
    made = _tria((whole,), why)
    Sy, half = made[:m, :m], made[m:, :m]
    # A pivot within rounding of zero is none.
    squared = (Sy * Sy).sum(1)
    _refuse((Sy.diagonal() ** 2 > 1e-30 * squared).all(), why)
    gain = _solved(Sy, half.T, turned=True).T
    root = made[m:, m:]
    return Corrected(gain @ y, root, root @ root.T, gain, _solved(Sy, y[:, None]).ravel(), Sy, Sy @ Sy.T, True)


def smooth(S: np.ndarray, line: Line, Lq: np.ndarray, later: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Backwards over one prediction: factor of the smoothed covariance, gain, predicted covariance.

    G = S Eᵀ P⁻¹ and S_s = tria[S − G E, G L_q, G N, G S_later], less G D.
    """
    why = "a predicted or smoothed covariance is not positive definite"
    predicted, cov, _ = predict(line, Lq)
    _refuse((predicted.diagonal() > 0).all(), why)
    gain = _solved(predicted, _solved(predicted, line.slope @ S.T), turned=True).T
    root = _tria((S - gain @ line.slope, gain @ Lq, gain @ line.residual, gain @ later), why)
    return _less(root, gain @ line.deficit, why), gain, cov


def _tria(parts: tuple[np.ndarray, ...], why: str) -> np.ndarray:
    """Lower L with a diagonal that is not negative, L Lᵀ = A Aᵀ for A (n, k), k ≥ n, in parts side by side."""
    A = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
    n = len(A)
    # Rows of A are columns to LAPACK: a view, no copy to be turned.
    R = dgeqrf(A.T)[0][:n]
    L = (R * _upper(n)).T * np.copysign(1.0, R.diagonal())
    _refuse(isfinite(L.sum()), why)
    return L


def _less(L: np.ndarray, D: np.ndarray, why: str) -> np.ndarray:
    """Factor of L Lᵀ − D Dᵀ = L (I − W Wᵀ) Lᵀ, W = L⁻¹ D: the difference is taken where both are of size one."""
    if not D.shape[1]:
        return L
    # What is known exactly has a zero column in L, and nothing can be taken from it.
    known = L.diagonal() == 0
    _refuse(not D[known].any(), why)
    W = _solved(L + np.diag(known.astype(float)) if known.any() else L, D)
    within, failed = dpotrf(np.eye(len(L)) - W @ W.T, lower=1, clean=1)
    _refuse(not failed, why)
    return np.asarray(L @ within)


def _solved(L: np.ndarray, B: np.ndarray, turned: bool = False) -> np.ndarray:
    """L⁻¹ B, or L⁻ᵀ B. LAPACK's own routine for it would wake threads for the smallest matrix."""
    return np.asarray(dtrsm(1.0, L, B, lower=1, trans_a=int(turned)))


@cache
def _no_columns(n: int) -> np.ndarray:
    return np.empty((n, 0))


@cache
def _upper(n: int) -> np.ndarray:
    return np.triu(np.ones((n, n)))


def _refuse(sound: Any, why: str) -> None:
    if not sound:
        raise np.linalg.LinAlgError(why)


_semidefinite = jax.jit(cholesky)
