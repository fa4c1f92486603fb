"""The task that every contender is timed on: an aircraft in a coordinated turn, seen by a radar.

State (north, east, speed, course, turn rate), measurement (range, azimuth, radial velocity). The
first measurement comes one second after the prior. Nothing here needs more than NumPy, so that a
contender's own process is not charged for another's import.
"""

from typing import Any, NamedTuple

import numpy as np

STEPS, DT = 200, 1.0
# A live filter is made once and then stepped for long: making it should not be what is timed.
LIVE_STEPS = 1000
Q = np.square([1.0, 1.0, 0.1, np.deg2rad(0.3), np.deg2rad(0.04)])
R = np.square([50.0, np.deg2rad(0.008), 0.016])
MEAN = np.array([200e3, 100e3, 100.0, np.deg2rad(45.0), 0.0])
PRIOR = np.square([86.6, 86.6, 29.6, np.deg2rad(20.6), np.deg2rad(0.04)])


class Record(NamedTuple):
    """Truth (B, T, 5) and measurements (B, T, 3) of B tracks."""

    truth: np.ndarray
    z: np.ndarray


COURSE = 3  # the component that is an angle


class Estimate(NamedTuple):
    """What every contender hands over: means (..., T, 5) and covariances (..., T, 5, 5)."""

    mean: Any
    cov: Any


def motion(x: Any, dt: float = DT, xp: Any = np) -> Any:
    """The state (5, ...) dt seconds later."""
    north, east, speed, course, turn_rate = x
    half = turn_rate * (dt / 2)
    way = speed * dt * xp.sinc(half / np.pi)
    return xp.stack(
        [north + way * xp.cos(course + half), east + way * xp.sin(course + half), speed, course + 2 * half, turn_rate]
    )


def sensor(x: Any, xp: Any = np) -> Any:
    """The measurement (3, ...) without noise."""
    north, east, speed, course, _ = x
    azimuth = xp.arctan2(east, north)
    return xp.stack([xp.hypot(north, east), azimuth, speed * xp.cos(course - azimuth)])


def motion_jacobian(x: np.ndarray, dt: float = DT) -> np.ndarray:
    """Derivative (5, 5) of the motion at one state."""
    speed, course, turn_rate = x[2], x[3], x[4]
    half = turn_rate * dt / 2
    if abs(half) < 1e-4:
        ratio, slope = 1 - half**2 / 6, -half / 3
    else:
        ratio, slope = np.sin(half) / half, (np.cos(half) - np.sin(half) / half) / half
    c, s = np.cos(course + half), np.sin(course + half)
    F = np.eye(5)
    F[0, 2:] = dt * ratio * c, -speed * dt * ratio * s, speed * dt * dt / 2 * (slope * c - ratio * s)
    F[1, 2:] = dt * ratio * s, speed * dt * ratio * c, speed * dt * dt / 2 * (slope * s + ratio * c)
    F[3, 4] = dt
    return F


def sensor_jacobian(x: np.ndarray) -> np.ndarray:
    """Derivative (3, 5) of the sensor at one state."""
    north, east, speed, course, _ = x
    squared = north * north + east * east
    distance, relative = np.sqrt(squared), course - np.arctan2(east, north)
    c, s = np.cos(relative), np.sin(relative)
    turn = np.array([-east / squared, north / squared])
    H = np.zeros((3, 5))
    H[0, :2] = north / distance, east / distance
    H[1, :2] = turn
    H[2] = speed * s * turn[0], speed * s * turn[1], c, -speed * s, 0.0
    return H


def predicted(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """The prior moved to the first measurement, for libraries that start there: by "EKF" or by "CKF"."""
    if kind == "EKF":
        F = motion_jacobian(MEAN)
        return motion(MEAN), F @ np.diag(PRIOR) @ F.T + np.diag(Q * DT)
    spread = np.sqrt(len(MEAN)) * np.diag(np.sqrt(PRIOR))
    moved = motion(MEAN[:, None] + np.concatenate([spread, -spread], axis=1))
    mean = moved.mean(1)
    centred = moved - mean[:, None]
    return mean, centred @ centred.T / moved.shape[1] + np.diag(Q * DT)


def record(tracks: int, steps: int = STEPS, seed: int = 1) -> Record:
    """Tracks from the prior's mean, each with its own disturbances and measurement noise.

    A start drawn from the prior would lose the EKF some tracks: then it is not speed that is compared.
    """
    rng = np.random.default_rng(seed)
    x = np.repeat(MEAN[:, None], tracks, axis=1)
    truth, z = np.empty((tracks, steps, 5)), np.empty((tracks, steps, 3))
    for k in range(steps):
        x = motion(x) + np.sqrt(Q * DT)[:, None] * rng.standard_normal((5, tracks))
        truth[:, k] = x.T
        z[:, k] = sensor(x).T + np.sqrt(R) * rng.standard_normal((tracks, 3))
    return Record(truth, z)
