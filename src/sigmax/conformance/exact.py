"""The Kalman filter in fifty decimal digits, by its textbook equations."""

from decimal import Decimal, localcontext
from typing import Any

import numpy as np


def kalman(A: Any, H: Any, Q: Any, r: Any, mean: Any, cov: Any, record: Any) -> tuple[np.ndarray, np.ndarray]:
    """Means (T, n) and covariances (T, n, n) of x ← A x, z = H x, with variances r (m,) of the sensor.

    Components of a measurement are taken one after the other, which for independent noise is the same and needs no
    inverse.

    A record has for each step a list of measurements (m,) that belong to its time, NaN where one is missing.
    """
    with localcontext(prec=50):
        A, H, Q, r, x, P = (_decimal(a) for a in (A, H, Q, r, mean, cov))
        means, covs = [], []
        for measurements in record:
            x, P = A @ x, A @ P @ A.T + Q
            for z in measurements:
                for i in np.flatnonzero(~np.isnan(z)):
                    gain = P @ H[i]
                    gain = gain / (H[i] @ gain + r[i])
                    x = x + gain * (Decimal(float(z[i])) - H[i] @ x)
                    P = P - np.outer(gain, H[i] @ P)
            means.append(x.astype(float))
            covs.append(P.astype(float))
    return np.array(means), np.array(covs)


def _decimal(values: Any) -> Any:
    return np.frompyfunc(lambda v: Decimal(float(v)), 1, 1)(np.asarray(values, float))
