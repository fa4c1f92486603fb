"""Noises from their description: standard deviations by component, a covariance, or a function."""

from typing import Any

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.models.checks import numbers
from sigmax.records.units import Dimension, quantity
from sigmax.records.userfile import Functions, is_reference


def read_noise(given: Any, wanted: dict[str, Dimension], where: str, functions: Functions | None) -> Any:
    """Variances (n,) from a table of standard deviations, a covariance from rows, or a function.

    Raises:
        InputError: where a component is missing or not known, or a number or unit does not fit.
    """
    if is_reference(given) and functions is not None:
        return functions(given, where)
    if isinstance(given, list):
        matrix = numbers(where, given)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise InputError(
                f"{where}: a covariance is a list of rows, all as long as there are rows; this has {matrix.shape}"
            )
        return matrix
    if not isinstance(given, dict):
        raise InputError(
            f"{where} must be a table of standard deviations such as {{ {next(iter(wanted), 'x')} = 0.5 }}, "
            f"a covariance, or file.py:function; it is {given!r}"
        )
    for name in given:
        if name not in wanted:
            raise InputError(f"{where}: {unknown('component', name, wanted)}")
    for name, dimension in wanted.items():
        if name not in given:
            raise InputError(f"{where} needs {str(name)!r}, {dimension.what}")
    values = [quantity(given[name], dimension, f"{where}.{name}") for name, dimension in wanted.items()]
    for name, value in zip(wanted, values, strict=True):
        if value < 0:
            raise InputError(f"{where}.{name}: a standard deviation must not be negative; it is {given[name]!r}")
    return np.square(values)
