"""What ready-made motions and sensors are given: names, places in the state, points, densities."""

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, is_traced, members, numbers, strings


def names_of(what: str, given: Any, count: int | None = None) -> tuple[str, ...]:
    """Names of axes or components, each once.

    Raises:
        InputError: for what are no names, for a name that stands twice, and for another `count` of them.
    """
    found = strings(what, given)
    if not found or "" in found or len(set(found)) < len(found):
        raise InputError(f"{what} must be names, each of them once; they are {given!r}")
    if count is not None and len(found) != count:
        raise InputError(f"{what} must be {count} names; they are {given!r}")
    return found


def place_of(what: str, given: Any) -> int:
    """Where a component stands in the state, from 0.

    Raises:
        InputError: for what is no whole number, or a negative one.
    """
    try:
        found = -1 if isinstance(given, bool | np.bool_) else operator.index(given)
    except TypeError:
        found = -1
    if found < 0:
        raise InputError(f"{what} is the place of a component in the state, a whole number from 0; it is {given!r}")
    return found


def places_of(what: str, given: Any, counts: Sequence[int] = ()) -> tuple[int, ...]:
    """Where some components stand in the state, from 0, each once; as many as one of `counts`, if there are any.

    Raises:
        InputError: for anything else.
    """
    found = None if isinstance(given, str | bytes) else members(given)
    places = tuple(place_of(f"each of {what}", one) for one in found or ())
    if not places or len(set(places)) < len(places) or (counts and len(places) not in counts):
        wanted = " or ".join(map(str, counts)) or "some"
        raise InputError(f"{what} must be the places of {wanted} components in the state; it is {given!r}")
    return places


def point_of(what: str, given: Any, size: int) -> Any:
    """A point (size,): a tuple of numbers, or an array that is being traced.

    Raises:
        InputError: for anything else, or what is not finite.
    """
    found = numbers(what, given)
    finite(what, found)
    if np.shape(found) != (size,):
        raise InputError(f"{what} must have {size} coordinates; it is {given!r}")
    return found if is_traced(found) else tuple(found.tolist())


def number_of(what: str, given: Any) -> Any:
    """One finite number, or one that is being traced.

    Raises:
        InputError: for anything else.
    """
    found = numbers(what, given)
    finite(what, found)
    if np.shape(found) != ():
        raise InputError(f"{what} must be one number; it is {given!r}")
    return found if is_traced(found) else float(found)


def positive(what: str, given: Any) -> Any:
    """One number above 0, or one that is being traced.

    Raises:
        InputError: for anything else.
    """
    found = number_of(what, given)
    if not is_traced(found) and not found > 0:
        raise InputError(f"{what} must be above 0; it is {given!r}")
    return found


def not_negative(what: str, given: Any) -> Any:
    """Densities or deviations, none below 0: an array of any shape, or one that is being traced.

    Raises:
        InputError: for anything else.
    """
    found = numbers(what, given)
    finite(what, found)
    if not is_traced(found) and (found < 0).any():
        raise InputError(f"{what} must be at least 0; it is {given!r}")
    return found
