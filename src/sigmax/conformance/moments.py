"""Laws of moments: a rule is exact as far as it says."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sigmax.conformance.task import Adapter, Task, estimate

_MEAN = np.array([0.7, -0.4])
_COV = np.array([[0.5, 0.2], [0.2, 0.3]])


def _expected(g: Callable[[Any, Any], Any]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of g(x), x ~ N(_MEAN, _COV), by a product rule of degree 19."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(10)
    xi = np.stack(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1)
    w = np.outer(weights, weights).ravel() / (2 * np.pi)
    values = g(_MEAN[:, None] + np.linalg.cholesky(_COV) @ xi, np)
    mean = values @ w
    return mean, (values - mean[:, None]) * w @ (values - mean[:, None]).T


def _predicted(adapter: Adapter, g: Callable[[Any, Any], Any]) -> tuple[np.ndarray, np.ndarray]:
    running = adapter.start(Task(g, lambda x, xp: x[:1], 1e-12 * np.eye(2), np.eye(1)), _MEAN, _COV)
    running.predict()
    return estimate(running, len(_MEAN))


def cubic(adapter: Adapter) -> float:
    """The mean of two cubic polynomials, mixed terms included."""

    def g(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 3 - 2 * x[0] * x[1] + 1, x[0] * x[1] ** 2 + x[1] ** 2 - x[0]])

    mean, _ = _predicted(adapter, g)
    exact, _ = _expected(g)
    return float(np.max(np.abs(mean - exact) / np.abs(exact)))


def quintic(adapter: Adapter) -> float:
    """The mean of two polynomials of degree five, and the covariance of two quadratic ones."""

    def g(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 5 - x[0] ** 2 * x[1] ** 2, x[0] * x[1] ** 4 + x[0] ** 3 * x[1] ** 2])

    def q(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 2 + x[1], x[0] * x[1] - x[1] ** 2])

    mean, _ = _predicted(adapter, g)
    exact, _ = _expected(g)
    _, cov = _predicted(adapter, q)
    _, spread = _expected(q)
    return float(
        np.maximum(np.max(np.abs(mean - exact) / np.abs(exact)), np.max(np.abs(cov - spread) / np.abs(spread)))
    )
