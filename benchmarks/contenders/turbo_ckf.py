"""turbo-ckf: Rust, called from Python with the model's functions on all points at once."""

from typing import Any

import numpy as np
from turbo_ckf import TurboCKF, TurboSRCKF

from contenders import Entry, step_by_step
from scenario import DT, MEAN, PRIOR, Estimate, Q, R, motion, sensor

_FILTERS = {"CKF": TurboCKF, "SR-CKF": TurboSRCKF}


def _motion(points: np.ndarray, dt: float) -> np.ndarray:
    return motion(points.T, dt).T


def _sensor(points: np.ndarray) -> np.ndarray:
    return sensor(points.T).T


def _made(kind: Any) -> Any:
    tracker = kind(dim_x=5, dim_z=3, dt=DT, hx=_sensor, fx=_motion)
    tracker.x, tracker.P, tracker.Q, tracker.R = MEAN, np.diag(PRIOR), np.diag(Q * DT), np.diag(R)
    return tracker


def _steps(kind: Any, z: np.ndarray) -> Estimate:
    return step_by_step(_made(kind), z)


def _whole(kind: Any, z: np.ndarray) -> Estimate:
    run = _made(kind).run(z)
    return Estimate(run.xs, run.Ps)


def offline(z: np.ndarray) -> list[Entry]:
    """Its loop over a record."""
    return [
        Entry(f"turbo-ckf {n}", "CKF", "mean, cov, NIS, log-likelihood", lambda k=k: _whole(k, z))
        for n, k in _FILTERS.items()
    ]


def live(z: np.ndarray) -> list[Entry]:
    """Step by step."""
    return [Entry(f"turbo-ckf {n}", "CKF", "mean, cov", lambda k=k: _steps(k, z)) for n, k in _FILTERS.items()]
