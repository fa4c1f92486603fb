"""NumPy, `math` and the builtins as a function sees them while it is traced: nothing of the real modules is changed."""

import builtins
import functools
import math
import types
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg
import jax.scipy.special
import numpy as np

from sigmax.tracing import operations
from sigmax.tracing.gather import gathered
from sigmax.tracing.number import Number
from sigmax.tracing.values import Values, array_of, is_traced, objects, wrapped

# Names that `math` has for what NumPy calls otherwise; the others are the same, or JAX's.
_OF_MATH: dict[str, Any] = {"acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2}
_OF_MATH |= {"acosh": np.arccosh, "asinh": np.arcsinh, "atanh": np.arctanh, "pow": np.power, "fsum": np.sum}
_SPECIAL = {"erf": jax.scipy.special.erf, "erfc": jax.scipy.special.erfc, "lgamma": jax.scipy.special.gammaln}
_SPECIAL |= {"gamma": jax.scipy.special.gamma}
_NUMPYS = ("numpy", "numpy.linalg", "numpy.fft", "numpy.lib", "numpy.lib.scimath")


class Namespace(types.ModuleType):
    """A module whose functions take traced numbers."""

    def __init__(self, real: types.ModuleType, find: Callable[[Any], Any]) -> None:
        super().__init__(real.__name__)
        self._real, self._find = real, find

    def __getattr__(self, name: str) -> Any:
        found = self._find(getattr(self._real, name))
        self.__dict__[name] = found
        return found


class _Joined:
    """`np.r_` and `np.c_`, which are indexed."""

    def __init__(self, real: Any) -> None:
        self._real = real

    def __getitem__(self, parts: Any) -> Any:
        given = tuple(map(objects, parts)) if isinstance(parts, tuple) else objects(parts)
        return wrapped(self._real[given])


def of_numpy(thing: Any) -> Any:
    """What stands for a thing of NumPy: a namespace for a module, a function that takes traced numbers."""
    if isinstance(thing, types.ModuleType):
        return NUMPY if thing is np else Namespace(thing, of_numpy) if thing.__name__ in _NUMPYS else thing
    if thing is np.r_ or thing is np.c_:
        return _Joined(thing)
    return _stand_in(thing) if callable(thing) and not isinstance(thing, type) else thing


@functools.cache
def _stand_in(thing: Any) -> Any:
    """One for each function, so that it is itself wherever it is found."""
    made = _MAKERS.get(getattr(thing, "__name__", ""))
    if made is not None and getattr(np, thing.__name__, None) is thing:
        return functools.partial(made, thing)
    return _Function(thing)


def of_math(thing: Any) -> Any:
    """What stands for a thing of `math`."""
    if isinstance(thing, types.ModuleType):
        return MATH
    return _stand_in_of_math(thing) if callable(thing) else thing


@functools.cache
def _stand_in_of_math(thing: Any) -> Any:
    return functools.partial(_by_math, thing)


def of_scipy(thing: Any) -> Any:
    """What stands for a thing of `scipy.linalg`: JAX's function of the same name, where there is one."""
    if isinstance(thing, types.ModuleType):
        return Namespace(thing, of_scipy)
    name = getattr(thing, "__name__", "")
    if name in ("inv", "solve", "det"):
        return of_numpy(getattr(np.linalg, name))
    found = getattr(jax.scipy.linalg, name, None)
    return thing if found is None or isinstance(thing, type) else of_jax(found)


def of_jax(thing: Any) -> Any:
    """What stands for a thing of `jax.numpy`, where a function uses both."""
    if isinstance(thing, types.ModuleType):
        return Namespace(thing, of_jax)
    if isinstance(thing, type) or not callable(thing):
        return thing
    return lambda *args, **options: wrapped(thing(*_for_jax(args), **{k: _for_jax(v) for k, v in options.items()}))


def _for_jax(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(map(_for_jax, value))
    return gathered(value)


class _Function:
    """A function of NumPy that takes traced numbers; of a ufunc its methods do, too."""

    def __init__(self, real: Any) -> None:
        self._real, self.__name__ = real, real.__name__

    def __call__(self, *args: Any, **options: Any) -> Any:
        return operations.function(self._real, args, options)

    def __getattr__(self, name: str) -> Any:
        if name in ("reduce", "accumulate", "outer"):
            return lambda *args, **options: operations.ufunc(self._real, name, args, options)
        return getattr(self._real, name)


def _by_math(real: Any, *args: Any) -> Any:
    if not is_traced(args):
        return real(*args)
    name = real.__name__
    if name in _SPECIAL:
        return wrapped(_SPECIAL[name](*map(gathered, args)))
    if name == "log" and len(args) == 2:
        return np.log(args[0]) / np.log(args[1])
    if name in ("hypot", "dist"):
        apart = args if name == "hypot" else np.subtract(*map(array_of, args))
        return functools.reduce(np.hypot, apart)
    if name == "remainder":
        return args[0] - args[1] * np.rint(args[0] / args[1])
    found = _OF_MATH.get(name) or getattr(np, name)
    return operations.function(found, args, {})


def _array(real: Any, value: Any, dtype: Any = None, **options: Any) -> Any:
    """`np.array` and its like; what is an array already stays it, but for `np.array` itself."""
    if isinstance(value, Values) and real is not np.array and dtype is None:
        return value
    known = {k: v for k, v in options.items() if k in ("ndmin", "copy") and v is not None}
    if dtype is object or dtype is complex:
        return real(value, dtype=dtype)
    return array_of(value, dtype=dtype, **known)


def _filled(real: Any, *args: Any, **options: Any) -> Any:
    """`np.zeros` and its like: arrays of floats that may hold traced numbers later."""
    made = real(*map(_plain, args), **options)
    if real in (np.empty, np.empty_like) and made.dtype.kind == "f":
        made = np.full(made.shape, np.nan)
    return wrapped(made)


def _plain(like: Any) -> Any:
    """An array of the same shape with known numbers, of which only the shape counts."""
    return np.zeros(np.shape(objects(like))) if is_traced(like) else gathered(like)


def _full(real: Any, shape: Any, value: Any, *rest: Any, **options: Any) -> Any:
    if not is_traced(value):
        return wrapped(real(_plain(shape) if real is np.full_like else shape, gathered(value), *rest, **options))
    made = wrapped(np.zeros(np.shape(objects(shape)) if real is np.full_like else shape))
    made[...] = value
    return made


def _is_scalar(real: Any, value: Any) -> bool:
    return isinstance(value, Number) or bool(real(value))


_MAKERS: dict[str, Callable[..., Any]] = dict.fromkeys(
    ("array", "asarray", "asanyarray", "ascontiguousarray", "asfortranarray", "asarray_chkfinite"), _array
)
_MAKERS |= dict.fromkeys(
    ("zeros", "ones", "empty", "eye", "identity", "zeros_like", "ones_like", "empty_like"), _filled
)
_MAKERS |= {"full": _full, "full_like": _full, "isscalar": _is_scalar}
NUMPY, MATH = Namespace(np, of_numpy), Namespace(math, of_math)


def stands_for(thing: Any) -> Any:
    """What a function sees in the place of something of NumPy, `math` or `jax.numpy`, NotImplemented for others."""
    if isinstance(thing, types.ModuleType):
        name = thing.__name__
        of = of_numpy if name in _NUMPYS else of_math if thing is math else of_jax if thing is jnp else None
        of = of_scipy if name == "scipy.linalg" else of
        return NotImplemented if of is None else of(thing)
    module = getattr(thing, "__module__", None)
    if isinstance(module, str) and module.startswith("scipy.linalg"):
        return of_scipy(thing)
    if isinstance(thing, np.ufunc) or (module in _NUMPYS and callable(thing)) or thing is np.r_ or thing is np.c_:
        return of_numpy(thing)
    if module == "math" and callable(thing):
        return of_math(thing)
    return NotImplemented


class _OfFloat(type):
    def __instancecheck__(cls, thing: Any) -> bool:
        return isinstance(thing, builtins.float | Number)


class _Float(metaclass=_OfFloat):
    """`float`, which a traced number is already."""

    def __new__(cls, value: Any = 0.0) -> Any:
        if isinstance(value, np.ndarray) and is_traced(value) and value.size == 1:
            value = value.reshape(-1)[0]
        return value if isinstance(value, Number) else builtins.float(value)


def _largest(real: Any, choose: Any, *args: Any, **options: Any) -> Any:
    if not is_traced(list(args[0]) if len(args) == 1 else args) or options:
        return real(*args, **options)
    return functools.reduce(choose, args[0] if len(args) == 1 else args)


# As Python's own: of equal ones, and where one is NaN, the first.
_MAX = functools.partial(_largest, max, lambda a, b: NUMPY.where(b > a, b, a))
_MIN = functools.partial(_largest, min, lambda a, b: NUMPY.where(b < a, b, a))


def own_builtins(find: Callable[[Any], Any]) -> dict[str, Any]:
    """The builtins, with `float`, `max` and `min` of traced numbers and imports that find these namespaces.

    Args:
        find: what stands for a module.
    """

    def imported(*args: Any, **options: Any) -> Any:
        return find(builtins.__import__(*args, **options))

    return {**vars(builtins), "__import__": imported, "float": _Float, "max": _MAX, "min": _MIN}
