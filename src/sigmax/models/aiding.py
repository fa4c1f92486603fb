"""What keeps inertial navigation from running away: satellites, wheels, a compass, the vertical, lines of sight.

The state is that of `navigation.strapdown`: an extended pose and the biases of gyroscopes and accelerometers.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.arguments import number_of
from sigmax.modelling.checks import finite, members, numbers
from sigmax.modelling.components import direction
from sigmax.modelling.parts import Sensor, made_once
from sigmax.spaces import conjugate, cross, rotate
from sigmax.spaces.quaternions import squared

# m/s², where nothing else is said.
GRAVITY = 9.80665
BIASES = tuple(f"{of}_bias.{axis}" for of in ("gyro", "accelerometer") for axis in "xyz")
INPUTS = tuple(f"{of}_{axis}" for of in ("gyro", "accelerometer") for axis in "xyz")
ATTITUDE, VELOCITY, POSITION = slice(0, 4), slice(4, 7), slice(7, 10)
GYRO_BIAS, ACCELEROMETER_BIAS = slice(10, 13), slice(13, 16)


@made_once
def satellite_position(lever: Sequence[float] = (0.0, 0.0, 0.0)) -> Sensor:
    """The position (3,) of an antenna that sits at a lever arm, m, in the axes of the body."""
    arm = vector("lever", lever)

    def function(x: jax.Array) -> jax.Array:
        return x[POSITION] + rotate(x[ATTITUDE], arm)

    return Sensor(function, ("x", "y", "z"))


@made_once
def satellite_velocity(lever: Sequence[float] | None = None) -> Sensor:
    """The velocity (3,) of an antenna; with a lever arm the inputs are those of the motion, for its turn."""
    arm = vector("lever", (0.0, 0.0, 0.0) if lever is None else lever)

    def alone(x: jax.Array) -> jax.Array:
        return x[VELOCITY]

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        return x[VELOCITY] + rotate(x[ATTITUDE], cross(u[:3] - x[GYRO_BIAS], arm))

    names = ("vx", "vy", "vz")
    return Sensor(alone, names) if lever is None else Sensor(function, names, INPUTS)


@made_once
def body_velocity(axes: Sequence[int] = (0, 1, 2)) -> Sensor:
    """The velocity in axes of the body: a wheel (0,); a car that does not slide, whose measurement is 0 (1, 2)."""
    chosen = tuple(members(axes) or ())
    if not chosen or not all(isinstance(k, int | np.integer) and k in (0, 1, 2) for k in chosen):
        raise InputError(f"axes of the body are some of 0, 1 and 2; they are {axes!r}")

    def function(x: jax.Array) -> jax.Array:
        v = rotate(conjugate(x[ATTITUDE]), x[VELOCITY])
        return jnp.stack([v[k] for k in chosen])

    return Sensor(function, tuple(("forward", "sideways", "upward")[k] for k in chosen))


@made_once
def magnetometer(field: Sequence[float]) -> Sensor:
    """The Earth's magnetic field (3,) in the axes of the body, from that in the axes of the world, in any unit."""
    return _seen_from_the_body(vector("field", field), ("mx", "my", "mz"))


@made_once
def specific_force(gravity: float = GRAVITY) -> Sensor:
    """What accelerometers (3,) measure of a body that is not accelerated: its weight borne, upwards, and their bias.

    For accelerometers that are no inputs of the motion: as both they would be counted twice.
    """
    gravity = number_of("gravity", gravity)

    def function(x: jax.Array) -> jax.Array:
        return rotate(conjugate(x[ATTITUDE]), jnp.array([0.0, 0.0, gravity])) + x[ACCELEROMETER_BIAS]

    return Sensor(function, ("fx", "fy", "fz"))


@made_once
def height() -> Sensor:
    """The height (1,), of a barometer."""

    def function(x: jax.Array) -> jax.Array:
        return x[POSITION][2:]

    return Sensor(function, ("height",))


@made_once
def line_of_sight(star: Sequence[float] | None = None, landmark: Sequence[float] | None = None) -> Sensor:
    """The direction, in the axes of the body, of a star in a direction of the world, or of a landmark at a place.

    Raises:
        InputError: for both or neither.
    """
    if (star is None) == (landmark is None):
        raise InputError("a line of sight leads to a star (a direction) or to a landmark (a place): give one of them")
    to = vector("star" if landmark is None else "landmark", star if landmark is None else landmark)  # type: ignore[arg-type]
    if landmark is None and not to.any():
        raise InputError("the direction of a star is no zero")

    def function(x: jax.Array) -> jax.Array:
        away = to if landmark is None else to - x[POSITION]
        return rotate(conjugate(x[ATTITUDE]), away / jnp.sqrt(squared(away)))

    return Sensor(function, (direction("sight"),))


def _seen_from_the_body(vector: Any, names: tuple[str, ...]) -> Sensor:
    def function(x: jax.Array) -> jax.Array:
        return rotate(conjugate(x[ATTITUDE]), vector)

    return Sensor(function, names)


def vector(what: str, given: Sequence[float]) -> np.ndarray:
    """Three numbers (3,).

    Raises:
        InputError: for anything else.
    """
    found = np.asarray(numbers(what, given), float)
    finite(what, found)
    if np.shape(found) != (3,):
        raise InputError(f"{what} has three components; it is {given!r}")
    return found
