"""Noises from their description: standard deviations by component, a covariance, or a function."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ValidationError

from sigmax.errors import InputError, unknown
from sigmax.files.description import Column
from sigmax.files.toml_errors import in_words
from sigmax.files.units import Dimension, is_below, quantity
from sigmax.files.userfile import Functions, is_reference
from sigmax.modelling.checks import is_traced, numbers
from sigmax.modelling.noise import squares


class Deviations(NamedTuple):
    """Standard deviations that a table has of each measurement.

    Attributes:
        columns: by component.
        variances: (m,) of all components, as far as they are the same in every row.
        at: where the components of the columns stand.
    """

    columns: Mapping[str, Column]
    variances: Any
    at: tuple[int, ...]

    def by_row(self, deviations: np.ndarray) -> np.ndarray:
        """Variances (B, m) of rows of deviations (B, k)."""
        found = np.tile(self.variances, (len(deviations), 1))
        found[:, self.at] = deviations**2
        return found

    @property
    def noise(self) -> Callable[..., Any]:
        """R(x, u), where the deviations are all inputs u (k,)."""
        if is_traced(self.variances):
            made: Callable[..., Any] = _of_inputs.__wrapped__(self.variances, self.at)
            return made
        return _of_inputs(tuple(self.variances.tolist()), self.at)


def read_noise_of_sensor(
    given: Any, wanted: dict[str, Dimension], where: str, functions: Functions
) -> tuple[Any, Deviations | None]:
    """The noise of a sensor, and what it takes from columns.

    Raises:
        InputError: as `read_noise`, and for what is no column.
    """
    table = given if isinstance(given, dict) else {}
    columns = {name: _column(v, f"{where}.{name}") for name, v in table.items() if isinstance(v, dict)}
    R = read_noise({**table, **dict.fromkeys(columns, 1.0)} if columns else given, wanted, where, functions)
    if not columns:
        return R, None
    found = Deviations(columns, R, tuple(list(wanted).index(name) for name in columns))
    return found.noise, found


def _column(given: dict[str, Any], where: str) -> Column:
    try:
        return Column.model_validate(given)
    except ValidationError as error:
        raise InputError(f"{where}: {in_words(error)}") from error


@lru_cache(maxsize=256)
def _of_inputs(variances: Any, at: tuple[int, ...]) -> Callable[..., Any]:
    def R(x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.asarray(variances, x.dtype).at[jnp.array(at)].set(u**2)

    return R


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
        if is_below(value, 0):
            raise InputError(f"{where}.{name}: a standard deviation must not be negative; it is {given[name]!r}")
    return squares(values)
