"""Stone Soup: predictors and updaters; angles as its `Bearing`."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.nonlinear import GaussianTransitionModel
from stonesoup.predictor.kalman import CubatureKalmanPredictor, ExtendedKalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.angle import Bearing
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import CubatureKalmanUpdater, ExtendedKalmanUpdater, UnscentedKalmanUpdater

from conforming import ANGLES, MISSING, skipping
from sigmax.conformance import Adapter, Task

_START = datetime(2020, 1, 1)
_SECOND = timedelta(seconds=1)


def _vectors(values: Any, angles: tuple[bool, ...]) -> Any:
    values = np.asarray(values, float).reshape(len(angles), -1)
    kind = StateVector if values.shape[1] == 1 else StateVectors
    if not any(angles):
        return kind(values)
    rows = [[Bearing(v) if turning else float(v) for v in row] for row, turning in zip(values, angles, strict=True)]
    return kind(np.array(rows, object))


def _plain(vector: Any) -> np.ndarray:
    return np.asarray(vector).astype(float)


class _Motion(GaussianTransitionModel):  # type: ignore[misc]
    task: Task = Property(doc="The model")

    @property
    def ndim_state(self) -> int:
        return len(self.task.Q)

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        return _vectors(self.task.f(_plain(state.state_vector)), self.task.state_angles)

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        return self.task.jacobians[0](_plain(state.state_vector))

    def covar(self, **kwargs: Any) -> Any:
        return CovarianceMatrix(self.task.Q)


class _Sensor(NonLinearGaussianMeasurement):  # type: ignore[misc]
    task: Task = Property(doc="The model")

    @property
    def ndim_meas(self) -> int:
        return len(self.task.R)

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        return _vectors(self.task.h(_plain(state.state_vector)), self.task.angles)

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        return self.task.jacobians[1](_plain(state.state_vector))


class _Running:
    def __init__(self, kinds: Any, task: Task, mean: np.ndarray, cov: np.ndarray) -> None:
        n = len(mean)
        self.task, self.now = task, _START
        sensor = _Sensor(ndim_state=n, mapping=tuple(range(n)), noise_covar=CovarianceMatrix(task.R), task=task)
        self.predictor, self.updater = kinds[0](_Motion(task=task)), kinds[1](sensor)
        self.state: Any = GaussianState(_vectors(mean, task.state_angles), CovarianceMatrix(cov), timestamp=self.now)

    mean = property(lambda self: _plain(self.state.mean).ravel())
    cov = property(lambda self: _plain(self.state.covar))

    def predict(self) -> None:
        self.now += _SECOND
        self.state = self.predictor.predict(self.state, timestamp=self.now)

    def update(self, z: np.ndarray) -> None:
        if self.state.timestamp == self.now and not hasattr(self.state, "transition_model"):
            # A second measurement of a moment: a prediction over no time would add noise.
            self.state = _as_prediction(self.state)
        detection = Detection(
            _vectors(z, self.task.angles), timestamp=self.now, measurement_model=self.updater.measurement_model
        )
        self.state = self.updater.update(SingleHypothesis(self.state, detection))


def _as_prediction(state: Any) -> Any:
    from stonesoup.types.prediction import GaussianStatePrediction

    return GaussianStatePrediction(state.state_vector, state.covar, timestamp=state.timestamp)


def adapters(name: str, version: str) -> Iterator[Adapter]:
    kinds = {
        "EKF": (1, ExtendedKalmanPredictor, ExtendedKalmanUpdater),
        "UKF": (3, UnscentedKalmanPredictor, UnscentedKalmanUpdater),
        "CKF": (3, CubatureKalmanPredictor, CubatureKalmanUpdater),
    }
    for kind, (degree, *parts) in kinds.items():

        def start(task: Task, mean: np.ndarray, cov: np.ndarray, parts: Any = parts) -> Any:
            return skipping(_Running(parts, task, mean, cov))

        yield Adapter(f"Stone Soup {kind}", start, degree, frozenset({ANGLES, MISSING}), version)
