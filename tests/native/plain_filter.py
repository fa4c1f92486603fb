"""Kalman filters as textbooks have them, in NumPy over the bare functions of a model: a judge of its own.

Full sigma sets, full Jacobians, full covariances; nothing of the library is used.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

Function = Callable[[np.ndarray, tuple[Any, ...]], np.ndarray]


class Plain:
    """A filter "EKF", "UKF" (alpha 1, beta 2, kappa 0) or "CKF" of motion(x, dt, u) and sensors h(x, u).

    Args:
        kind: which.
        motion: of one state (n,).
        sensors: by name, each of one state, giving (m,).
        Q: variances per second (n,).
        R: variances (m,) by sensor.
    """

    def __init__(
        self, kind: str, motion: Any, sensors: Mapping[str, Any], Q: np.ndarray, R: Mapping[str, np.ndarray]
    ) -> None:
        self.kind, self.Q, self.R = kind, Q, R
        self._motion = self._made(motion, 2)
        self._sensors = {s: self._made(h, 1) for s, h in sensors.items()}

    def _made(self, function: Any, others: int) -> tuple[Any, Any]:
        """The function at many states, and its derivatives at one along many directions (k, n), as columns (m, k)."""

        def along(x: Any, directions: Any, *rest: Any) -> Any:
            return jax.vmap(lambda v: jax.jvp(lambda at: function(at, *rest), (x,), (v,))[1], out_axes=1)(directions)

        return jax.jit(jax.vmap(function, in_axes=(0, *[None] * others))), jax.jit(along)

    def filtered(
        self,
        mean: np.ndarray,
        cov: np.ndarray,
        z: Mapping[str, np.ndarray],
        dt: np.ndarray,
        u: np.ndarray,
        axes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Means (T, n) and covariances (T, n, n) after each step; z (T, m) by sensor, NaN where missing.

        Derivatives are taken along orthonormal axes (n, n), one a row, those of the state if nothing is said: the same
        Jacobian, as far as derivatives are not rounded to a narrower type.
        """
        x, P = np.array(mean), np.array(cov)
        self._axes = np.eye(len(x)) if axes is None else axes
        means, covs = [], []
        for k, seconds in enumerate(dt):
            x, P, _ = self._moments(self._motion, x, P, (seconds, u[k]))
            P = P + np.diag(self.Q) * seconds
            for s, measured in z.items():
                seen = ~np.isnan(measured[k])
                if seen.any():
                    y, Pyy, Pxy = self._moments(self._sensors[s], x, P, (u[k],))
                    Pyy = (Pyy + np.diag(self.R[s]))[np.ix_(seen, seen)]
                    gain = np.linalg.solve(Pyy, Pxy[:, seen].T).T
                    x = x + gain @ (measured[k] - y)[seen]
                    P = P - gain @ Pyy @ gain.T
            means.append(x)
            covs.append(P)
        return np.array(means), np.array(covs)

    def _moments(
        self, function: tuple[Any, Any], x: np.ndarray, P: np.ndarray, rest: tuple[Any, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean, covariance, and covariance with x, of a function of x ~ N(x, P)."""
        value, jacobian = function
        if self.kind == "EKF":
            J = np.asarray(jacobian(x, self._axes, *rest)) @ self._axes
            return np.asarray(value(x[None], *rest))[0], J @ P @ J.T, P @ J.T
        n = len(x)
        spread = np.sqrt(n) * np.linalg.cholesky(P)
        points = np.concatenate([x + spread.T, x - spread.T, x[None]])
        y = np.asarray(value(points, *rest))
        # With alpha = 1, beta = 2, kappa = 0 the centre counts 2 in covariances, and nothing in the mean.
        w = np.full(2 * n + 1, 1 / (2 * n))
        w[-1] = 0
        v = w.copy()
        v[-1] = 2.0 if self.kind == "UKF" else 0.0
        middle = w @ y
        off = y - middle
        return middle, off.T @ (v[:, None] * off), (points - x).T @ (w[:, None] * off)
