"""Units of the components of a model, for tables and pictures: filters compute with bare numbers."""

from collections.abc import Mapping, Sequence
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.modelling.components import Components, angle
from sigmax.spaces import Flat

Units = tuple[tuple[str, str], ...]


def units_of(
    given: Mapping[str, str] | None, ready_made: Mapping[str, str], own: Components, bias: Sequence[str]
) -> Units:
    """The unit of each number, deviation and component of the bias by its name, empty where nothing tells.

    Angles, and turns of curved parts, are in radians; what is given comes before what a ready-made motion says.

    Raises:
        InputError: for a unit that is no text, or of a component that there is not.
    """
    found = dict.fromkeys((*own.numbers, *own.deviations, *bias), "") | _angles(own)
    found |= {name: unit for name, unit in ready_made.items() if name in found}
    if given is not None and not isinstance(given, Mapping):
        raise InputError(f'units must be texts by name, such as {{"speed": "m/s"}}; it is {type(given).__name__}')
    for name, unit in (given or {}).items():
        if name not in found:
            raise unknown("component", name, found)
        if not isinstance(unit, str):
            raise InputError(f"the unit of {name!r} must be text such as 'm/s'; it is {unit!r}")
        found[name] = unit
    return tuple((str(name), unit) for name, unit in found.items())


def named(names: Sequence[str], units: Units = ()) -> str:
    """Names with their units, angles marked where no unit tells."""
    known = dict(units)
    said = [f"{n} [{u}]" if (u := known.get(n, "rad" if isinstance(n, angle) else "")) else str(n) for n in names]
    return f"({', '.join(said)})"


def _angles(own: Components) -> dict[str, Any]:
    """Radians, for what turns."""
    names: list[str] = []
    for space, at, to in own.space.parts():
        if isinstance(space, Flat):
            names += [n for n, turns in zip(own.numbers[at], space.periodic, strict=True) if turns]
        else:
            names += own.deviations[to][: space.turns]
    return dict.fromkeys(names, "rad")
