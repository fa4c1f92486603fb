"""The built-in kinds of sensors, from their description."""

from sigmax.errors import InputError, unknown
from sigmax.files.description import SensorPart
from sigmax.files.units import ANGLE, LENGTH, NUMBER, SPEED, Dimension, quantity
from sigmax.models import Sensor, sensors

# Of how many components `at` is, 0 where that is free.
_COMPONENTS = {
    "pseudorange": 3,
    "pseudorange_rate": 3,
    "time_difference": 0,
    "azimuth_elevation": 3,
    "range_bearing": 2,
    "vehicle_range_bearing": 2,
}


def ready_made(
    part: SensorPart, where: str, at: tuple[int, ...], origin: tuple[float, ...] | None, state: tuple[str, ...]
) -> Sensor:
    """The sensor of a built-in kind, for a state of these names.

    Raises:
        InputError: for what it needs and the description or the state does not have.
    """
    if part.kind in ("position", "velocity"):
        return sensors.position(at, [state[i] for i in at])
    if part.kind == "relative_position":
        return sensors.relative_position(at, [state[i] for i in at])
    if part.kind == "range_only":
        scale = None if part.scale is None else places_of([part.scale], state, f"{where}.scale")[0]
        return sensors.range_only(at, origin, scale)
    if part.kind in ("bearing", "camera_bearing") and len(at) != 2:
        raise InputError(f"{where}.at must be two components; it is {[state[i] for i in at]}")
    if part.kind == "bearing":
        return sensors.bearing(at, origin or (0.0, 0.0))
    if part.kind == "camera_bearing":
        return sensors.camera_bearing(at)
    if part.kind in _COMPONENTS:
        return _other_kind(part, where, at, origin, state)
    if len(at) not in (2, 3):
        raise InputError(
            f"{where}.at must be two components, or three with an elevation; it is {[state[i] for i in at]}"
        )
    velocity = polar = None
    if part.radial_velocity:
        cartesian = [f"v{state[i]}" for i in at]
        if all(name in state for name in cartesian):
            velocity = [state.index(name) for name in cartesian]
        elif len(at) == 2 and "speed" in state and "course" in state:
            polar = [state.index("speed"), state.index("course")]
        else:
            raise InputError(f"{where}.radial_velocity needs speed and course, or {', '.join(cartesian)}, in the state")
    return sensors.range_azimuth(at, origin or (0.0,) * len(at), velocity, polar)


def _other_kind(
    part: SensorPart, where: str, at: tuple[int, ...], origin: tuple[float, ...] | None, state: tuple[str, ...]
) -> Sensor:
    wanted = _COMPONENTS[part.kind]
    if wanted and len(at) != wanted:
        raise InputError(f"{where}.at must be {wanted} components; it is {[state[i] for i in at]}")

    def component(name: str | None, option: str, usual: str) -> int:
        return places_of([name or usual], state, f"{where}.{option}")[0]

    if part.kind == "pseudorange":
        system = None if part.system is None else component(part.system, "system", "")
        return sensors.pseudorange(at, component(part.clock, "clock", "clock"), system, part.earth is not False)
    if part.kind == "pseudorange_rate":
        velocity = places_of([f"v{state[i]}" for i in at], state, f"{where}: the velocity")
        return sensors.pseudorange_rate(at, velocity, component(part.clock and f"v{part.clock}", "clock", "vclock"))
    if part.kind == "time_difference":
        other = part.reference
        if other is not None and len(other) != len(at):
            raise InputError(f"{where}.reference has {len(other)} coordinates, the position {len(at)}")
        place = None if other is None else tuple(quantity(v, LENGTH, f"{where}.reference") for v in other)
        more = () if part.speed is None else (quantity(part.speed, SPEED, f"{where}.speed"),)
        try:
            return sensors.time_difference(at, origin, place, *more)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
    if part.kind == "azimuth_elevation":
        return sensors.azimuth_elevation(at, origin or (0.0, 0.0, 0.0))
    if part.kind == "range_bearing":
        return sensors.range_bearing(at, component(part.heading, "heading", "heading"), origin)
    return sensors.vehicle_range_bearing(at)


def dimension_of_input(name: str) -> Dimension:
    """What an input of a built-in sensor is, by its name."""
    if name == "other_system":
        return NUMBER
    return ANGLE if "heading" in name else SPEED if "_v" in name else LENGTH


def places_of(names: list[str], state: tuple[str, ...], where: str) -> tuple[int, ...]:
    """Where components stand in the state.

    Raises:
        InputError: for a name that is none.
    """
    for name in names:
        if name not in state:
            raise InputError(f"{where}: {unknown('component', name, state)}")
    return tuple(state.index(name) for name in names)
