"""pykalman: one function predicts and corrects; a second measurement of a moment comes with a motion that stands."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from pykalman import AdditiveUnscentedKalmanFilter

from conforming import MISSING
from sigmax.conformance import Adapter, Task


class _Running:
    def __init__(self, task: Task, mean: np.ndarray, cov: np.ndarray) -> None:
        self.filter = AdditiveUnscentedKalmanFilter(task.f, task.h, task.Q, task.R, mean, cov)
        self.state = mean, cov
        self.due = False

    def _settled(self) -> Any:
        if self.due:
            self.state, self.due = self.filter.filter_update(*self.state), False
        return self.state

    mean = property(lambda self: self._settled()[0])
    cov = property(lambda self: self._settled()[1])

    def predict(self) -> None:
        self._settled()
        self.due = True

    def update(self, z: np.ndarray) -> None:
        if np.isnan(z).all():
            self._settled()
            return
        standing = {} if self.due else {
            "transition_function": lambda x: x, "transition_covariance": np.zeros((len(self.state[0]),) * 2)
        }  # fmt: skip
        self.state, self.due = self.filter.filter_update(*self.state, observation=z, **standing), False


def adapters(name: str, version: str) -> Iterator[Adapter]:
    yield Adapter("pykalman additive UKF", _Running, 3, frozenset({MISSING}), version)
