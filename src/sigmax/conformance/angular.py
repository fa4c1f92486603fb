"""Laws of angles: what is true of a scene is true of the scene turned."""

from typing import Any

import numpy as np

from sigmax.conformance.task import Adapter, Task, estimate, wrapped

# With 2.7 the estimate comes to 3, its points to both sides of π.
_TURNS = (1.0, 2.7, np.pi, -2.8, 25.0)


def _gap(plain: list[Any], turned: list[Any], turn: np.ndarray, shift: np.ndarray, angles: tuple[bool, ...]) -> float:
    """The largest difference of a turned run from the plain one turned, whitened."""
    worst = []
    for (x, P), (y, V) in zip(plain, turned, strict=True):
        expected = turn @ P @ turn.T
        whiten = np.linalg.inv(np.linalg.cholesky(expected))
        worst.append(np.abs(whiten @ wrapped(y - turn @ x - shift, angles)).max())
        worst.append(np.abs(whiten @ (V - expected) @ whiten.T).max())
    return float(np.max(worst))


def _run(adapter: Adapter, task: Task, mean: np.ndarray, cov: np.ndarray, record: np.ndarray) -> list[Any]:
    running, found = adapter.start(task, mean, cov), []
    for z in record:
        running.predict()
        running.update(z)
        found.append(estimate(running, len(mean)))
    return found


def rotation(adapter: Adapter) -> float:
    """An antenna's azimuth, rate and range in a field fixed to the scene; a bearing and a range are measured."""

    def task(turn: float) -> Task:
        def motion(x: Any, xp: Any) -> Any:
            pull = 0.2 * xp.sin(x[0] - turn)
            return xp.stack([x[0] + 0.7 * x[1] + 0.1 * pull, x[1] - pull, x[2] + 0.2 * xp.cos(x[0] - turn)])

        def sensor(x: Any, xp: Any) -> Any:
            east, north = x[2] * xp.cos(x[0]), x[2] * xp.sin(x[0])
            return xp.stack([xp.arctan2(north, east), x[2] + 0.1 * x[1]])

        Q, R = np.diag([0.01, 0.01, 0.02]), np.array([[0.02, 0.005], [0.005, 0.05]])
        return Task(motion, sensor, Q, R, (True, False, False), (True, False))

    mean, cov = np.array([0.3, 0.2, 5.0]), np.array([[0.05, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.3]])
    record = np.array([[0.5, 5.3], [0.55, 5.2], [0.7, 5.6], [0.6, 5.5]])
    angles = (True, False, False)
    plain = _run(adapter, task(0.0), mean, cov, record)
    worst = []
    for turn in _TURNS:
        shift = np.array([turn, 0.0, 0.0])
        turned = np.column_stack([wrapped(record[:, :1] + turn, (True,)), record[:, 1]])
        found = _run(adapter, task(turn), wrapped(mean + shift, angles), cov, turned)
        worst.append(_gap(plain, found, np.eye(3), shift, angles))
    return float(np.max(worst))


def bearing(adapter: Adapter) -> float:
    """A moving target whose bearing spreads over ±π, against the same with bearings counted from the other side."""

    def task(side: float) -> Task:
        def motion(x: Any, xp: Any) -> Any:
            return xp.stack([x[0] + x[2], x[1] + x[3], x[2], x[3]])

        def sensor(x: Any, xp: Any) -> Any:
            return xp.stack([xp.hypot(x[0], x[1]), xp.arctan2(side * x[1], side * x[0])])

        return Task(motion, sensor, np.diag([0.1, 0.1, 0.01, 0.01]), np.diag([25.0, 1e-4]), angles=(False, True))

    mean, cov = np.array([1000.0, -2.0, -5.0, 1.0]), np.diag([900.0, 900.0, 4.0, 4.0])
    record = np.array([[996.0, 0.004], [989.0, -0.007], [986.0, 0.011], [979.0, 0.002], [975.0, -0.003]])
    opposite = wrapped(record + np.array([0.0, np.pi]), (False, True))
    plain, turned = _run(adapter, task(1.0), mean, cov, record), _run(adapter, task(-1.0), mean, cov, opposite)
    return _gap(plain, turned, np.eye(4), np.zeros(4), (False,) * 4)
