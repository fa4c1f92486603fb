"""Laws on linear models, where the answer is known to any number of digits."""

import numpy as np

from sigmax.conformance.exact import kalman, whitened
from sigmax.conformance.task import Adapter, Task, estimate

_N, _M, _T = 3, 2, 6


class _Linear:
    """A random linear model with full A, H, Q, R and P."""

    def __init__(self, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.A = np.eye(_N) + 0.2 * rng.standard_normal((_N, _N)) / np.sqrt(_N)
        self.H = rng.standard_normal((_M, _N))
        roots = rng.standard_normal((2, _N, _N + 2))
        self.Q, self.P = 0.2 * roots[0] @ roots[0].T / _N, roots[1] @ roots[1].T / _N
        r = rng.uniform(0.3, 0.8, _M)
        self.R = np.diag(r) + 0.6 * np.sqrt(np.outer(r, r)) * (1 - np.eye(_M))
        self.x = rng.standard_normal(_N)
        self.z = rng.standard_normal((_T, _M))

    def task(self) -> Task:
        A, H = self.A, self.H
        return Task(lambda x, xp: xp.asarray(A) @ x, lambda x, xp: xp.asarray(H) @ x, self.Q, self.R)

    def gap(self, adapter: Adapter, record: list[list[np.ndarray]]) -> float:
        """The largest difference from the exact filter, of means and covariances, whitened by its covariance."""
        running = adapter.start(self.task(), self.x.copy(), self.P.copy())
        worst = 0.0
        exact = kalman(self.A, self.H, self.Q, self.R, self.x, self.P, record)
        for measurements, (mean, cov) in zip(record, exact, strict=True):
            running.predict()
            for z in measurements:
                running.update(z)
            found = estimate(running, _N)
            if not all(np.isfinite(a).all() for a in found):
                return float("nan")
            lopsided = np.abs(found[1] - found[1].T).max() / np.abs(found[1]).max()
            worst = max(worst, whitened(*found, mean, cov), float(lopsided))
        return worst


def _each(z: np.ndarray) -> list[list[np.ndarray]]:
    return [[row] for row in z]


def plain(adapter: Adapter) -> float:
    """As it comes."""
    p = _Linear()
    return p.gap(adapter, _each(p.z))


def offset(adapter: Adapter) -> float:
    """All components of the state moved by 1e7, and the record with them."""
    p = _Linear()
    x = np.full(_N, 1e7)
    p.x = p.x + x
    for k in range(_T):
        x = p.A @ x
        p.z[k] += p.H @ x
    return p.gap(adapter, _each(p.z))


def stiff(adapter: Adapter) -> float:
    """Measurements that leave next to nothing open; not positive definite counts as infinitely far."""
    p = _Linear()
    p.R = p.R * 1e-12
    running = adapter.start(p.task(), p.x.copy(), p.P.copy())
    for z in p.z:
        running.predict()
        running.update(z)
        if not (np.linalg.eigvalsh(estimate(running, _N)[1]) > 0).all():
            return float("inf")
    return p.gap(adapter, _each(p.z))


def driftless(adapter: Adapter) -> float:
    """Without noise of the motion."""
    p = _Linear()
    p.Q = np.zeros((_N, _N))
    return p.gap(adapter, _each(p.z))


def order(adapter: Adapter) -> float:
    """Two measurements before each prediction, in both orders, against the exact answer."""
    p = _Linear()
    pairs = [[a, b] for a, b in zip(p.z, p.z[::-1], strict=True)]
    return float(np.maximum(p.gap(adapter, pairs), p.gap(adapter, [pair[::-1] for pair in pairs])))


def missing(adapter: Adapter) -> float:
    """Two whole measurements are NaN."""
    p = _Linear()
    p.z[[1, 2]] = np.nan
    return p.gap(adapter, _each(p.z))


def partly_missing(adapter: Adapter) -> float:
    """One component is NaN, then the other."""
    p = _Linear()
    p.z[1, 0] = p.z[3, 1] = np.nan
    return p.gap(adapter, _each(p.z))


def long_run(adapter: Adapter) -> float:
    """A thousand steps of a slowly turning oscillator."""
    p = _Linear()
    c, s = np.cos(0.1), np.sin(0.1)
    p.A = np.array([[c, s, 0.01], [-s, c, 0.0], [0.0, 0.0, 0.999]])
    p.z = np.random.default_rng(5).standard_normal((1000, _M))
    return p.gap(adapter, _each(p.z))
