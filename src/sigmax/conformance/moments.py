"""Laws of moments: a rule is exact as far as it says."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sigmax.conformance.task import Adapter, Task, estimate

_MEAN = np.array([0.7, -0.4])
_COV = np.array([[0.5, 0.2], [0.2, 0.3]])
# Of the motion, next to none: there are filters that cannot do without.
_Q = 1e-12 * np.eye(2)


def _expected(g: Callable[[Any, Any], Any], cov: np.ndarray = _COV) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of g(x), x ~ N(_MEAN, cov), by a product rule of degree 19."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(10)
    xi = np.stack(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1)
    w = np.outer(weights, weights).ravel() / (2 * np.pi)
    values = g(_MEAN[:, None] + np.linalg.cholesky(cov) @ xi, np)
    mean = values @ w
    return mean, (values - mean[:, None]) * w @ (values - mean[:, None]).T


def _predicted(adapter: Adapter, g: Callable[[Any, Any], Any]) -> tuple[np.ndarray, np.ndarray]:
    running = adapter.start(Task(g, lambda x, xp: x[:1], _Q, np.eye(1)), _MEAN, _COV)
    running.predict()
    return estimate(running, len(_MEAN))


def _foreseen(adapter: Adapter, g: Callable[[Any, Any], Any]) -> np.ndarray:
    """The mean of the measurement g(x) that an update reckons with: the z by which it moves nothing.

    An update moves the mean by K (z − ẑ); three of the same prediction show K and ẑ.
    """
    task = Task(lambda x, xp: x, g, _Q, np.eye(2))

    def moved(z: Any) -> np.ndarray:
        running = adapter.start(task, _MEAN, _COV)
        running.predict()
        before, _ = estimate(running, 2)
        running.update(np.asarray(z))
        return estimate(running, 2)[0] - before

    none, first, second = (moved(z) for z in ([0.0, 0.0], [1.0, 0.0], [0.0, 1.0]))
    return -np.linalg.solve(np.column_stack([first - none, second - none]), none)


def _means(adapter: Adapter, g: Callable[[Any, Any], Any]) -> float:
    """The larger relative error of the mean of g(x), g taken for the motion and for the sensor."""
    exact = np.stack([_expected(g)[0], _expected(g, _COV + _Q)[0]])
    found = np.stack([_predicted(adapter, g)[0], _foreseen(adapter, g)])
    return float(np.max(np.abs(found - exact) / np.abs(exact)))


def cubic(adapter: Adapter) -> float:
    """The mean of two cubic polynomials, mixed terms included."""

    def g(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 3 - 2 * x[0] * x[1] + 1, x[0] * x[1] ** 2 + x[1] ** 2 - x[0]])

    return _means(adapter, g)


def quintic(adapter: Adapter) -> float:
    """The mean of two polynomials of degree five, and the covariance of two quadratic ones."""

    def g(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 5 - x[0] ** 2 * x[1] ** 2, x[0] * x[1] ** 4 + x[0] ** 3 * x[1] ** 2])

    def q(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] ** 2 + x[1], x[0] * x[1] - x[1] ** 2])

    _, cov = _predicted(adapter, q)
    _, spread = _expected(q)
    return float(np.maximum(_means(adapter, g), np.max(np.abs(cov - spread) / np.abs(spread))))
