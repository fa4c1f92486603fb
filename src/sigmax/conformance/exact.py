"""The Kalman filter in fifty decimal digits, by its textbook equations."""

from collections.abc import Iterator
from decimal import Decimal, localcontext
from typing import Any

import numpy as np

_DIGITS = 50


def kalman(A: Any, H: Any, Q: Any, R: Any, mean: Any, cov: Any, record: Any) -> Iterator[tuple[Any, Any]]:
    """Means (n,) and covariances (n, n), in decimals, of x ← A x, z = H x, with noise Q (n, n) and R (m, m).

    What is there of a measurement is made independent by the factor of its part of R, and then taken one component
    after the other, which needs no inverse.

    A record has for each step a list of measurements (m,) that belong to its time, NaN where one is missing.
    """
    A, H, Q, R, x, P = (decimal(a) for a in (A, H, Q, R, mean, cov))
    for measurements in record:
        with localcontext(prec=_DIGITS):
            x, P = A @ x, A @ P @ A.T + Q
            for z in measurements:
                seen = np.flatnonzero(~np.isnan(z))
                S = _factor(R[np.ix_(seen, seen)])
                for h, value in zip(_solved(S, H[seen]), _solved(S, decimal(z[seen])), strict=True):
                    gain = P @ h
                    gain = gain / (h @ gain + 1)
                    x = x + gain * (value - h @ x)
                    P = P - np.outer(gain, h @ P)
        yield x, P


def whitened(mean: Any, cov: Any, x: Any, P: Any) -> float:
    """How far a mean (n,) and a covariance (n, n) are from the exact x and P, in deviations of every direction.

    The largest entry of S⁻¹ (mean − x) and S⁻¹ (cov − P) S⁻ᵀ, S Sᵀ = P: a combination of components that is known to
    a millionth counts in millionths.
    """
    with localcontext(prec=_DIGITS):
        S = _factor(P)
        gap, spread = decimal(mean) - x, decimal(cov) - P
        return float(max(np.abs(_solved(S, gap)).max(), np.abs(_solved(S, _solved(S, spread).T)).max()))


def _factor(P: Any) -> Any:
    """The lower triangular S of S Sᵀ = P."""
    n = len(P)
    S = np.full((n, n), Decimal(0))
    for j in range(n):
        S[j, j] = (P[j, j] - S[j, :j] @ S[j, :j]).sqrt()
        for i in range(j + 1, n):
            S[i, j] = (P[i, j] - S[i, :j] @ S[j, :j]) / S[j, j]
    return S


def _solved(S: Any, b: Any) -> Any:
    """S⁻¹ b."""
    rows: list[Any] = []
    for i in range(len(S)):
        rows.append((b[i] - sum(S[i, j] * rows[j] for j in range(i))) / S[i, i])
    return np.array(rows)


def decimal(values: Any) -> Any:
    """An array of numbers as one of decimals."""
    return np.frompyfunc(lambda v: Decimal(float(v)), 1, 1)(np.asarray(values, float))
