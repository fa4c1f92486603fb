"""Motions from their description."""

from typing import Any, NamedTuple

from sigmax.descriptions.noise import read_noise
from sigmax.errors import InputError, unknown
from sigmax.files.description import MotionPart
from sigmax.files.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    TURN_RATE,
    Dimension,
    is_below,
    parse_unit,
    quantity,
)
from sigmax.files.userfile import Functions, is_reference
from sigmax.modelling.components import angle
from sigmax.models import Motion, motions


class Moving(NamedTuple):
    """A motion with what the edges know of it.

    Attributes:
        motion: the motion.
        Q: its noise.
        dimensions: of its components.
        position: the names of the components that are its position.
        inputs: dimensions of the inputs by name; None where anything goes.
    """

    motion: Motion
    Q: Any
    dimensions: tuple[Dimension, ...]
    position: tuple[str, ...]
    inputs: dict[str, Dimension] | None


_DENSITY_OF_ACCELERATION = Dimension(2, -3)
_DENSITY_OF_JERK = Dimension(2, -5)
_LEVELS = (LENGTH, SPEED, ACCELERATION)

# The noise of each motion by the parameters of its function.
_NOISE: dict[str, dict[str, Dimension]] = {
    "constant_velocity": {"density": _DENSITY_OF_ACCELERATION},
    "constant_acceleration": {"density": _DENSITY_OF_JERK},
    "singer": {"acceleration": ACCELERATION},
    "coordinated_turn": {"position": LENGTH, "speed": SPEED, "course": ANGLE, "turn_rate": TURN_RATE},
    "coordinated_turn_cartesian": {"acceleration": _DENSITY_OF_ACCELERATION, "turn_rate": TURN_RATE},
    "unicycle": {"position": LENGTH, "heading": ANGLE},
}
_OPTIONS = {
    "constant_velocity": {"axes"},
    "constant_acceleration": {"axes"},
    "singer": {"axes", "tau"},
    "coordinated_turn_cartesian": {"axes"},
    "random_walk": {"state"},
}
KINDS = (*_NOISE, "random_walk")


def components(given: dict[str, str], where: str) -> tuple[tuple[str, ...], tuple[Dimension, ...]]:
    """Names, those in rad marked as angles, and dimensions from a table such as { x = "m", course = "rad" }.

    Raises:
        InputError: for a unit that is not SI.
    """
    names, dimensions = [], []
    for name, unit in given.items():
        factor, dimension = parse_unit(unit, f"{where}.{name}") if unit.strip() else (1.0, NUMBER)
        if factor != 1.0:
            raise InputError(
                f"{where}.{name}: inside everything is SI and radians; write {dimension.symbol!r} instead of {unit!r}"
            )
        names.append(angle(name) if dimension == ANGLE else name)
        dimensions.append(dimension)
    return tuple(names), tuple(dimensions)


def read_motion(part: MotionPart, where: str, functions: Functions) -> Moving:
    """One motion with its noise.

    Raises:
        InputError: for names, options, units and functions that do not fit.
    """
    if is_reference(part.kind):
        return _own(part, where, functions)
    if part.kind not in KINDS:
        raise InputError(f"{where}.kind: {unknown('motion', part.kind, KINDS)}; your own is written file.py:function")
    for option in ("axes", "tau", "state"):
        if getattr(part, option) is not None and option not in _OPTIONS.get(part.kind, ()):
            raise InputError(f"{where}.{option}: the motion {part.kind} takes no {option!r}")
    if part.kind == "random_walk":
        return _random_walk(part, where)
    options: dict[str, Any] = {}
    if part.axes is not None:
        options["axes"] = tuple(part.axes)
        if not part.axes or (part.kind == "coordinated_turn_cartesian" and len(part.axes) != 2):
            raise InputError(f"{where}.axes: {part.kind} cannot have the axes {part.axes}")
    if part.tau is not None:
        options["tau"] = quantity(part.tau, TIME, f"{where}.tau")
        if is_below(options["tau"], 0, or_at=True):
            raise InputError(f"{where}.tau must be above 0; it is {part.tau!r}")
    made: Motion = getattr(motions, part.kind)(**options)
    wanted = _NOISE[part.kind]
    if is_reference(part.noise):
        Q: Any = functions(part.noise, f"{where}.noise")
    elif isinstance(part.noise, list):
        Q = read_noise(part.noise, {}, f"{where}.noise", functions)
    else:
        Q = made.noise(**_parameters(part.noise, wanted, f"{where}.noise"))
    inputs = dict(zip(made.inputs, (SPEED, TURN_RATE), strict=True)) if made.inputs else {}
    return Moving(made, Q, _dimensions(part.kind, made), _position(part.kind, made), inputs)


def _parameters(given: Any, wanted: dict[str, Dimension], where: str) -> dict[str, float]:
    if not isinstance(given, dict):
        raise InputError(f"{where} must be a table with {', '.join(wanted)}; it is {given!r}")
    for name in given:
        if name not in wanted:
            raise InputError(f"{where}: {unknown('parameter', name, wanted)}")
    for name in wanted:
        if name not in given:
            raise InputError(f"{where} needs {name!r}, {wanted[name].what}")
    values = {name: quantity(given[name], dimension, f"{where}.{name}") for name, dimension in wanted.items()}
    for name, value in values.items():
        if is_below(value, 0):
            raise InputError(f"{where}.{name} must not be negative; it is {given[name]!r}")
    return values


def _dimensions(kind: str, made: Motion) -> tuple[Dimension, ...]:
    if kind == "coordinated_turn":
        return LENGTH, LENGTH, SPEED, ANGLE, TURN_RATE
    if kind == "coordinated_turn_cartesian":
        return LENGTH, LENGTH, SPEED, SPEED, TURN_RATE
    if kind == "unicycle":
        return LENGTH, LENGTH, ANGLE
    order = 2 if kind == "constant_velocity" else 3
    axes = len(made.state) // order
    return tuple(level for level in _LEVELS[:order] for _ in range(axes))


def _position(kind: str, made: Motion) -> tuple[str, ...]:
    orders = {"constant_velocity": 2, "constant_acceleration": 3, "singer": 3}
    return made.state[: len(made.state) // orders[kind]] if kind in orders else made.state[:2]


def _random_walk(part: MotionPart, where: str) -> Moving:
    if not part.state:
        raise InputError(f'{where} needs state = {{ name = "unit" }}, such as {{ range_scale = "1" }}')
    names, dimensions = components(part.state, f"{where}.state")
    made = motions.random_walk(names)
    Q = read_noise(part.noise, dict(zip(names, dimensions, strict=True)), f"{where}.noise", None)
    return Moving(made, Q, dimensions, (), {})


def _own(part: MotionPart, where: str, functions: Functions) -> Moving:
    if not part.state:
        raise InputError(
            f'{where} needs state = {{ name = "unit", … }}, such as {{ x = "m", course = "rad" }}, with your own motion'
        )
    for option in ("axes", "tau"):
        if getattr(part, option) is not None:
            raise InputError(f"{where}.{option}: your own motion takes no {option!r}")
    function = functions(part.kind, f"{where}.kind")
    names, dimensions = components(part.state, f"{where}.state")
    Q = read_noise(part.noise, dict(zip(names, dimensions, strict=True)), f"{where}.noise", functions)
    units = tuple(dimension.symbol for dimension in dimensions)
    made = Motion(function, names, lambda: Q, tuple(part.inputs), units)
    lengths = [name for name, dimension in zip(names, dimensions, strict=True) if dimension == LENGTH]
    return Moving(made, Q, dimensions, tuple(lengths[:3]), None)
