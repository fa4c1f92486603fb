"""FilterPy: NumPy, one object a track; model functions in NumPy as its documentation has them, or on plain floats."""

from math import atan2, cos, hypot, pi, sin
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from contenders import Entry, step_by_step
from scenario import DT, MEAN, PRIOR, Estimate, Q, R, motion, motion_jacobian, sensor, sensor_jacobian

_GIVES = "mean, cov"


def _motion(x: np.ndarray, dt: float) -> np.ndarray:
    north, east, speed, course, turn_rate = x.tolist()
    half = turn_rate * dt / 2
    way = speed * dt * (sin(half) / half if half else 1.0)
    return np.array(
        [north + way * cos(course + half), east + way * sin(course + half), speed, course + 2 * half, turn_rate]
    )


def _sensor(x: np.ndarray) -> np.ndarray:
    north, east, speed, course, _ = x.tolist()
    azimuth = atan2(east, north)
    return np.array([hypot(north, east), azimuth, speed * cos(course - azimuth)])


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    d = a - b
    d[1] = (d[1] + pi) % (2 * pi) - pi
    return d


def _set_up(made: Any) -> Any:
    made.x, made.P = MEAN.copy(), np.diag(PRIOR)
    made.Q, made.R = np.diag(Q * DT), np.diag(R)
    return made


def _ukf(hx: Any, fx: Any) -> Any:
    # Differences of angles are left to subtraction: its loop over wrapped ones would be slower still.
    points = MerweScaledSigmaPoints(5, alpha=1.0, beta=0.0, kappa=0.0)
    return _set_up(UnscentedKalmanFilter(dim_x=5, dim_z=3, dt=DT, hx=hx, fx=fx, points=points))


class _TurnEKF(ExtendedKalmanFilter):  # type: ignore[misc]
    """Overrides `predict_x` for a nonlinear motion, as its documentation says."""

    def predict_x(self, u: Any = 0) -> None:
        self.F = motion_jacobian(self.x)
        self.x = _motion(self.x, DT)


def _track_ukf(z: np.ndarray, hx: Any, fx: Any) -> Estimate:
    return step_by_step(_ukf(hx, fx), z)


def _track_ekf(z: np.ndarray) -> Estimate:
    tracker, means, covs = _set_up(_TurnEKF(dim_x=5, dim_z=3)), [], []
    for measured in z:
        tracker.predict()
        tracker.update(measured, sensor_jacobian, _sensor, residual=_difference)
        means.append(tracker.x)
        covs.append(tracker.P)
    return Estimate(np.array(means), np.array(covs))


def live(z: np.ndarray) -> list[Entry]:
    """Step by step."""
    return [
        Entry("FilterPy UKF", "CKF", _GIVES, lambda: _track_ukf(z, sensor, motion)),
        Entry("FilterPy UKF, model on plain floats", "CKF", _GIVES, lambda: _track_ukf(z, _sensor, _motion)),
        Entry("FilterPy EKF, model on plain floats", "EKF", _GIVES, lambda: _track_ekf(z)),
    ]
