"""Sensors from their description."""

from typing import Any, NamedTuple

import numpy as np

from sigmax.descriptions.motion import components
from sigmax.descriptions.noise import Deviations, read_noise_of_sensor
from sigmax.descriptions.sensor_kinds import dimension_of_input, places_of, ready_made
from sigmax.errors import InputError, unknown
from sigmax.files.description import SensorPart
from sigmax.files.units import ANGLE, LENGTH, SPEED, TIME, Dimension, quantity
from sigmax.files.userfile import Functions, is_reference
from sigmax.filters import Update, named
from sigmax.models import Sensor


class Sensing(NamedTuple):
    """A sensor with what the edges know of it.

    Attributes:
        sensor: the sensor.
        R: its noise.
        dimensions: of what it measures, by component.
        inputs: dimensions of its inputs by name; None where anything goes.
        at: where the position it sees stands in the state.
        origin: where it stands itself, None where it moves or is not of this kind.
        kind: its kind.
        update: how it corrects; None where it follows the filter.
        deviations: what its noise takes from columns, as inputs.
        delay: seconds from a measurement to the time of its row.
    """

    sensor: Sensor
    R: Any
    dimensions: dict[str, Dimension]
    inputs: dict[str, Dimension] | None
    at: tuple[int, ...]
    origin: tuple[float, ...] | None
    kind: str
    update: Update | None = None
    deviations: Deviations | None = None
    delay: float = 0.0


_OPTIONS: dict[str, set[str]] = {
    "position": {"at"},
    "velocity": {"at"},
    "relative_position": {"at"},
    "range_only": {"at", "origin", "scale"},
    "bearing": {"at", "origin"},
    "camera_bearing": {"at"},
    "range_azimuth": {"at", "origin", "radial_velocity"},
    "pseudorange": {"at", "clock", "system", "earth"},
    "pseudorange_rate": {"at", "clock"},
    "time_difference": {"at", "origin", "reference", "speed"},
    "azimuth_elevation": {"at", "origin"},
    "range_bearing": {"at", "origin", "heading"},
    "vehicle_range_bearing": {"at"},
}
KINDS = tuple(_OPTIONS)
_ALL_OPTIONS = sorted({"measurement"}.union(*_OPTIONS.values()))
_MEASURED = {
    "range": LENGTH,
    "azimuth": ANGLE,
    "elevation": ANGLE,
    "bearing": ANGLE,
    "radial_velocity": SPEED,
    "pseudorange": LENGTH,
    "pseudorange_rate": SPEED,
    "time_difference": TIME,
}


def read_sensor(
    part: SensorPart, where: str, state: tuple[str, ...], position: tuple[str, ...], functions: Functions
) -> Sensing:
    """One sensor with its noise, for a state of these names.

    Raises:
        InputError: for names, options, units and functions that do not fit.
    """
    own = is_reference(part.kind)
    if not own and part.kind not in KINDS:
        raise InputError(f"{where}.kind: {unknown('sensor', part.kind, KINDS)}; your own is written file.py:function")
    for option in _ALL_OPTIONS:
        allowed = {"measurement"} if own else _OPTIONS[part.kind]
        if getattr(part, option) not in (None, False) and option not in allowed:
            raise InputError(f"{where}.{option}: {'your own sensor' if own else part.kind} takes no {option!r}")
    seen = [f"v{name}" for name in position] if part.kind == "velocity" else list(position)
    at = places_of(part.at or seen, state, f"{where}.at")
    origin = None
    if own:
        made, dimensions, inputs = _own(part, where, functions)
    else:
        if not at:
            raise InputError(f"{where} needs at = [names of the components that are the position]")
        if part.origin is not None:
            if len(part.origin) != len(at):
                raise InputError(f"{where}.origin has {len(part.origin)} coordinates, the position {len(at)}")
            origin = tuple(quantity(v, LENGTH, f"{where}.origin") for v in part.origin)
        elif part.kind in ("bearing", "range_azimuth", "azimuth_elevation") or (
            part.kind == "range_only" and not part.inputs
        ):
            origin = (0.0,) * len(at)
        made = ready_made(part, where, at, origin, state)
        plain = {"position": LENGTH, "relative_position": LENGTH, "velocity": SPEED}.get(part.kind)
        dimensions = {name: plain or _MEASURED[name] for name in made.measurement}
        inputs = {name: dimension_of_input(name) for name in made.inputs}
    R, deviations = read_noise_of_sensor(part.noise, dimensions, f"{where}.noise", functions)
    update = _update(part.update, f"{where}.update")
    delay = quantity(part.delay, TIME, f"{where}.delay")
    if delay < 0:
        raise InputError(f"{where}.delay must not be negative; it is {part.delay!r}")
    return Sensing(made, R, dimensions, inputs, at, origin, part.kind, update, deviations, delay)


def _update(given: str | None, where: str) -> Update | None:
    if given is None:
        return None
    try:
        update = named(given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    assert isinstance(update, Update)
    return update


def _own(part: SensorPart, where: str, functions: Functions) -> tuple[Sensor, dict[str, Dimension], None]:
    if not part.measurement:
        raise InputError(
            f'{where} needs measurement = {{ name = "unit", … }}, such as {{ depth = "m" }}, with your own sensor'
        )
    names, dimensions = components(part.measurement, f"{where}.measurement")
    made = Sensor(functions(part.kind, f"{where}.kind"), names, tuple(part.inputs))
    return made, dict(zip(names, dimensions, strict=True)), None


def first_position(
    sensing: Sensing, z: np.ndarray, beyond: Any = 0.0, deviations: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (B, k) and their covariances (B, k, k) from measurements (B, m) of a sensor.

    What else is not known of them beside their noise, (B, m, m), stands in `beyond`, and in `deviations` (B, j) what
    columns have of it.

    Raises:
        InputError: where the sensor does not tell a position.
    """
    k = len(sensing.at)
    R = sensing.R
    if sensing.deviations is not None and deviations is not None:
        R = sensing.deviations.by_row(deviations)[:, None] * np.eye(z.shape[1])
    if sensing.kind not in ("position", "range_azimuth") or callable(R):
        raise InputError(
            "a position comes from a sensor of the kind position or range_azimuth with a noise given in numbers"
        )
    R = (np.diag(R) if np.ndim(R) == 1 else np.asarray(R)) + beyond
    if sensing.kind == "position":
        return z, np.broadcast_to(R, (len(z), k, k))
    distance, azimuth = z[:, 0], z[:, 1]
    elevation = z[:, 2] if k == 3 else np.zeros(len(z))
    level = np.cos(elevation)
    along = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    across = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(len(z))], axis=1) * (distance * level)[:, None]
    up = np.stack([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), level], axis=1)
    # The columns of the Jacobian of the position by range, azimuth and elevation.
    J = np.stack([along, across, up * distance[:, None]], axis=2)[:, :k, :k]
    place = np.asarray(sensing.origin) + distance[:, None] * along[:, :k]
    return place, J @ R[..., :k, :k] @ J.swapaxes(1, 2)
