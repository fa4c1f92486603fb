"""The posterior Cramér–Rao bound: no estimator has a smaller mean square error."""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.engine.vectorized import vectorized
from sigmax.modelling.evaluate import moving, sensing
from sigmax.modelling.noise import OF_MOTION, takes
from sigmax.models import Model, SwitchingModel
from sigmax.studies.simulate import Drawn
from sigmax.studies.study import Study


class Information(NamedTuple):
    """Sums over runs of what each step tells.

    Attributes:
        runs: how many.
        motion: Σ Fᵀ Q⁻¹ F (T, n, n).
        cross: Σ Q⁻¹ F (T, n, n).
        sensor: Σ p Hᵀ R⁻¹ H (T, n, n), p being the probability of detection.
    """

    runs: np.ndarray
    motion: np.ndarray
    cross: np.ndarray
    sensor: np.ndarray

    def plus(self, other: "Information") -> "Information":
        """The sums of both."""
        return Information(*(a + b for a, b in zip(self, other, strict=True)))


def absent(study: Study) -> str:
    """Why a study has no such bound, empty where it has one."""
    model = study.model
    if isinstance(model, SwitchingModel):
        return "the models take turns"
    if model.curved:
        return "the state lives in a curved space"
    if not study.fair:
        return "truth is not drawn from the filters' model and prior"
    if np.linalg.eigvalsh(study.prior.cov).min() <= 0:
        return "the prior knows a combination of components exactly"
    if callable(model.Q) and takes(model.Q, "Q", OF_MOTION) > 1:
        return "the noise of the motion depends on the state"
    if any(callable(R) for R in model.R.values()):
        return "the noise of a sensor depends on the state"
    if (study.elapsed == 0).any():
        return "there is a step in which no time passes"
    if any(np.linalg.cond(_noise(model, dt)) > 1e14 for dt in set(study.elapsed)):
        return "the motion has no noise in some direction"
    return ""


def _noise(model: Model, dt: float) -> np.ndarray:
    if callable(model.Q):
        return np.asarray(model.Q(jnp.asarray(dt)))
    return _matrix(model.Q) * dt


def _matrix(noise: Any) -> np.ndarray:
    return np.diag(np.asarray(noise.entries)) if isinstance(noise, Diagonal) else np.asarray(noise)


def information(study: Study, drawn: Drawn, kept: np.ndarray, backend: str | None = None) -> Information:
    """What the runs of a block with the numbers `kept` tell, along their truth."""
    B, T, n = drawn.truth.shape
    model = study.model
    motion, sensors = _slopes(model)
    before = np.concatenate([drawn.start[:, None], drawn.truth[:, :-1]], axis=1)
    dt = np.broadcast_to(study.elapsed, (B, T)).reshape(-1)
    u = np.zeros((T, 0)) if study.inputs is None else np.asarray(study.inputs, float)
    every = np.broadcast_to(u, (B, *u.shape)).reshape(B * T, -1)
    (F,) = vectorized(motion, before.reshape(B * T, n), dt, every, backend=backend)
    F = F.reshape(B, T, n, n)[kept]
    inverse = np.stack([np.linalg.inv(_noise(model, step)) for step in study.elapsed])
    QF = inverse @ F
    sensed = np.zeros((T, n, n))
    for sensor, slope in sensors.items():
        (H,) = vectorized(slope, drawn.truth.reshape(B * T, n), every, backend=backend)
        H = H.reshape(B, T, -1, n)[kept]
        m = H.shape[-2]
        there = np.broadcast_to(np.asarray(study.measured.get(sensor, True), bool), (T, m))
        R = np.array([_inverse_of(_matrix(model.R[sensor]), seen) for seen in there])
        sensed += study.detections[sensor] * (H.swapaxes(-1, -2) @ R @ H).sum(0)
    return Information(np.array(len(kept)), (F.swapaxes(-1, -2) @ QF).sum(0), QF.sum(0), sensed)


def _inverse_of(R: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The inverse of the part of a covariance that was seen, 0 for the rest."""
    inverse = np.zeros_like(R)
    inverse[np.ix_(seen, seen)] = np.linalg.inv(R[np.ix_(seen, seen)])
    return inverse


@lru_cache(maxsize=16)
def _slopes(model: Model) -> tuple[Any, dict[str, Any]]:
    def motion(x: Any, dt: Any, u: Any) -> Any:
        return jax.jacfwd(moving(model, x, dt, u))(x)

    def of(sensor: str) -> Any:
        def slope(x: Any, u: Any) -> Any:
            return jax.jacfwd(sensing(model, sensor, x, u))(x)

        return slope

    return motion, {sensor: of(sensor) for sensor in model.sensors}


def bound(study: Study, told: Information) -> np.ndarray:
    """The least root mean square error of each component over time (T, n) (Tichavský et al. 1998, (21))."""
    J = np.linalg.inv(study.prior.cov)
    least = []
    for motion, cross, sensor, dt in zip(told.motion, told.cross, told.sensor, study.elapsed, strict=True):
        C = cross / told.runs
        J = (
            np.linalg.inv(_noise(study.model, dt))
            + sensor / told.runs
            - C @ np.linalg.solve(J + motion / told.runs, C.T)
        )
        J = (J + J.T) / 2
        least.append(np.sqrt(np.diag(np.linalg.inv(J))))
    return np.array(least)
