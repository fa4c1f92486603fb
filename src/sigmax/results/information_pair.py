"""The information pair of estimates."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.results.covariances import lower_inverse
from sigmax.steps.information_steps import start_of


def information_pair(array: Any, mean: Any, S: Any, numbers: Any) -> tuple[Any, Any]:
    """The pair y = Y x (…, n) and Y = P⁻¹ (…, n, n) of means and lower factors.

    Args:
        array: NumPy, or JAX's of numbers that are being traced.
        mean: (…, n), NaN where an open start leaves components undetermined.
        S: (…, n, n).
        numbers: of the open start (…, k), None where there was none.

    Raises:
        InputError: in a curved space.
    """
    if mean.shape[-1] != S.shape[-1]:
        raise InputError("an information vector is for flat spaces; this state has attitudes, directions or poses")
    with np.errstate(divide="ignore", invalid="ignore"):
        root = lower_inverse(array, S)
        y = array.einsum("...ki,...k->...i", root, array.einsum("...ij,...j->...i", root, mean))
        Y = root.swapaxes(-1, -2) @ root
    if numbers is not None:
        undetermined = np.isnan(mean).any(-1)
        y[undetermined], Y[undetermined] = _of_start(mean.shape[-1], numbers[undetermined])
    return y, Y


def _of_start(n: int, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (B, n), (B, n, n) of what is known of open starts (B, k): Y is singular, there is no P.

    With N = r A⁻¹ it is Y = Nᵀ (I + N S Sᵀ Nᵀ)⁻¹ N; NaN where a motion has no inverse.
    """
    parts = start_of(jnp.asarray(numbers.T, float), n)
    a, S, A, r, c = (np.moveaxis(np.asarray(part), -1, 0) for part in parts)
    N, regular = np.full_like(A, np.nan), np.linalg.cond(A) < 1e15
    N[regular] = r[regular] @ np.linalg.inv(A[regular])
    spread = N @ S
    measured = c + np.einsum("bij,bj->bi", N, a)
    weighed = np.linalg.solve(np.eye(n) + spread @ spread.swapaxes(-1, -2), np.dstack([N, measured]))
    pair = N.swapaxes(-1, -2) @ weighed
    return pair[..., n], (pair[..., :n] + pair[..., :n].swapaxes(-1, -2)) / 2
