"""What a sensor finds: its plots, how surely it finds a target, how many plots come from nothing."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.modelling.noise import Noise
from sigmax.modelling.parts import made_once


class Scan(NamedTuple):
    """What one sensor reported at one time.

    Attributes:
        time: seconds.
        sensor: its name in the model, "" where there is only one.
        z: the plots (k, m), k ≥ 0, NaN where a component is missing.
        u: inputs of the sensor (j,), such as where its platform was and where it headed; or None.
    """

    time: float
    sensor: str
    z: np.ndarray
    u: np.ndarray | None = None


class Located(NamedTuple):
    """Where plots are, for those that tell.

    Attributes:
        position: (k, d).
        cov: (k, d, d).
        direction: unit vectors from the sensor (k, d), or None.
        radial: radial velocity (k,), NaN where it is missing; or None.
        radial_variance: of it.
        velocity: where a report tells it (k, d), or None.
        velocity_cov: of it (d, d).
    """

    position: np.ndarray
    cov: np.ndarray
    direction: np.ndarray | None = None
    radial: np.ndarray | None = None
    radial_variance: float = 0.0
    velocity: np.ndarray | None = None
    velocity_cov: np.ndarray | None = None

    def take(self, index: Any) -> "Located":
        """Some of the plots."""
        direction = None if self.direction is None else self.direction[index]
        radial = None if self.radial is None else self.radial[index]
        velocity = None if self.velocity is None else self.velocity[index]
        return self._replace(
            position=self.position[index],
            cov=self.cov[index],
            direction=direction,
            radial=radial,
            velocity=velocity,
        )


Locate = Callable[[np.ndarray, np.ndarray | None], Located]


@dataclass(frozen=True)
class Detector:
    """How a sensor detects.

    Attributes:
        detection: the probability to see a target that is there: a number, or a function of the expected
            measurements (B, m) that gives (B,), such as 0 outside the field of view.
        clutter: plots from nothing, expected per scan and unit of what is measured (per m² for positions,
            per m·rad for range and azimuth): a number, or a function of plots (k, m) that gives (k,).
        locate: where plots are, see `positions` and `polar`; None for a sensor that starts no tracks.
    """

    detection: float | Callable[[np.ndarray], np.ndarray]
    clutter: float | Callable[[np.ndarray], np.ndarray]
    locate: Locate | None = field(default=None)

    def __post_init__(self) -> None:
        if not callable(self.detection) and not 0 < self.detection <= 1:
            raise InputError(f"detection is a probability, above 0 and at most 1; it is {self.detection}")
        if not callable(self.clutter) and not self.clutter > 0:
            raise InputError(
                f"clutter is a density, false plots per scan and unit measured, above 0; it is {self.clutter}"
            )

    def detects(self, expected: np.ndarray) -> np.ndarray:
        """The probability of detection (B,) at expected measurements (B, m)."""
        p = self.detection(expected) if callable(self.detection) else self.detection
        # A certain detection would make one miss the end of a track.
        return np.clip(np.broadcast_to(p, len(expected)), 0.0, 0.999)

    def false(self, z: np.ndarray) -> np.ndarray:
        """The density of clutter (k,) at plots (k, m)."""
        return np.broadcast_to(self.clutter(z) if callable(self.clutter) else self.clutter, len(z))


def covariance_of(R: Noise) -> np.ndarray:
    """A noise given as numbers, as a matrix.

    Raises:
        InputError: where it is a function.
    """
    if callable(R):
        raise InputError("R is a function of the state; give the standard deviations by which plots are located")
    given = np.asarray(R.entries if isinstance(R, Diagonal) else R, float)
    return np.diag(given) if given.ndim == 1 else given


@made_once
def positions(R: Noise, d: int = 2, *, from_inputs: bool = False) -> Locate:
    """Plots whose first `d` components are the position, with the sensor's noise R.

    They are counted from the platform where the first inputs of a scan say where that is (`from_inputs`).
    """
    cov = covariance_of(R)

    def locate(z: np.ndarray, u: np.ndarray | None) -> Located:
        place = u[:d] if from_inputs and u is not None else 0.0
        return Located(z[:, :d] + place, np.tile(cov[:d, :d], (len(z), 1, 1)))

    return locate


@made_once
def reports(R: Noise, d: int = 2) -> Locate:
    """Reports of position and velocity, d components each and in this order, with independent errors R: AIS, ADS-B."""
    cov = covariance_of(R)

    def locate(z: np.ndarray, u: np.ndarray | None) -> Located:
        spread = np.tile(cov[:d, :d], (len(z), 1, 1))
        return Located(z[:, :d], spread, velocity=z[:, d : 2 * d], velocity_cov=cov[d : 2 * d, d : 2 * d])

    return locate


@made_once
def polar(R: Noise, *, origin: tuple[float, float] = (0.0, 0.0), from_inputs: bool = False) -> Locate:
    """Plots by range and azimuth, or range, azimuth and radial velocity, as `sensors.range_azimuth` gives them.

    Args:
        R: the sensor's noise.
        origin: where the sensor stands.
        from_inputs: the first two inputs of a scan say where it stands instead.
    """
    variances = np.diag(covariance_of(R))

    def locate(z: np.ndarray, u: np.ndarray | None) -> Located:
        place = np.asarray(u[:2] if from_inputs and u is not None else origin)
        away = np.stack([np.cos(z[:, 1]), np.sin(z[:, 1])], axis=1)
        across = np.stack([-away[:, 1], away[:, 0]], axis=1)
        cov = variances[0] * away[:, :, None] * away[:, None, :]
        cov = cov + (variances[1] * z[:, 0] ** 2)[:, None, None] * across[:, :, None] * across[:, None, :]
        radial = z[:, 2] if z.shape[1] > 2 else None
        return Located(place + z[:, :1] * away, cov, away, radial, float(variances[2]) if radial is not None else 0.0)

    return locate


def in_shadow(expected: np.ndarray, width: float, behind: float) -> np.ndarray:
    """Which targets (B,) another one hides from the platform.

    Args:
        expected: positions counted from the platform (B, 2), as `sensors.relative_position` gives them.
        width: m; half the width of the shadow of a target, where it stands.
        behind: m; how far behind it the shadow begins.
    """
    if len(expected) < 2:
        return np.zeros(len(expected), bool)
    distance = np.linalg.norm(expected, axis=1)
    along = expected / np.maximum(distance, 1e-9)[:, None]
    # Of target j as seen along the line to target i: how far along it, and how far beside it.
    forward = along @ expected.T
    beside = np.abs(along[:, :1] * expected[:, 1] - along[:, 1:] * expected[:, 0])
    return ((forward > 0) & (forward < distance[:, None] - behind) & (beside < width)).any(1)


def crowded(expected: np.ndarray, apart: float) -> np.ndarray:
    """Which targets (B,) stand nearer than `apart` (m) to another, so that a sensor may see one plot of both.

    Args:
        expected: positions (B, 2), in metres.
        apart: m; the distance at which the sensor tells two targets apart.
    """
    if len(expected) < 2:
        return np.zeros(len(expected), bool)
    distance, _ = cKDTree(expected).query(expected, k=[2])
    return np.asarray(distance).ravel() < apart
