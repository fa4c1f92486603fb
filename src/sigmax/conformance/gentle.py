"""The law of small noise: where little is uncertain, every rule is the linearisation at the estimate."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from sigmax.conformance.exact import decimal, whitened
from sigmax.conformance.task import Adapter, Task, estimate

_SIZE = 0.003
_START = np.array([2.0, 0.4, 1.0])
_STEPS = 8


def _motion(x: Any, xp: Any) -> Any:
    """A swing of large angle and a quantity that it drives; the slope is another one after each step."""
    return xp.stack([0.8 * x[0] + 0.3 * xp.cos(x[1]), x[1] + 0.6 * x[2], x[2] - 0.8 * xp.sin(x[1])])


def _sensor(x: Any, xp: Any) -> Any:
    return xp.stack([x[0] * xp.cos(x[1]), x[0] * xp.sin(x[1]) + x[2] ** 2])


def _task() -> Task:
    Q = np.array([[0.5, 0.2, -0.1], [0.2, 0.4, 0.1], [-0.1, 0.1, 0.3]])
    return Task(_motion, _sensor, _SIZE**2 * Q, _SIZE**2 * np.array([[0.5, -0.2], [-0.2, 0.3]]))


def _linearised(task: Task, mean: Any, cov: Any, record: Any) -> Iterator[tuple[Any, Any]]:
    """The extended Kalman filter by its textbook equations."""
    slope, sees = task.jacobians
    for z in record:
        F = slope(mean)
        mean, cov = task.f(mean), F @ cov @ F.T + task.Q
        H = sees(mean)
        K = np.linalg.solve(H @ cov @ H.T + task.R, H @ cov).T
        rest = np.eye(len(mean)) - K @ H
        mean, cov = mean + K @ (z - task.h(mean)), rest @ cov @ rest.T + K @ task.R @ K.T
        yield decimal(mean), decimal(cov)


def small(adapter: Adapter) -> float:
    """A record with little noise, against the linearisation."""
    task, rng = _task(), np.random.default_rng(8)
    cov = _SIZE**2 * np.array([[1.0, 0.5, 0.2], [0.5, 1.0, -0.3], [0.2, -0.3, 1.0]])
    roots = [np.linalg.cholesky(a) for a in (cov, task.Q, task.R)]
    x, record = _START + roots[0] @ rng.standard_normal(3), []
    for _ in range(_STEPS):
        x = task.f(x) + roots[1] @ rng.standard_normal(3)
        record.append(task.h(x) + roots[2] @ rng.standard_normal(2))
    running, worst = adapter.start(task, _START.copy(), cov.copy()), 0.0
    for z, expected in zip(record, _linearised(task, _START, cov, record), strict=True):
        running.predict()
        running.update(z)
        found = estimate(running, len(_START))
        if not all(np.isfinite(a).all() for a in found):
            return float("nan")
        worst = max(worst, whitened(*found, *expected))
    return worst
