"""FilterPy, bayesian-filters, and our classes of the same names."""

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from conforming import ANGLES, MISSING, circular
from sigmax.conformance import Adapter, Task


class _Sampled:
    def __init__(self, filter: Any, mean: np.ndarray, cov: np.ndarray, task: Task) -> None:
        self.filter = filter
        filter.x, filter.P, filter.Q, filter.R = mean, cov, task.Q, task.R

    mean = property(lambda self: np.ravel(self.filter.x))
    cov = property(lambda self: self.filter.P)

    def predict(self) -> None:
        self.filter.predict()

    def update(self, z: np.ndarray) -> None:
        self.filter.update(None if np.isnan(z).all() else z)


class _Cubature(_Sampled):
    def update(self, z: np.ndarray) -> None:
        # Its expected measurement is a column.
        z = z.reshape(-1, 1) if self.filter.x.ndim == 2 else z
        self.filter.update(None if np.isnan(z).all() else z)


class _Extended(_Sampled):
    def __init__(self, filter: Any, mean: np.ndarray, cov: np.ndarray, task: Task) -> None:
        super().__init__(filter, mean, cov, task)
        self.task = task

    def update(self, z: np.ndarray) -> None:
        given = None if np.isnan(z).all() else z
        residual = lambda a, b: self.task.wrapped(a - b)  # noqa: E731
        self.filter.update(given, self.task.jacobians[1], self.task.h, residual=residual)


def of_module(library: str, module: str, version: str) -> Iterator[Adapter]:
    """The extended, unscented and cubature filter of a module with FilterPy's names."""
    lib = import_module(module)
    offers = frozenset({ANGLES, MISSING})

    def extended(task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
        class Moving(lib.ExtendedKalmanFilter):  # type: ignore[misc, name-defined]
            def predict_x(self, u: Any = 0) -> None:
                self.F = task.jacobians[0](self.x)
                self.x = task.f(self.x)

        return _Extended(Moving(len(mean), len(task.R)), mean, cov, task)

    def hooks(task: Task) -> dict[str, Any]:
        if not any(task.state_angles + task.angles):
            return {}
        return {
            "x_mean_fn": circular(task.state_angles),
            "z_mean_fn": circular(task.angles),
            "residual_x": lambda a, b: task.state_wrapped(a - b),
            "residual_z": lambda a, b: task.wrapped(np.ravel(a) - np.ravel(b)).reshape(np.shape(b)),
        }

    def unscented(task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
        points = lib.MerweScaledSigmaPoints(len(mean), alpha=1.0, beta=2.0, kappa=0.0)
        made = lib.UnscentedKalmanFilter(len(mean), len(task.R), 1.0, task.h, task.f, points, **hooks(task))
        return _Sampled(made, mean, cov, task)

    def cubature(task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
        made = lib.CubatureKalmanFilter(len(mean), len(task.R), 1.0, task.h, task.f, **hooks(task))
        return _Cubature(made, mean, cov, task)

    yield Adapter(f"{library} EKF", extended, 1, offers, version)
    yield Adapter(f"{library} UKF", unscented, 3, offers, version)
    yield Adapter(f"{library} CKF", cubature, 3, offers, version)


def adapters(name: str, version: str) -> Iterator[Adapter]:
    yield from of_module(name, f"{name.replace('-', '_')}.kalman", version)
