"""A number that is not known yet: to NumPy a scalar, to JAX an element of an array that is traced."""

from collections.abc import Iterator
from typing import Any, NoReturn

import jax
import numpy as np

from sigmax.errors import InputError
from sigmax.native.refusal import line_here


class Untraceable(InputError):
    """A function of NumPy does what can only be done with known numbers."""


def refuse(does: str, remedy: str) -> NoReturn:
    """Say in words, with the line of the user's file, what cannot be traced."""
    where = line_here()
    raise Untraceable(
        f"it {does}{f' ({where})' if where else ''}: {remedy}; what cannot be written so runs as it is, slowly, by "
        "sigmax.models.opaque(…)"
    )


class Number(np.lib.mixins.NDArrayOperatorsMixin):
    """A number that is traced: an element of an array of JAX. To NumPy it is a scalar.

    Args:
        source: an array of JAX, (N,) or ().
        place: of the element; None for ().
    """

    __slots__ = ("_value", "place", "source")
    __array_priority__ = 1000.0
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, source: Any, place: int | None = None) -> None:
        self.source, self.place = source, place
        self._value: Any = None

    @property
    def value(self) -> Any:
        """The scalar of JAX."""
        if self.place is None:
            return self.source
        if self._value is None:
            piece = jax.lax.slice(self.source, (self.place,), (self.place + 1,))
            self._value = jax.lax.squeeze(piece, (0,))
        return self._value

    def __jax_array__(self) -> Any:
        return self.value

    @property
    def dtype(self) -> np.dtype[Any]:
        """Its type."""
        return np.dtype(self.source.dtype)

    @property
    def shape(self) -> tuple[int, ...]:
        """That of a scalar."""
        return ()

    @property
    def real(self) -> "Number":
        """Itself."""
        return self

    def item(self) -> "Number":
        """Itself."""
        return self

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        from sigmax.tracing import operations, values  # which know numbers

        if name in operations.OF_OBJECTS:
            return lambda *others: operations.ufunc(getattr(np, name), "__call__", (self, *others), {})
        return getattr(values.objects(self).view(values.Values), name)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        from sigmax.tracing import operations

        return operations.ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        from sigmax.tracing import operations

        return operations.function(function, args, options)

    def __bool__(self) -> bool:
        refuse(
            "decides by the value of a number that is not known while it is compiled",
            "write np.where(condition, a, b), np.minimum, np.maximum or np.clip in the place of if, and, or, while",
        )

    def __float__(self) -> float:
        refuse(
            "wants a number as float while it is compiled, or puts it into an array of plain floats",
            "leave out float(), and make arrays in the function itself, by np.zeros, np.eye or np.array",
        )

    def __complex__(self) -> complex:
        refuse("wants a complex number", "write it with real numbers")

    def __int__(self) -> int:
        refuse(
            "wants a whole number that is not known while it is compiled",
            "write np.floor or np.round in the place of int(), and np.interp for a table",
        )

    __index__ = __trunc__ = __int__

    def __round__(self, digits: int = 0) -> Any:
        return np.round(self, digits)

    def __floor__(self) -> Any:
        return np.floor(self)

    def __ceil__(self) -> Any:
        return np.ceil(self)

    def __iter__(self) -> Iterator[Any]:
        raise TypeError("a number has no elements")

    def __repr__(self) -> str:
        return f"Number({self.source.dtype})"


# A number never changes: x += 1 is another one.
for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul", "and", "or", "xor"):
    setattr(Number, f"__i{_name}__", getattr(np.lib.mixins.NDArrayOperatorsMixin, f"__{_name}__"))
