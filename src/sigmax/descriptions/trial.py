"""A trial: a filter to run on a record, from the text that names it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from sigmax.errors import InputError
from sigmax.filters import BySensor, Filter, Update, get

# Parameters are squared, and more.
_MOST = 1e50


class Trial(NamedTuple):
    """A filter to run on a record, as in "SRUKF:alpha=0.45,beta=2" or "EKF:fixed=range_scale".

    Attributes:
        name: as it was written; the key in all outputs.
        filter: the filter.
        fixed: components of state or bias that are taken as known: their prior variance is 0.
    """

    name: str
    filter: Filter
    fixed: tuple[str, ...] = ()


def with_updates(filter: Filter, updates: Mapping[str, Update]) -> Filter:
    """A filter with the updates of a record's sensors, unless it has one of its own."""
    if filter.update is not None or not updates:
        return filter
    return replace(filter, update=BySensor(tuple(updates.items())))


def parse_trial(text: str) -> Trial:
    """A trial from "NAME" or "NAME:parameter=value,…", where `fixed=component` may stand among the parameters.

    That and `consider=component` may stand there more than once.

    Raises:
        InputError: for names that are not known, values that do not fit, and other syntax.
    """
    name, _, rest = text.strip().partition(":")
    parameters: dict[str, Any] = {}
    fixed, held = [], []
    for piece in filter(None, (piece.strip() for piece in rest.split(","))):
        key, equals, value = (part.strip() for part in piece.partition("="))
        if not equals or not key or not value:
            raise InputError(f"{text!r}: {piece!r} should be parameter=value, as in SRUKFB:alpha=0.45,beta=2,kappa=-2")
        if key == "fixed":
            fixed.append(value)
        elif key == "consider":
            held.append(value)
        elif key in parameters:
            raise InputError(f"{text!r} gives {key} twice")
        else:
            parameters[key] = _value(value)
            if isinstance(parameters[key], float) and not abs(parameters[key]) < _MOST:
                raise InputError(f"{text!r}: {key} is beyond all measure; it is {value}")
    try:
        made = get(name, consider=held, **parameters)
    except (TypeError, ValueError) as error:
        raise error if isinstance(error, InputError) else InputError(f"{text!r}: {error}") from error
    return Trial(text.strip(), made, tuple(fixed))


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
