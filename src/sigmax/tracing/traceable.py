"""Functions as JAX can trace them, whichever library they are written with: found out once, judged by their numbers."""

import functools
import types
from collections import OrderedDict
from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr

from sigmax.errors import InputError
from sigmax.native.stable import is_stable
from sigmax.tracing.gather import gathered
from sigmax.tracing.judge import Point, difference, plainly, points
from sigmax.tracing.number import Untraceable
from sigmax.tracing.twin import Twins
from sigmax.tracing.values import array_of, wrapped

_MOST = 1024
_known: "OrderedDict[tuple[int, ...], Traceable]" = OrderedDict()
_lock = RLock()


class Traceable:
    """A user's function that JAX can trace: as it is where it is written with JAX, by way of `Values` where with NumPy.

    Called with known numbers it is the function itself.

    Attributes:
        function: the user's.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = self.__wrapped__ = function
        self.__name__ = str(getattr(function, "__name__", type(function).__name__))
        # "jax": written with it; "both": JAX traces it as it is; "numpy": by way of `Values`.
        self._way = ""

    def __call__(self, *arguments: Any) -> Any:
        """What the function gives."""
        if not any(isinstance(a, jax.Array) for a in arguments):
            return self.function(*arguments)
        if not self._way:
            self._way = self._decided(arguments)
        return with_numpy(self.function, *arguments) if self._way == "numpy" else self.function(*arguments)

    def __reduce__(self) -> Any:
        return traceable, (self.function,)

    def __repr__(self) -> str:
        return f"traceable({self.function!r})"

    @property
    def with_jax(self) -> bool:
        """Whether it was found to be written with JAX, so that there is nothing to compare."""
        return self._way == "jax"

    def _decided(self, arguments: Sequence[Any]) -> str:
        """Which way it is traced.

        Raises:
            Untraceable: where neither way gives what the function gives, in words.
        """
        specs = [jax.ShapeDtypeStruct(jnp.shape(a), jnp.result_type(a)) for a in arguments]
        at = points(specs)
        with_jax, failed = None, None
        try:
            with_jax = _traced(self.function, specs)
        except InputError:
            raise
        except Exception as error:
            failed = error
        if with_jax is not None:
            plain = _plainly(self.function, at)
            if plain is None or not difference(self.function, with_jax, at, plain):
                return "jax" if plain is None else "both"
        try:
            by_numpy = _traced(functools.partial(with_numpy, self.function), specs)
        except Exception as error:
            # The words about NumPy, or what JAX says of a function that is written with it.
            if failed is None or isinstance(error, Untraceable):
                raise
            raise failed from None
        _compare(self.function, by_numpy, at)
        return "numpy"


def check_alike(function: Callable[..., Any], at: Sequence[Point]) -> None:
    """Compare what is traced from a function with the function itself at some points.

    Raises:
        Untraceable: where they differ, in words.
    """
    _compare(function, _traced(function, at[0]), at)


def _traced(function: Callable[..., Any], specs: Sequence[Any]) -> ClosedJaxpr:
    # JAX remembers a function by what it is handed, and this one may read something else by now.
    return jax.make_jaxpr(lambda *arguments: _array(function(*arguments)))(*specs)


def _array(made: Any) -> Any:
    """What a function gives as an array; None where it is none, which is told where its place in a model is known."""
    try:
        return jnp.asarray(made)
    except (TypeError, ValueError) as error:
        if isinstance(error, jax.errors.JAXTypeError):
            raise
        return None


def _compare(function: Callable[..., Any], traced: ClosedJaxpr, at: Sequence[Point]) -> None:
    plain = _plainly(function, at)
    if plain is not None and (away := difference(function, traced, at, plain)):
        raise Untraceable(f"{away}; run it as it is by sigmax.models.opaque(…)")


def _plainly(function: Any, at: Any) -> Any:
    try:
        return plainly(function, at)
    except ValueError as error:
        raise Untraceable(str(error)) from error


def traceable(function: Any) -> Any:
    """A function that JAX can trace in the place of a user's: the same one for the same function.

    What is JAX's or this library's own stays as it is.

    Args:
        function: of arrays, written with NumPy, `math` or JAX.
    """
    if not callable(function) or isinstance(function, Traceable) or _is_traced_already(function):
        return function
    key: tuple[int, ...] = (id(function),)
    if type(function) is types.MethodType:
        # Another object whenever it is asked for.
        key = id(function.__self__), id(function.__func__)
    with _lock:
        found = _known.get(key)
        if found is None:
            found = _known[key] = Traceable(function)
            while len(_known) > _MOST:
                _known.popitem(last=False)
        _known.move_to_end(key)
        return found


def _is_traced_already(function: Any) -> bool:
    kind = type(function)
    if kind in (types.FunctionType, types.MethodType, functools.partial):
        return is_stable(function)
    return is_stable(kind)


def with_numpy(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function written with NumPy gives for arrays of JAX, as an array of JAX."""
    given = [wrapped(jnp.asarray(a)) for a in arguments]
    made = Twins().of(function)(*given)
    return made if made is None else _array(gathered(array_of(made)))
