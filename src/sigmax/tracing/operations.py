"""What computes: functions of NumPy on arrays that are traced, by JAX's functions of the same name."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special
import numpy as np

from sigmax.tracing import elimination, gather, number, values

_MOVING = """
append array_split atleast_1d atleast_2d atleast_3d block broadcast_arrays broadcast_to column_stack concatenate copy
delete diag diagflat diagonal dsplit dstack expand_dims flip fliplr flipud hsplit hstack insert matrix_transpose
meshgrid moveaxis ndim pad permute_dims ravel repeat reshape resize roll rollaxis rot90 row_stack shape size split
squeeze stack swapaxes take tile transpose tril triu unstack vsplit vstack
"""
_METHODS = """
sin cos tan arcsin arccos arctan sinh cosh tanh arcsinh arccosh arctanh exp exp2 expm1 log log2 log10 log1p sqrt cbrt
square fabs sign floor ceil rint trunc deg2rad rad2deg degrees radians reciprocal arctan2 hypot fmod logical_and
logical_or logical_not isnan isfinite isinf copysign
"""
# What only moves elements about, or asks for shapes: done by NumPy itself, on objects.
_MOVES = frozenset(_MOVING.split())
# Of those, what is given several arrays.
_OF_SEVERAL = ("block", "column_stack", "concatenate", "dstack", "hstack", "row_stack", "stack", "vstack")
# Methods that NumPy looks for in objects.
OF_OBJECTS = frozenset(_METHODS.split())
_RENAMED = {"amax": "max", "amin": "min", "around": "round", "trapz": "trapezoid", "product": "prod", "fix": "trunc"}
_OWN: dict[Any, Callable[..., Any]] = {
    np.linalg.solve: elimination.solve,
    np.linalg.inv: elimination.inv,
    np.linalg.det: elimination.det,
}
_CLIP = {"a_min": "min", "a_max": "max"}


def ufunc(operation: np.ufunc, method: str, inputs: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """What `__array_ufunc__` gives."""
    out, where = options.pop("out", None), options.pop("where", True)
    options = {k: v for k, v in options.items() if k not in ("casting", "order", "subok")}
    made = _computed(operation, method, [_given(i) for i in inputs], options)
    if where is not True:
        before = _given(out[0]) if out else 0.0
        made = jnp.where(_given(where), made, before)
    return _put(values.wrapped(made), out)


def _put(made: Any, out: Any) -> Any:
    """Results, where they are wanted in arrays that are there already."""
    if not out or out[0] is None:
        return made
    for target, one in zip(out, made if isinstance(made, tuple) else (made,), strict=True):
        if not isinstance(target, values.Values):
            if values.is_traced(one):
                number.refuse(
                    "puts a number that is not known while it is compiled into an array of plain floats",
                    "make the array in the function itself, by np.zeros, np.eye or np.array",
                )
            np.copyto(target, gather.gathered(one), casting="unsafe")
        else:
            target[...] = one
    return out[0] if len(out) == 1 else out


def _computed(operation: np.ufunc, method: str, inputs: list[Any], options: dict[str, Any]) -> Any:
    if not any(isinstance(i, jax.Array) for i in inputs):
        call = operation if method == "__call__" else getattr(operation, method)
        return call(*inputs, **options)
    name = operation.__name__
    if method == "__call__":
        kind = options.pop("dtype", None)
        made = _counterpart(operation)(*inputs, **options)
        return made if kind is None else made.astype(kind)
    if method == "outer":
        a, b = map(jnp.asarray, inputs)
        return _counterpart(operation)(a.reshape(a.shape + (1,) * b.ndim), b)
    if method in ("reduce", "accumulate"):
        whole = {"add": "sum", "multiply": "prod", "maximum": "max", "minimum": "min"}
        whole |= {"logical_and": "all", "logical_or": "any"}
        running = {"add": "cumsum", "multiply": "cumprod"}
        found = (whole if method == "reduce" else running).get(name)
        array, axis = inputs[0], options.pop("axis", inputs[1] if len(inputs) > 1 else 0)
        if found is not None:
            return getattr(jnp, found)(array, axis=axis, **{k: v for k, v in options.items() if v is not None})
        return _folded(_counterpart(operation), jnp.asarray(array), axis, method == "accumulate")
    return number.refuse(f"calls np.{name}.{method}", "write it out")


def _folded(operation: Callable[..., Any], array: Any, axis: int, running: bool) -> Any:
    """One element after the other along an axis."""
    parts = list(jnp.moveaxis(array, axis, 0))
    made = parts[:1]
    for part in parts[1:]:
        made.append(operation(made[-1], part))
    return jnp.stack(made, axis) if running else made[-1]


def function(called: Any, args: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """What `__array_function__` gives, and what is called in the place of a function of NumPy."""
    name = called.__name__
    if isinstance(called, np.ufunc):
        out = options.get("out")
        options = options if out is None or isinstance(out, tuple) else options | {"out": (out,)}
        return ufunc(called, "__call__", args, dict(options))
    if name in _MOVES:
        depth = 9 if name == "block" else int(name in _OF_SEVERAL)
        made = called(*(_moved(a, depth) for a in args), **{k: _moved(v, depth) for k, v in options.items()})
        return values.wrapped(made) if not isinstance(made, tuple | list) or _has_arrays(made) else made
    out = options.pop("out", None) if "out" in options else None
    given, named = [_given(a) for a in args], {k: _given(v) for k, v in options.items()}
    if any(isinstance(v, jax.Array) for a in (*given, *named.values()) for v in (a if isinstance(a, list) else [a])):
        if name == "clip":
            named = {_CLIP.get(k, k): v for k, v in named.items()}
        if name == "where" and len(given) == 1:
            number.refuse("asks where a condition holds", "write np.where(condition, a, b)")
        made = _counterpart(called)(*given, **named)
    else:
        made = called(*given, **named)
    return _put(values.wrapped(made), None if out is None else out if isinstance(out, tuple) else (out,))


def _has_arrays(made: Any) -> bool:
    return any(isinstance(part, np.ndarray) for part in made)


def _moved(value: Any, depth: int) -> Any:
    """An argument of what moves elements, with arrays of objects; so many lists in lists stay lists."""
    if isinstance(value, jax.Array):
        value = values.wrapped(value)
    if isinstance(value, values.Values):
        return value.view(np.ndarray)
    if isinstance(value, number.Number):
        return values.objects(value)
    if isinstance(value, list | tuple):
        together = not depth and values.is_traced(value)
        return values.objects(value) if together else type(value)(_moved(v, max(depth - 1, 0)) for v in value)
    return value


def _given(value: Any) -> Any:
    """An argument of what computes: arrays of JAX and NumPy."""
    # A tuple of whole numbers says which axes.
    if isinstance(value, list) or (isinstance(value, tuple) and not all(isinstance(v, int) for v in value)):
        try:
            return gather.gathered(values.array_of(value))
        except ValueError:
            return [_given(part) for part in value]
    return gather.gathered(value)


@functools.cache
def _counterpart(called: Any) -> Callable[..., Any]:
    """JAX's function of the same name."""
    name = _RENAMED.get(called.__name__, called.__name__)
    module = getattr(called, "__module__", None) or "numpy"
    if called in _OWN:
        return _OWN[called]
    # Other ufuncs are those of scipy.special.
    own = not isinstance(called, np.ufunc) or hasattr(np, called.__name__)
    place: Any = jnp if own else jax.scipy.special
    for part in module.split(".")[1:]:
        place = getattr(place, part, None) if part in ("linalg", "fft") else place
    found: Callable[..., Any] | None = getattr(place, name, None)
    if found is None:
        number.refuse(f"calls np.{name}, which has no counterpart in JAX", "write it by other functions of NumPy")
    return found
