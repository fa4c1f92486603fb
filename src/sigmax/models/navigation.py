"""Inertial navigation: the strapdown motion, and what is measured of a vehicle beside it.

The state is attitude, velocity and position as one extended pose, and the biases of gyroscopes and accelerometers: 16
numbers, 15 deviations. The world is a local level frame whose third axis points up (east, north, up, or north, west,
up); the body has any right-handed axes. Attitudes turn vectors of the body into those of the world.
"""

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.arguments import names_of, number_of, place_of
from sigmax.modelling.components import extended_pose
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.noise import of_each
from sigmax.modelling.parts import Motion, made_once
from sigmax.models.aiding import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BIASES,
    GRAVITY,
    GYRO_BIAS,
    INPUTS,
    POSITION,
    VELOCITY,
    body_velocity,
    height,
    line_of_sight,
    magnetometer,
    satellite_position,
    satellite_velocity,
    specific_force,
    vector,
)
from sigmax.spaces import conjugate, cross, exponential, from_roll_pitch_yaw, multiply, rotate
from sigmax.spaces.quaternions import squared, stumpff

__all__ = [
    "body_velocity",
    "gravity",
    "height",
    "line_of_sight",
    "magnetometer",
    "prior",
    "satellite_position",
    "satellite_velocity",
    "specific_force",
    "strapdown",
]

# The Earth's turn in rad/s, and the constants of gravity on the ellipsoid (NIMA TR8350.2, WGS 84).
_EARTH_RATE = 7.292115e-5
_EQUATOR, _SOMIGLIANA, _ECCENTRICITY2 = 9.7803253359, 1.931852652458e-3, 6.69437999014e-3
_AXIS, _FLATTENING, _CENTRIFUGAL = 6378137.0, 1 / 298.257223563, 3.449786506841e-3


def gravity(latitude: float, height: float = 0.0) -> float:
    """Gravity in m/s² at a latitude (radians) and a height (m) above the ellipsoid (NIMA TR8350.2, (4-1), (4-3)).

    Raises:
        InputError: for a latitude beyond a quarter turn, such as one in degrees.
    """
    latitude, height = number_of("latitude", latitude), number_of("height", height)
    if not abs(latitude) <= math.pi / 2:
        raise InputError(f"a latitude is in radians, between -π/2 and π/2; it is {latitude!r}: use numpy.radians")
    s = math.sin(latitude) ** 2
    normal = _EQUATOR * (1 + _SOMIGLIANA * s) / math.sqrt(1 - _ECCENTRICITY2 * s)
    first = 2 / _AXIS * (1 + _FLATTENING + _CENTRIFUGAL - 2 * _FLATTENING * s)
    return normal * (1 - first * height + 3 * height**2 / _AXIS**2)


@made_once
def strapdown(name: str = "craft", latitude: float | None = None, height: float = 0.0, north: int = 1) -> Motion:
    """Attitude, velocity and position driven by gyroscopes and accelerometers, with a bias of each: 15 deviations.

    The inputs u (6,) are rates of turn in rad/s and specific forces in m/s², in the axes of the body, held over dt; the
    integral over such a step is exact. `noise` wants the densities of the sensors and of the walks of their biases.

    Args:
        name: of the extended pose; its numbers are `craft.qw` and so on.
        latitude: radians; with it gravity is that of WGS 84 at this height and the Earth turns. Without it gravity is
            9.80665 m/s² and the Earth stands still.
        height: m above the ellipsoid.
        north: which horizontal axis of the world points north, 0 or 1; only the Earth's turn asks.

    Raises:
        InputError: for an axis that is not horizontal.
    """
    (name,) = names_of("name", name, 1)
    if place_of("north", north) > 1:
        raise InputError(f"north is the horizontal axis 0 or 1 of the world; it is {north!r}")
    pull = jnp.array([0.0, 0.0, -(GRAVITY if latitude is None else gravity(latitude, height))])
    level = 0.0 if latitude is None else _EARTH_RATE * math.cos(latitude)
    up = 0.0 if latitude is None else _EARTH_RATE * math.sin(latitude)
    earth = jnp.array([level if north == 0 else 0.0, level if north == 1 else 0.0, up])

    def function(x: jax.Array, dt: jax.Array, u: jax.Array) -> jax.Array:
        q, v, p = x[ATTITUDE], x[VELOCITY], x[POSITION]
        rate, force = u[:3] - x[GYRO_BIAS], u[3:] - x[ACCELEROMETER_BIAS]
        if latitude is not None:
            rate = rate - rotate(conjugate(q), earth)
        turn = rate * dt
        c = stumpff(squared(turn))
        once = cross(turn, force)
        twice = cross(turn, once)
        # What the body's turn makes of the force over the step: its integral, and the integral of that.
        first = force + c[2] * once + c[3] * twice
        second = 0.5 * force + c[3] * once + c[4] * twice
        pulled = pull if latitude is None else pull - 2 * cross(earth, v)
        return jnp.concatenate(
            [
                multiply(q, exponential(turn)),
                v + dt * (rotate(q, first) + pulled),
                p + dt * v + dt**2 * (rotate(q, second) + 0.5 * pulled),
                x[10:],
            ]
        )

    def noise(
        gyro: float | Sequence[float],
        accelerometer: float | Sequence[float],
        gyro_bias: float | Sequence[float] = 0.0,
        accelerometer_bias: float | Sequence[float] = 0.0,
        position: float | Sequence[float] = 0.0,
    ) -> Callable[[jax.Array], jax.Array]:
        """Q(dt) from densities, one an axis or one for all.

        Args:
            gyro: rad/√s, the random walk of the angle, rad/s/√Hz.
            accelerometer: m/s/√s, that of the velocity.
            gyro_bias: rad/s/√s, by which the bias of the gyroscopes walks.
            accelerometer_bias: m/s²/√s.
            position: m/√s, for what a straight line over dt leaves out.
        """
        given = (gyro, accelerometer, gyro_bias, accelerometer_bias, position)
        of_turn, of_speed, of_gyro, of_force, of_place = (
            jnp.diag(of_each("a density", value, 3) ** 2) for value in given
        )

        def Q(dt: jax.Array) -> jax.Array:
            none = jnp.zeros((3, 3))
            return jnp.block(
                [
                    [dt * of_turn, none, none, none, none],
                    [none, dt * of_speed, dt**2 / 2 * of_speed, none, none],
                    [none, dt**2 / 2 * of_speed, dt**3 / 3 * of_speed + dt * of_place, none, none],
                    [none, none, none, dt * of_gyro, none],
                    [none, none, none, none, dt * of_force],
                ]
            )

        return Q

    return Motion(function, (extended_pose(name), *BIASES), noise, INPUTS)


def prior(
    attitude: Sequence[float],
    velocity: Sequence[float],
    position: Sequence[float],
    *,
    attitude_std: float | Sequence[float],
    velocity_std: float | Sequence[float],
    position_std: float | Sequence[float],
    gyro_bias_std: float | Sequence[float],
    accelerometer_bias_std: float | Sequence[float],
) -> Gaussian:
    """A prior of `strapdown`, from deviations in the axes of the world.

    Args:
        attitude: roll, pitch, yaw, radians.
        velocity: m/s.
        position: m.
        attitude_std: radians, about the axes of the world, one an axis or one for all: the third is the heading.
        velocity_std: m/s.
        position_std: m.
        gyro_bias_std: rad/s, about 0.
        accelerometer_bias_std: m/s², about 0.
    """
    q = from_roll_pitch_yaw(*vector("attitude", attitude).tolist())
    back = np.stack([np.asarray(rotate(conjugate(q), e)) for e in np.eye(3)], axis=1)
    cov = np.zeros((15, 15))
    for k, std in enumerate((attitude_std, velocity_std, position_std, gyro_bias_std, accelerometer_bias_std)):
        at = slice(3 * k, 3 * k + 3)
        own = np.diag(of_each("a deviation", std, 3) ** 2)
        cov[at, at] = back @ own @ back.T if k < 3 else own
    mean = np.concatenate([q, vector("velocity", velocity), vector("position", position), np.zeros(6)])
    return Gaussian(mean, cov)
