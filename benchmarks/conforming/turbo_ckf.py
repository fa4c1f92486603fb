"""turbo-ckf: functions of all points at once; no means for angles."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from turbo_ckf import TurboCKF, TurboSRCKF

from conforming import MISSING
from sigmax.conformance import Adapter, Task


class _Running:
    def __init__(self, kind: Any, task: Task, mean: np.ndarray, cov: np.ndarray) -> None:
        self.filter = kind(
            dim_x=len(mean), dim_z=len(task.R), dt=1.0, hx=lambda X: task.h(X.T).T, fx=lambda X, dt: task.f(X.T).T
        )
        self.filter.x, self.filter.P, self.filter.Q, self.filter.R = mean, cov, task.Q, task.R

    mean = property(lambda self: np.array(self.filter.x))
    cov = property(lambda self: np.array(self.filter.P))

    def predict(self) -> None:
        self.filter.predict()

    def update(self, z: np.ndarray) -> None:
        self.filter.update(None if np.isnan(z).all() else z)


def adapters(name: str, version: str) -> Iterator[Adapter]:
    for label, kind in (("CKF", TurboCKF), ("SRCKF", TurboSRCKF)):
        yield Adapter(
            f"turbo-ckf {label}", lambda *given, kind=kind: _Running(kind, *given), 3, frozenset({MISSING}), version
        )
