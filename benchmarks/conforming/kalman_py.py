"""kalman-py: its residual of measurements is given for angles."""

from collections.abc import Iterator
from typing import Any

import kalman_py
import numpy as np

from conforming import ANGLES, MISSING, skipping
from sigmax.conformance import Adapter, Task


class _Running:
    def __init__(self, filter: Any) -> None:
        self.filter = filter

    mean = property(lambda self: self.filter.x)
    cov = property(lambda self: self.filter.P)

    def predict(self) -> None:
        self.filter.predict(1.0)

    def update(self, z: np.ndarray) -> None:
        self.filter.update(z)


def adapters(name: str, version: str) -> Iterator[Adapter]:
    def start(kind: str, square_root: bool) -> Any:
        def made(task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
            further: dict[str, Any] = {"square_root": square_root}
            if any(task.angles):
                further["residual_z"] = lambda a, b: task.wrapped(a - b)
            if kind == "EKF":
                F, H = task.jacobians
                further |= {"jac_f": lambda x, dt: F(x), "jac_h": H}
            library = kalman_py.ExtendedKalmanFilter if kind == "EKF" else kalman_py.UnscentedKalmanFilter
            return skipping(_Running(library(task.f, task.h, task.Q, task.R, mean, cov, **further)))

        return made

    offers = frozenset({ANGLES, MISSING})
    yield Adapter("kalman-py EKF", start("EKF", False), 1, offers, version)
    yield Adapter("kalman-py UKF", start("UKF", False), 3, offers, version)
    yield Adapter("kalman-py UKF, square root", start("UKF", True), 3, offers, version)
