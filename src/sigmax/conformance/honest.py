"""The law of honesty: over many runs, squared errors are as large as the covariance says, in every direction.

Noise of the motion is large beside what the sensor leaves open, so that a filter that forgets some of it, or of the
sensor's, is found out; what is not linear is gentle, so that a filter that only linearises is not. No angle comes near
±π, so that the law is one for libraries without means for angles too.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sigmax.conformance.task import Adapter, Task, estimate

_RUNS, _STEPS = 40, 20


class _Problem(NamedTuple):
    task: Task
    mean: np.ndarray
    variances: np.ndarray


def _drawn(density: float) -> np.ndarray:
    """Noise of two velocities, white acceleration of this density, over a second."""
    return density * np.kron([[1 / 3, 1 / 2], [1 / 2, 1]], np.eye(2))


def _straight(x: Any, xp: Any) -> Any:
    return xp.stack([x[0] + x[2], x[1] + x[3], x[2], x[3]])


def _radar() -> _Problem:
    """A target that a pilot moves at will, range and azimuth."""

    def sensor(x: Any, xp: Any) -> Any:
        return xp.stack([xp.hypot(x[0], x[1]), xp.arctan2(x[1], x[0])])

    task = Task(_straight, sensor, _drawn(400.0), np.diag([10.0**2, 0.001**2]))
    return _Problem(task, np.array([8e3, 6e3, -80.0, 40.0]), np.array([1e4, 1e4, 400.0, 400.0]))


def _turn() -> _Problem:
    """A target that turns, of speed, course and rate of turn; range and azimuth."""

    def motion(x: Any, xp: Any) -> Any:
        course = x[3] + x[4] / 2
        return xp.stack([x[0] + x[2] * xp.cos(course), x[1] + x[2] * xp.sin(course), x[2], x[3] + x[4], x[4]])

    def sensor(x: Any, xp: Any) -> Any:
        return xp.stack([xp.hypot(x[0], x[1]), xp.arctan2(x[1], x[0])])

    task = Task(motion, sensor, np.diag([100.0, 100.0, 25.0, 1e-4, 1e-5]), np.diag([25.0, 1e-6]))
    return _Problem(task, np.array([9e3, 4e3, 150.0, 1.0, 0.03]), np.array([2500.0, 2500.0, 100.0, 0.01, 1e-4]))


def _pendulum() -> _Problem:
    """A pendulum of which the sideways position is measured (Särkkä 2013, example 5.1)."""

    def motion(x: Any, xp: Any) -> Any:
        return xp.stack([x[0] + 0.05 * x[1], x[1] - 0.49 * xp.sin(x[0])])

    Q = np.array([[1e-3, 1.25e-4], [1.25e-4, 5e-3]])
    task = Task(motion, lambda x, xp: xp.sin(x[:1]), Q, np.diag([4e-4]))
    return _Problem(task, np.array([0.8, 0.0]), np.array([0.04, 0.04]))


def _beacons() -> _Problem:
    """Ranges to three beacons from a moving vehicle."""
    places = np.array([[0.0, 0.0], [60.0, 0.0], [20.0, 50.0]])

    def sensor(x: Any, xp: Any) -> Any:
        return xp.stack([xp.hypot(x[0] - a, x[1] - b) for a, b in places])

    task = Task(_straight, sensor, _drawn(0.5), np.diag([0.1, 0.1, 0.1]))
    return _Problem(task, np.array([15.0, 20.0, 1.0, 0.5]), np.array([9.0, 9.0, 0.25, 0.25]))


def _off_balance(problem: Callable[[], _Problem], adapter: Adapter) -> float:
    """The largest of the eigenvalues, and of their inverses, of the mean of w wᵀ over runs and steps, w = S⁻¹ e.

    S Sᵀ is the covariance the filter gives, e its error; everyone is given the same draws.
    """
    task, start, variances = problem()
    rng = np.random.default_rng(11)
    n, m = len(start), len(task.R)
    cov = np.diag(variances)
    Lq, Lr = np.linalg.cholesky(task.Q), np.linalg.cholesky(task.R)
    total = np.zeros((n, n))
    for _ in range(_RUNS):
        x = start + np.sqrt(variances) * rng.standard_normal(n)
        running = adapter.start(task, start.copy(), cov.copy())
        for _ in range(_STEPS):
            x = task.f(x) + Lq @ rng.standard_normal(n)
            z = task.h(x) + Lr @ rng.standard_normal(m)
            running.predict()
            running.update(z)
            mean, spread = estimate(running, n)
            w = np.linalg.solve(np.linalg.cholesky(spread), mean - x)
            total += np.outer(w, w)
    sizes = np.linalg.eigvalsh(total / (_RUNS * _STEPS))
    return float(max(sizes[-1], 1 / sizes[0])) if sizes[0] > 0 else float("inf")


PROBLEMS: list[tuple[str, str, Callable[[Adapter], float]]] = [
    ("radar", "a manoeuvring target seen by a radar", partial(_off_balance, _radar)),
    ("turn", "a turning target seen by a radar", partial(_off_balance, _turn)),
    ("pendulum", "a pendulum seen from above", partial(_off_balance, _pendulum)),
    ("beacons", "ranges to three beacons", partial(_off_balance, _beacons)),
]
