"""The Kalman filter in fifty decimal digits, by its textbook equations."""

from collections.abc import Iterator
from decimal import Decimal, localcontext
from typing import Any

import numpy as np

_DIGITS = 50


def kalman(A: Any, H: Any, Q: Any, r: Any, mean: Any, cov: Any, record: Any) -> Iterator[tuple[Any, Any]]:
    """Means (n,) and covariances (n, n), in decimals, of x ← A x, z = H x, with variances r (m,) of the sensor.

    Components of a measurement are taken one after the other, which for independent noise is the same and needs no
    inverse.

    A record has for each step a list of measurements (m,) that belong to its time, NaN where one is missing.
    """
    with localcontext(prec=_DIGITS):
        A, H, Q, r, x, P = (_decimal(a) for a in (A, H, Q, r, mean, cov))
    for measurements in record:
        with localcontext(prec=_DIGITS):
            x, P = A @ x, A @ P @ A.T + Q
            for z in measurements:
                for i in np.flatnonzero(~np.isnan(z)):
                    gain = P @ H[i]
                    gain = gain / (H[i] @ gain + r[i])
                    x = x + gain * (Decimal(float(z[i])) - H[i] @ x)
                    P = P - np.outer(gain, H[i] @ P)
        yield x, P


def whitened(mean: Any, cov: Any, x: Any, P: Any) -> float:
    """How far a mean (n,) and a covariance (n, n) are from the exact x and P, in deviations of every direction.

    The largest entry of S⁻¹ (mean − x) and S⁻¹ (cov − P) S⁻ᵀ, S Sᵀ = P: a combination of components that is known to
    a millionth counts in millionths.
    """
    with localcontext(prec=_DIGITS):
        n = len(x)
        S = np.full((n, n), Decimal(0))
        for j in range(n):
            S[j, j] = (P[j, j] - S[j, :j] @ S[j, :j]).sqrt()
            for i in range(j + 1, n):
                S[i, j] = (P[i, j] - S[i, :j] @ S[j, :j]) / S[j, j]

        def solved(b: Any) -> Any:
            rows: list[Any] = []
            for i in range(n):
                rows.append((b[i] - sum(S[i, j] * rows[j] for j in range(i))) / S[i, i])
            return np.array(rows)

        gap, spread = _decimal(mean) - x, _decimal(cov) - P
        return float(max(np.abs(solved(gap)).max(), np.abs(solved(solved(spread).T)).max()))


def _decimal(values: Any) -> Any:
    return np.frompyfunc(lambda v: Decimal(float(v)), 1, 1)(np.asarray(values, float))
