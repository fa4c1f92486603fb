"""Terrain-aided navigation: an elevation grid, the errors of an inertial system, a radio altimeter (Belov et al.)."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import numbers
from sigmax.modelling.noise import squares
from sigmax.modelling.parts import Motion, Sensor, made_once
from sigmax.tracing import traceable

METHODS = ("bilinear", "bicubic")


@dataclass(frozen=True, eq=False)
class Elevation:
    """Heights on a regular grid, looked up between its points.

    Attributes:
        heights: (rows, columns) in m, rows towards rising z (north), columns towards rising x (east).
        spacing: of the columns and of the rows, m.
        origin: x and z of the first column and row, m.
        method: "bilinear", continuous with slopes that jump at the grid's lines, or "bicubic", the cubic
            convolution of Keys (1981) with a = −1/2, with continuous slopes. Both go through the grid's heights.

    Raises:
        InputError: for a grid of fewer than 2 × 2 heights, a spacing that is not positive, another method.
    """

    heights: np.ndarray
    spacing: tuple[float, float]
    origin: tuple[float, float] = (0.0, 0.0)
    method: str = "bicubic"
    padded: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        heights = np.asarray(numbers("heights", self.heights), float)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InputError(f"heights must be a grid of at least 2 × 2 points; they have the shape {heights.shape}")
        if not (len(self.spacing) == 2 and min(self.spacing) > 0):
            raise InputError(f"spacing must be two positive numbers of metres, it is {self.spacing}")
        if self.method not in METHODS:
            raise unknown("way to look up heights", self.method, METHODS)
        # A border beyond the edges, so that the cubics of the outermost cells go straight on.
        padded = np.pad(heights, 1, mode="reflect", reflect_type="odd")
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "padded", padded if self.method == "bicubic" else heights)

    @property
    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The least and the largest x, the least and the largest z, m."""
        rows, columns = self.heights.shape
        (dx, dz), (x, z) = self.spacing, self.origin
        return (x, x + dx * (columns - 1)), (z, z + dz * (rows - 1))

    def __call__(self, x: Any, z: Any) -> jax.Array:
        """The height at a point, m; NaN beyond the edges and beside a height that is NaN.

        Derivatives are those of the interpolation itself; where it has a kink, those of the cell above.
        """
        rows, columns = self.heights.shape
        column, row = (x - self.origin[0]) / self.spacing[0], (z - self.origin[1]) / self.spacing[1]
        inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
        column, row = jnp.where(inside, column, 0.0), jnp.where(inside, row, 0.0)
        i = jnp.clip(jnp.floor(column), 0, columns - 2)
        j = jnp.clip(jnp.floor(row), 0, rows - 2)
        weights = _linear if self.method == "bilinear" else _cubic
        across, along = weights(column - i), weights(row - j)
        width = self.padded.shape[1]
        first = (j * width + i).astype(int)
        flat = jnp.asarray(self.padded.ravel())
        reach = range(len(across))
        value = sum(
            along[r] * sum(across[c] * flat.at[first + (r * width + c)].get(mode="promise_in_bounds") for c in reach)
            for r in reach
        )
        return jnp.where(inside, value, jnp.nan)


def _linear(s: Any) -> list[Any]:
    return [1 - s, s]


def _cubic(s: Any) -> list[Any]:
    """Weights of the four neighbours at −1, 0, 1, 2 (Keys 1981, (15) with a = −1/2)."""
    return [
        s * (s * (1 - 0.5 * s) - 0.5),
        1 + s * s * (1.5 * s - 2.5),
        s * (0.5 + s * (2 - 1.5 * s)),
        s * s * (0.5 * s - 0.5),
    ]


def hills(size: int = 48, spacing: float = 250.0, seed: int = 3) -> Elevation:
    """A made-up landscape of smooth hills, for trying and testing: no place on earth."""
    rng = np.random.default_rng(seed)
    at = np.arange(size) * spacing
    x, z = np.meshgrid(at, at)
    heights = np.full(x.shape, 400.0)
    for _ in range(24):
        length, turn, phase = rng.uniform(1200, 5000), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        wave = (x * np.cos(turn) + z * np.sin(turn)) * 2 * np.pi / length
        heights += length / 90 * np.sin(wave + phase)
    return Elevation(np.round(heights, 1), (spacing, spacing))


def _error_motion(x: jax.Array, dt: jax.Array) -> jax.Array:
    dh, dv, da, dvx, dvz, dx, dz = x
    return jnp.stack([dh + dv * dt + da * dt**2 / 2, dv + da * dt, da, dvx, dvz, dx + dvx * dt, dz + dvz * dt])


def _error_noise(height: float, vertical: float, acceleration: float, velocity: float, position: float) -> np.ndarray:
    """Variances per second from standard deviations per √s."""
    return squares([height, vertical, acceleration, velocity, velocity, position, position])


def inertial_errors() -> Motion:
    """What has to be added to the height, velocities and position of an inertial system (Belov et al., (10))."""
    units = ("m", "m/s", "m/s²", "m/s", "m/s", "m", "m")
    return Motion(_error_motion, ("dh", "dv", "da", "dvx", "dvz", "dx", "dz"), _error_noise, units=units)


@made_once
def radio_altimeter(ground: Any) -> Sensor:
    """Height above the ground, h + δh − ground(x + δx, z + δz) (Belov et al., (11)).

    Args:
        ground: (x, z) -> height, such as an `Elevation`, or an opaque function.

    The inputs are what the inertial system says: height, x and z. Beyond the map the height is NaN: the
    correction is a fault, and the state stays as it was predicted. Over flat ground the correction tells
    the height alone.
    """
    ground = traceable(ground)

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.stack([u[0] + x[0] - ground(u[1] + x[5], u[2] + x[6])])

    return Sensor(function, ("radio_height",), ("ins_height", "ins_x", "ins_z"))
