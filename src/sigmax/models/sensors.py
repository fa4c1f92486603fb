"""Ready-made sensors: a function and the names of what it measures.

Azimuths and bearings run from the first axis towards the second: clockwise from north for a state
that begins (north, east), counter-clockwise from x for one that begins (x, y).
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from sigmax.modelling.arguments import names_of, place_of, places_of, point_of
from sigmax.modelling.checks import members
from sigmax.modelling.components import angle
from sigmax.modelling.noise import sensor_of
from sigmax.modelling.parts import Sensor, made_once
from sigmax.models.quadratic import quadratic_function
from sigmax.models.receivers import (
    azimuth_elevation,
    pseudorange,
    pseudorange_rate,
    range_bearing,
    time_difference,
    vehicle_range_bearing,
)
from sigmax.models.smooth import direction, length

__all__ = [
    "azimuth_elevation",
    "bearing",
    "camera_bearing",
    "position",
    "pseudorange",
    "pseudorange_rate",
    "quadratic",
    "range_azimuth",
    "range_bearing",
    "range_only",
    "relative_position",
    "time_difference",
    "vehicle_range_bearing",
]


@made_once
def position(at: Sequence[int] = (0, 1), names: Sequence[str] = ("x", "y")) -> Sensor:
    """Some components of the state themselves."""
    at = places_of("at", at)
    measured = names_of("names", names, len(at))

    def function(x: jax.Array) -> jax.Array:
        return jnp.stack([x[i] for i in at])

    return Sensor(function, measured)


@made_once
def relative_position(at: Sequence[int] = (0, 1), names: Sequence[str] = ("x", "y")) -> Sensor:
    """Position seen from a platform that moves but keeps its axes; where the platform is are the inputs."""
    at = places_of("at", at)
    measured = names_of("names", names, len(at))

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.stack([x[i] - u[k] for k, i in enumerate(at)])

    return Sensor(function, measured, tuple(f"platform_{name}" for name in measured))


@made_once
def range_only(at: Sequence[int] = (0, 1), origin: Sequence[float] | None = None, scale: int | None = None) -> Sensor:
    """Distance to a fixed origin, or to a beacon whose position is the input u (k,).

    Args:
        at: where the position stands in the state.
        origin: the fixed point; None takes the point from the inputs.
        scale: where a scale factor of the range stands in the state, if there is one.
    """
    at = places_of("at", at, (1, 2, 3))
    fixed: Any = None if origin is None else point_of("origin", origin, len(at))
    scale = None if scale is None else place_of("scale", scale)

    def measured(x: jax.Array, point: Sequence[float] | jax.Array) -> jax.Array:
        distance = length(*(x[i] - point[k] for k, i in enumerate(at)))
        return jnp.stack([distance if scale is None else x[scale] * distance])

    if origin is not None:
        return Sensor(lambda x: measured(x, fixed), ("range",))
    return Sensor(measured, ("range",), tuple(f"beacon_{'xyz'[k]}" for k in range(len(at))))


@made_once
def bearing(at: Sequence[int] = (0, 1), origin: Sequence[float] = (0.0, 0.0)) -> Sensor:
    """Direction from a fixed origin."""
    at, origin = places_of("at", at, (2,)), point_of("origin", origin, 2)

    def function(x: jax.Array) -> jax.Array:
        return jnp.stack([direction(x[at[0]] - origin[0], x[at[1]] - origin[1])])

    return Sensor(function, (angle("bearing"),))


@made_once
def camera_bearing(at: Sequence[int] = (0, 1)) -> Sensor:
    """Direction relative to the axis of a camera whose position and heading are the inputs."""
    at = places_of("at", at, (2,))

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.stack([direction(x[at[0]] - u[0], x[at[1]] - u[1]) - u[2]])

    return Sensor(function, (angle("bearing"),), ("camera_x", "camera_y", "camera_heading"))


@made_once
def range_azimuth(
    at: Sequence[int] = (0, 1),
    origin: Sequence[float] = (0.0, 0.0),
    velocity: Sequence[int] | None = None,
    polar_velocity: Sequence[int] | None = None,
) -> Sensor:
    """Range and azimuth, and the radial velocity where the state's velocity is told.

    Args:
        at: where the position stands in the state: two components, or three for an elevation too.
        origin: position of the sensor.
        velocity: where the Cartesian velocity stands, as many components as `at`.
        polar_velocity: where speed and course stand (Sobolev, (89)); for two components only.
    """
    at = places_of("at", at, (2, 3))
    given = members(origin) if not isinstance(origin, str | bytes) else None
    place = point_of("origin", origin if given is None else [*given, *(0.0,) * (len(at) - len(given))], len(at))
    velocity = None if velocity is None else places_of("velocity", velocity, (len(at),))
    polar_velocity = None if polar_velocity is None else places_of("polar_velocity", polar_velocity, (2,))
    names: list[str] = ["range", angle("azimuth")]
    if len(at) == 3:
        names.append(angle("elevation"))
    if velocity is not None or polar_velocity is not None:
        names.append("radial_velocity")

    def function(x: jax.Array) -> jax.Array:
        d = [x[i] - place[k] for k, i in enumerate(at)]
        distance, azimuth = length(*d), direction(d[0], d[1])
        seen = [distance, azimuth]
        if len(at) == 3:
            seen.append(direction(length(d[0], d[1]), d[2]))
        if polar_velocity is not None:
            speed, course = (x[i] for i in polar_velocity)
            seen.append(speed * jnp.cos(course - azimuth))
        elif velocity is not None:
            away = distance > 0
            closing = sum((d[k] * x[i] for k, i in enumerate(velocity)), start=jnp.zeros_like(distance))
            seen.append(jnp.where(away, closing / jnp.where(away, distance, 1.0), 0.0))
        return jnp.stack(seen)

    return Sensor(function, tuple(names))


@made_once
def quadratic(H0: Any, H_x: Any, H_xx: Any, names: Sequence[str] | None = None, H_u: Any = None) -> Sensor:
    """H⁰ + Hˣ x + xᵀ Hˣˣ x + Hᵘ u, component by component (Stepanov et al., (1)), such as the square of a range.

    Args:
        H0: (m,).
        H_x: (m, n).
        H_xx: (m, n, n), a block for each component.
        names: of the components.
        H_u: (m, k), what known inputs u (k,) add; without it the sensor takes none.

    Raises:
        InputError: where the shapes do not fit.
    """
    function, m = quadratic_function("H", H0, H_x, H_xx, H_u)

    components = names_of("names", [f"z{i}" for i in range(m)] if names is None else names, m)
    return Sensor(sensor_of(function, H_u is not None), components)
