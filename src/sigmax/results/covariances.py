"""Covariances from factors, when a user asks for them."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sigmax.native import Unavailable, compiler
from sigmax.native.driver import Squares, driver, over_cores, pointer


class Moments(NamedTuple):
    """A mean (…, n) and its covariance (…, n, n)."""

    mean: np.ndarray
    cov: np.ndarray


def covariances(S: Any) -> Any:
    """S Sᵀ of lower factors (…, n, n): compiled where it can be, for NumPy takes longer over many small products."""
    if not isinstance(S, np.ndarray) or not _compiled(S.dtype):
        return S @ S.swapaxes(-1, -2)
    S = np.ascontiguousarray(S)
    P = np.empty_like(S)
    n, single = S.shape[-1], S.dtype == np.float32
    count = S.size // n**2
    job = Squares(n, n**2, 0, pointer(S), pointer(P))
    over_cores(driver(single)["squares"], job, count, single)
    return P


def lower_inverse(array: Any, S: Any) -> Any:
    """The inverses of lower factors (…, n, n) in NumPy or JAX; infinite where a diagonal is 0."""
    n = S.shape[-1]
    rows: list[Any] = []
    for i in range(n):
        unit = array.broadcast_to(array.eye(n, dtype=S.dtype)[i], (*S.shape[:-2], n))
        known = sum((S[..., i, k, None] * rows[k] for k in range(i)), 0.0 * unit)
        rows.append((unit - known) / S[..., i, i, None])
    return array.stack(rows, -2)


@cache
def _compiled(dtype: np.dtype[Any]) -> bool:
    if compiler() is None or dtype not in (np.float32, np.float64):
        return False
    try:
        driver(dtype == np.float32)
    except Unavailable:
        return False
    return True
