"""kalbee: columns; no means for angles."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from kalbee.modules.filters.ckf_filter import CubatureKalmanFilter
from kalbee.modules.filters.ekf_filter import ExtendedKalmanFilter
from kalbee.modules.filters.sigma_point_ukf import SigmaPointUKF
from kalbee.modules.filters.sr_ukf import SquareRootUKF
from kalbee.modules.filters.ukf_filter import UnscentedKalmanFilter

from conforming import MISSING, column, skipping
from sigmax.conformance import Adapter, Task


class _Running:
    def __init__(self, filter: Any) -> None:
        self.filter = filter

    mean = property(lambda self: np.ravel(self.filter.x))
    cov = property(lambda self: self.filter.P)

    def predict(self) -> None:
        self.filter.predict(dt=1.0)

    def update(self, z: np.ndarray) -> None:
        self.filter.update(z.reshape(-1, 1))


def adapters(name: str, version: str) -> Iterator[Adapter]:
    def start(kind: Any, task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
        f, h = column(task)
        further = {}
        if kind is ExtendedKalmanFilter:
            F, H = task.jacobians
            further = {"transition_jacobian": lambda x, dt: F(x), "measurement_jacobian": H}
        return skipping(_Running(kind(mean.reshape(-1, 1), cov, task.Q, task.R, f, h, **further)))

    kinds = {
        "EKF": (1, ExtendedKalmanFilter),
        "UKF": (3, UnscentedKalmanFilter),
        "SigmaPointUKF": (3, SigmaPointUKF),
        "SquareRootUKF": (3, SquareRootUKF),
        "CKF": (3, CubatureKalmanFilter),
    }
    for label, (degree, kind) in kinds.items():
        yield Adapter(
            f"kalbee {label}", lambda *given, kind=kind: start(kind, *given), degree, frozenset({MISSING}), version
        )
