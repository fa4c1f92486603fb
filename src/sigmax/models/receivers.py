"""Sensors of radio receivers, and of vehicles that know their pose: ready-made, as those in `sensors`."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.arguments import place_of, places_of, point_of, positive
from sigmax.modelling.checks import numbers
from sigmax.modelling.components import angle
from sigmax.modelling.parts import Sensor, made_once
from sigmax.models.smooth import direction, length

# The speed of light, m/s, and the rate of the Earth, rad/s: IS-GPS-200.
_LIGHT, _EARTH_RATE = 299792458.0, 7.2921151467e-5


@made_once
def pseudorange(at: Sequence[int] = (0, 1, 2), clock: int = 3, system: int | None = None, earth: bool = True) -> Sensor:
    """Distance to a satellite plus the offset of the receiver's clock, m: |s − p| + b, plus d of another system.

    The satellite is the input: its position at transmission (3), m, and with `system` whether it is of the other
    system, 0 or 1, such as Galileo beside GPS. Clocks of satellites, ionosphere and troposphere are corrected before.
    Kaplan and Hegarty, Understanding GPS/GNSS (2017), (2.30); with the turn of the Earth during the flight of the
    signal, (ω/c) (s₁ p₂ − s₂ p₁), as in the RTKLIB manual 2.4.2, (E.3.8b).

    Args:
        at: where the position stands in the state, from the Earth's centre (ECEF) unless `earth` is false.
        clock: where the offset stands, in m.
        system: where the offset of the other system stands, in m, if there is one.
        earth: whether the axes turn with the Earth.
    """
    at, clock = places_of("at", at, (3,)), place_of("clock", clock)
    system = None if system is None else place_of("system", system)

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        seen = length(*(u[k] - x[i] for k, i in enumerate(at))) + x[clock]
        if earth:
            seen = seen + _EARTH_RATE / _LIGHT * (u[0] * x[at[1]] - u[1] * x[at[0]])
        return jnp.stack([seen if system is None else seen + u[3] * x[system]])

    inputs = ("satellite_x", "satellite_y", "satellite_z", *(() if system is None else ("other_system",)))
    return Sensor(function, ("pseudorange",), inputs)


@made_once
def pseudorange_rate(at: Sequence[int] = (0, 1, 2), velocity: Sequence[int] = (3, 4, 5), drift: int = 6) -> Sensor:
    """The rate of a pseudorange, m/s, from a Doppler shift: (s − p)ᵀ(ṡ − v) / |s − p| plus the drift of the clock.

    Position and velocity of the satellite are the inputs. Kaplan and Hegarty (2017), section 2.6.

    Args:
        at: where the position stands in the state.
        velocity: where the velocity stands.
        drift: where the drift of the receiver's clock stands, in m/s.
    """
    at, velocity, drift = places_of("at", at, (3,)), places_of("velocity", velocity, (3,)), place_of("drift", drift)

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        away = [u[k] - x[i] for k, i in enumerate(at)]
        reach = length(*away)
        closing = sum((d * (u[3 + k] - x[velocity[k]]) for k, d in enumerate(away)), start=jnp.zeros_like(reach))
        apart = reach > 0
        return jnp.stack([jnp.where(apart, closing / jnp.where(apart, reach, 1.0), 0.0) + x[drift]])

    axes = ("x", "y", "z")
    names = (*(f"satellite_{a}" for a in axes), *(f"satellite_v{a}" for a in axes))
    return Sensor(function, ("pseudorange_rate",), names)


@made_once
def time_difference(
    at: Sequence[int] = (0, 1),
    origin: Sequence[float] | None = None,
    reference: Sequence[float] | None = None,
    speed: float = _LIGHT,
) -> Sensor:
    """By how much later a signal of the target arrives at a station than at a reference, s: (|p − a| − |p − b|) / c.

    Without fixed places the two stations are the inputs. Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
    Tracking and Navigation (2001), section 3.7.

    Args:
        at: where the position stands in the state.
        origin: the station.
        reference: the other one.
        speed: of the signal, m/s: of light, or 343 for sound in air.

    Raises:
        InputError: where one station is fixed and the other is not, or the speed is not above 0.
    """
    if (origin is None) != (reference is None):
        raise InputError("a time difference has two stations: give origin and reference both, or none and take inputs")
    at, speed = places_of("at", at, (2, 3)), positive("speed, that of the signal in m/s,", speed)
    fixed = None
    if origin is not None:
        fixed = (*point_of("origin", origin, len(at)), *point_of("reference", reference, len(at)))

    def later(x: jax.Array, stations: Any) -> jax.Array:
        first, second = (length(*(x[i] - stations[s + k] for k, i in enumerate(at))) for s in (0, len(at)))
        return jnp.stack([(first - second) / speed])

    def from_fixed(x: jax.Array) -> jax.Array:
        return later(x, fixed)

    if fixed is not None:
        return Sensor(from_fixed, ("time_difference",))
    axes = "xyz"[: len(at)]
    return Sensor(later, ("time_difference",), (*(f"station_{a}" for a in axes), *(f"reference_{a}" for a in axes)))


@made_once
def azimuth_elevation(
    at: Sequence[int] = (0, 1, 2), origin: Sequence[float] = (0.0, 0.0, 0.0), axes: Any = None
) -> Sensor:
    """Azimuth and elevation of a target from a site, such as a camera or a telescope that follows a satellite.

    The azimuth runs from the first axis of the site towards its second, the elevation from both towards the third.

    Args:
        at: where the position stands in the state.
        origin: the site.
        axes: directions of the site's axes, rows (3, 3), in those of the state; without them they are the same.

    Raises:
        InputError: for axes that are not perpendicular, of length 1.
    """
    at, origin = places_of("at", at, (3,)), point_of("origin", origin, 3)
    turn = np.eye(3) if axes is None else np.asarray(numbers("axes", axes), float)
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
        raise InputError(f"axes are three perpendicular directions of length 1, rows (3, 3); they are {axes!r}")
    rows = tuple(map(tuple, turn.tolist()))

    def function(x: jax.Array) -> jax.Array:
        d = [x[i] - origin[k] for k, i in enumerate(at)]
        first, second, third = (sum((c * v for c, v in zip(row, d, strict=True)), start=0 * d[0]) for row in rows)
        return jnp.stack([direction(first, second), direction(length(first, second), third)])

    return Sensor(function, (angle("azimuth"), angle("elevation")))


@made_once
def range_bearing(at: Sequence[int] = (0, 1), heading: int = 2, landmark: Sequence[float] | None = None) -> Sensor:
    """What a vehicle sees of a landmark: its distance, and its direction from the vehicle's heading.

    Thrun, Burgard, Fox, Probabilistic Robotics (2005), (6.40).

    Args:
        at: where the position of the vehicle stands in the state.
        heading: where its heading stands.
        landmark: its place; None takes it from the inputs.
    """
    at, heading = places_of("at", at, (2,)), place_of("heading", heading)
    fixed = None if landmark is None else point_of("landmark", landmark, 2)

    def seen(x: jax.Array, place: Any) -> jax.Array:
        d = [place[k] - x[i] for k, i in enumerate(at)]
        return jnp.stack([length(*d), direction(d[0], d[1]) - x[heading]])

    def of_landmark(x: jax.Array) -> jax.Array:
        return seen(x, fixed)

    names = ("range", angle("bearing"))
    return Sensor(seen, names, ("beacon_x", "beacon_y")) if landmark is None else Sensor(of_landmark, names)


@made_once
def vehicle_range_bearing(at: Sequence[int] = (0, 1)) -> Sensor:
    """What a vehicle sees of a target: distance, and direction from the vehicle's heading; its pose is the input.

    Args:
        at: where the position of the target stands in the state.
    """
    at = places_of("at", at, (2,))

    def function(x: jax.Array, u: jax.Array) -> jax.Array:
        d = [x[i] - u[k] for k, i in enumerate(at)]
        return jnp.stack([length(*d), direction(d[0], d[1]) - u[2]])

    return Sensor(function, ("range", angle("bearing")), ("vehicle_x", "vehicle_y", "vehicle_heading"))
