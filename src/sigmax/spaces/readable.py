"""What people read of points and covariances: attitudes as roll, pitch and yaw, vectors in the axes of the world."""

from typing import Any

import numpy as np

from sigmax.spaces.groups import Pose3, Rotation
from sigmax.spaces.quaternions import rotate
from sigmax.spaces.space import Space


def roll_pitch_yaw(quaternion: Any) -> np.ndarray:
    """Roll, pitch and yaw (…, 3) in radians of attitudes w, x, y, z (…, 4): yaw about z, then pitch, then roll."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, float), -1, 0)
    return np.stack(
        [
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ],
        axis=-1,
    )


def from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """The quaternion (4,), from body to world, of a body turned by yaw, then pitch and roll about its own axes."""
    (cr, cp, cy), (sr, sp, sy) = (f(np.array([roll, pitch, yaw]) / 2) for f in (np.cos, np.sin))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def readable(space: Space, points: np.ndarray) -> np.ndarray:
    """For each deviation (…, dim) what people read of points (…, size); NaN where a part has no such number."""
    made = np.full((*points.shape[:-1], space.dim), np.nan)
    for part, at, to in space.parts():
        own = points[..., at]
        if part.flat:
            made[..., to] = own
        elif isinstance(part, Rotation | Pose3):
            made[..., to] = np.concatenate([roll_pitch_yaw(own[..., :4]), own[..., 4:]], -1)
        elif part.size == part.dim:
            made[..., to] = own
    return made


def in_world_axes(space: Space, points: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Roots (…, dim, k) of covariances at points, the vectors of poses in the axes of the world."""
    made = np.array(factor)
    for part, at, to in space.parts():
        if isinstance(part, Pose3):
            q = np.moveaxis(points[..., at][..., :4], -1, 0)[..., None]
            for first in range(to.start + 3, to.stop, 3):
                rows = slice(first, first + 3)
                made[..., rows, :] = np.moveaxis(rotate(q, np.moveaxis(factor[..., rows, :], -2, 0)), 0, -2)
    return made
