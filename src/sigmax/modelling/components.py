"""What a state or a measurement consists of: numbers, angles, and parts that live in curved spaces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sigmax.errors import InputError
from sigmax.modelling.checks import numbers, strings
from sigmax.spaces import Direction, Flat, Pose2, Pose3, Rotation, Space, product


class angle(str):
    """The name of a component that is an angle in radians: `state=("x", "y", angle("course"))`."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"angle({str(self)!r})"


class part(str):
    """The name of a part of a state or a measurement that is a point of a space: `part("attitude", Rotation())`.

    Its numbers are called `attitude.w`, …, its deviations `attitude.roll`, ….
    """

    space: Space

    def __new__(cls, name: str, space: Space) -> "part":
        """A name with the space that it stands for."""
        if not isinstance(space, Space):
            raise InputError(f"{name!r} needs a space such as sigmax.spaces.Rotation(); it is {type(space).__name__}")
        made = super().__new__(cls, name)
        made.space = space
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return part, (str(self), self.space)

    def __repr__(self) -> str:
        return f"part({str(self)!r}, {self.space})"


def rotation(name: str) -> part:
    """An attitude: a unit quaternion w, x, y, z from body to world; deviations are turns about the axes of the body."""
    return part(name, Rotation())


def direction(name: str) -> part:
    """A direction: a unit vector x, y, z, whose two deviations are arcs across it, in radians."""
    return part(name, Direction())


def pose2(name: str) -> part:
    """A pose in the plane: heading, x, y, whose deviations are a turn and a shift in the axes of the body (SE(2))."""
    return part(name, Pose2())


def pose3(name: str) -> part:
    """A pose in space: a unit quaternion and a position, deviations in the axes of the body (SE(3))."""
    return part(name, Pose3())


def extended_pose(name: str) -> part:
    """Attitude, velocity and position as one, deviations in the axes of the body (SE₂(3)): for inertial navigation."""
    return part(name, Pose3(velocity=True))


@dataclass(frozen=True)
class Components:
    """The components of a state or a measurement.

    Attributes:
        numbers: names of the numbers of a point, angles marked.
        deviations: names of the numbers of a difference, for which covariances are.
        space: where it lives.
    """

    numbers: tuple[str, ...]
    deviations: tuple[str, ...]
    space: Space


def components(what: str, given: Sequence[str] | None, noise_given: Any, label: str) -> Components:
    """Components by their names, or counted from the size of a noise.

    Raises:
        InputError: for what is no name, a name that comes twice, or nothing to count by.
    """
    names = strings(what, given) if given is not None else _counted(what, noise_given, label)
    if not names:
        raise InputError(f"{what} must be names of components such as ('x', 'v'); it is empty")
    points = tuple(n for name in names for n in _spelt(name, name.space.numbers if isinstance(name, part) else None))
    if len(set(names)) != len(names) or len(set(points)) != len(points):
        raise InputError(f"{what} names a component twice: {list(names)}")
    deviations = tuple(
        n for name in names for n in _spelt(name, name.space.deviations if isinstance(name, part) else None)
    )
    spaces = (name.space if isinstance(name, part) else Flat((isinstance(name, angle),)) for name in names)
    return Components(points, deviations, product(*spaces))


def measured_components(given: Sequence[str] | None, R: Any, label: str) -> Components | None:
    """The components of a measurement, or None where nothing tells how many there are."""
    if given is None and callable(R):
        return None
    return components("measurement", given, R, label)


def by_sensor(given: Any, sensor: str, several: bool, what: str) -> Any:
    """The part of a setting that belongs to one sensor."""
    if not several or given is None:
        if isinstance(given, Mapping):
            raise InputError(f"{what} is a dict, so sensor must be one too, with the same names")
        return given
    if not isinstance(given, Mapping):
        raise InputError(f"with several sensors {what} must be a dict by sensor name, it is {type(given).__name__}")
    if sensor not in given:
        if what == "measurement":
            return None
        raise InputError(f"{what} has no entry for the sensor {sensor!r}; it has {sorted(given)}")
    return given[sensor]


def _spelt(name: str, within: Sequence[str] | None) -> list[str]:
    """What the numbers of a part are called; by their place where they have no name of their own."""
    if within is None:
        return [name]
    return [f"{name}.{n if n and within.count(n) == 1 else i}" for i, n in enumerate(within)]


def _counted(what: str, noise_given: Any, label: str) -> tuple[str, ...]:
    if callable(noise_given):
        raise InputError(f"{what} must name the components: {label} is a function and does not tell how many")
    sizes = numbers(label, noise_given).shape
    if 0 in sizes:
        raise InputError(f"{label} is empty; give a covariance, or a variance for each component")
    return tuple(f"{what}{i}" for i in range(sizes[-1] if sizes else 1))
