"""The parameters of named filters, as people write them."""

import math
from typing import Any

from sigmax.errors import InputError


def fitted(filter: str, parameter: str, kind: Any, value: Any) -> Any:
    """A parameter, as a number or a truth value where it should be one.

    Raises:
        InputError: for anything else.
    """
    if value is None and kind == float | None:
        return None
    wanted = {bool: "True or False", int: "a whole number", float | None: "a finite number"}.get(kind)
    try:
        fits = wanted is None or (not isinstance(value, str) and math.isfinite(value))
        fits &= kind is not bool or value in (0, 1)
        fits &= kind is not int or value == int(value)
    except (TypeError, ValueError, OverflowError):
        fits = False
    if not fits:
        raise InputError(f"{parameter} of {filter} must be {wanted}; it is {value!r}")
    return value
