"""Which columns say how accurate the position of each row is, by their names."""

import re

import numpy as np

from sigmax.files.description import Column
from sigmax.files.table import Table
from sigmax.files.units import LENGTH, is_unit_of, to_si
from sigmax.proposals.roles import base_and_unit, has_numbers

_OF = r"(std|sigma|std_?dev|acc(uracy)?|err(or)?)"
_AXES = {
    "east": r"(e|east|x|lon(gitude)?)",
    "north": r"(n|north|y|lat(itude)?)",
    "x": r"(x|e|east)",
    "y": r"(y|n|north)",
}
_BOTH = r"((h|hor|horizontal|pos|position|gps|fix|location)_?)?(acc(uracy)?|std|sigma|std_?dev)|eph|hacc|epe"
# Beyond these it is no accuracy of a position in the unit that is thought.
_LEAST, _MOST = 1e-4, 1e5


def accuracies(
    table: Table, axes: tuple[str, str], place: np.ndarray, but: tuple[str | None, ...]
) -> tuple[tuple[Column, ...], str]:
    """A column for each axis, or one for both, positive wherever the place (T, 2) is known; or none, and why not."""
    names = [n for n in table.names if n not in but and has_numbers(table, n)]
    of_axes = [_first(names, rf"(.*_)?{_AXES[a]}_{_OF}|{_OF}_{_AXES[a]}") for a in axes]
    both = _first(names, _BOTH)
    found = [n for n in of_axes if n is not None] if None not in of_axes else [both] if both is not None else []
    if not found:
        return (), ""
    units = [unit if is_unit_of(unit := base_and_unit(name)[1], LENGTH) else "m" for name in found]
    known = ~np.isnan(place).any(1)
    shown = ", ".join(map(repr, found))
    for name, unit in zip(found, units, strict=True):
        values = table.numbers(name)[known] * to_si(unit, LENGTH, name)
        if not ((values > _LEAST) & (values < _MOST)).all():
            return (), f"{shown} may be the accuracy of positions, but is not positive in all rows: it is not used."
    one = "its" if len(found) == 1 else "their"
    remark = (
        f"{shown} in {units[0]} is taken for the standard deviation of each coordinate in {one} row; where it is the "
        "radius of a circle that holds so many per cent, scale it."
    )
    return tuple(Column(column=n, unit=u) for n, u in zip(found, units, strict=True)), remark


def _first(names: list[str], pattern: str) -> str | None:
    return next((n for n in names if re.fullmatch(pattern, base_and_unit(n)[0])), None)
