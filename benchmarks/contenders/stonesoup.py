"""Stone Soup: models as classes, detections and hypotheses as objects; Jacobians given in closed form."""

from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.nonlinear import GaussianTransitionModel
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

from contenders import Entry
from scenario import DT, MEAN, PRIOR, Estimate, Q, R, motion, motion_jacobian, sensor, sensor_jacobian

_START = datetime(2020, 1, 1)


def _vectors(values: np.ndarray) -> Any:
    return values.view(StateVector if values.shape[1] == 1 else StateVectors)


class _Turn(GaussianTransitionModel):  # type: ignore[misc]
    covariance: CovarianceMatrix = Property(doc="Noise per second")

    @property
    def ndim_state(self) -> int:
        return 5

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        return _vectors(motion(np.asarray(state.state_vector), kwargs["time_interval"].total_seconds()))

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        return motion_jacobian(np.asarray(state.state_vector).ravel(), kwargs["time_interval"].total_seconds())

    def covar(self, **kwargs: Any) -> Any:
        return self.covariance * kwargs["time_interval"].total_seconds()


class _Radar(NonLinearGaussianMeasurement):  # type: ignore[misc]
    @property
    def ndim_meas(self) -> int:
        return 3

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        return _vectors(sensor(np.asarray(state.state_vector)))

    def jacobian(self, state: Any, **kwargs: Any) -> np.ndarray:
        return sensor_jacobian(np.asarray(state.state_vector).ravel())


def _track(predictor: Any, updater: Any, z: np.ndarray) -> Estimate:
    state: Any = GaussianState(StateVector(MEAN), CovarianceMatrix(np.diag(PRIOR)), timestamp=_START)
    means, covs = [], []
    for k, measured in enumerate(z):
        now = _START + timedelta(seconds=(k + 1) * DT)
        prediction = predictor.predict(state, timestamp=now)
        detection = Detection(StateVector(measured), timestamp=now, measurement_model=updater.measurement_model)
        state = updater.update(SingleHypothesis(prediction, detection))
        means.append(np.asarray(state.mean).ravel())
        covs.append(np.asarray(state.covar))
    return Estimate(np.array(means), np.array(covs))


def live(z: np.ndarray) -> list[Entry]:
    """Step by step."""
    turn = _Turn(covariance=CovarianceMatrix(np.diag(Q)))
    radar = _Radar(ndim_state=5, mapping=(0, 1), noise_covar=CovarianceMatrix(np.diag(R)))
    weights = {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
    ukf = UnscentedKalmanPredictor(turn, **weights), UnscentedKalmanUpdater(radar, **weights)
    ekf = ExtendedKalmanPredictor(turn), ExtendedKalmanUpdater(radar)
    return [
        Entry("Stone Soup UKF", "CKF", "mean, cov", lambda: _track(*ukf, z)),
        Entry("Stone Soup EKF", "EKF", "mean, cov", lambda: _track(*ekf, z)),
    ]
