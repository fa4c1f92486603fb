"""Operations on known numbers, computed while a function is lowered: exactly, in the types that JAX gives them."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.native.graph import Array, Graph

_ALIKE = ("f", "i", "u", "b")
# What NumPy computes bit for bit as XLA does, also where integers overflow.
_EXACT: dict[str, tuple[Callable[..., Any], str]] = {
    "add": (np.add, "fiu"),
    "sub": (np.subtract, "fiu"),
    "mul": (np.multiply, "fiu"),
    "div": (np.divide, "f"),
    "neg": (np.negative, "fiu"),
    "sqrt": (np.sqrt, "f"),
    "abs": (np.abs, "fi"),
    "floor": (np.floor, "f"),
    "ceil": (np.ceil, "f"),
    "lt": (np.less, "fiub"),
    "le": (np.less_equal, "fiub"),
    "gt": (np.greater, "fiub"),
    "ge": (np.greater_equal, "fiub"),
    "eq": (np.equal, "fiub"),
    "ne": (np.not_equal, "fiub"),
    "max": (np.maximum, "iub"),
    "min": (np.minimum, "iub"),
    "and": (np.bitwise_and, "iub"),
    "or": (np.bitwise_or, "iub"),
    "xor": (np.bitwise_xor, "iub"),
    "not": (np.invert, "iub"),
    "square": (np.square, "fiu"),
}
# Floats beyond this may lie outside of the integers.
_SAFE = {"int32": 2.0**30, "int64": 2.0**62, "uint32": 2.0**31, "uint64": 2.0**63}


def folded(g: Graph, equation: Any, values: Sequence[Array], unruled: bool) -> Any:
    """What an equation of known numbers gives, or None where its rule, if there is one, may find that from nodes."""
    name = equation.primitive.name
    with np.errstate(all="ignore"):
        made = _by_numpy(equation, name, values)
    if made is not None:
        return made
    types = [v.aval.dtype for v in (*equation.invars, *equation.outvars)]
    if not unruled and name not in ("while", "scan") and all(t in (g.dtype, np.dtype(bool)) for t in types):
        return None
    # What acts on the world outside is not done while a function is only looked at.
    return None if equation.effects or "callback" in name else _by_jax(equation, values)


def _by_numpy(equation: Any, name: str, values: Sequence[Array]) -> Any:
    kinds = {v.dtype.kind for v in values if isinstance(v, np.ndarray)}
    if not kinds <= set(_ALIKE) or any(v.dtype == np.float16 or not isinstance(v, np.ndarray) for v in values):
        return None
    # Operands of one type, as JAX has them; a parameter that is set may mean another one of the result.
    if name in _EXACT and len({v.dtype for v in values}) == 1 and kinds <= set(_EXACT[name][1]):
        return None if any(p is not None for p in equation.params.values()) else _EXACT[name][0](*values)
    if name == "iota":
        p = equation.params
        shape, dimension = p["shape"], p["dimension"]
        counted = np.arange(shape[dimension]).astype(p["dtype"])
        return np.broadcast_to(counted.reshape([-1 if i == dimension else 1 for i in range(len(shape))]), shape)
    if name == "select_n" and values[0].dtype == bool:
        return np.where(values[0], values[2], values[1])
    if name == "convert_element_type":
        return _converted(values[0], np.dtype(equation.params["new_dtype"]))
    return None


def _converted(value: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray | None:
    if dtype.kind not in _ALIKE or dtype == np.float16:
        return None
    if dtype.kind == "b":
        return value != 0
    if value.dtype.kind == "f" and dtype.kind in "iu":
        low, high = (0.0 if dtype.kind == "u" else -_SAFE.get(dtype.name, 0.0)), _SAFE.get(dtype.name, 0.0)
        # Written so that NaN fails.
        return value.astype(dtype) if np.all((value >= low) & (value < high)) else None
    return value.astype(dtype)


def _by_jax(equation: Any, values: Sequence[Array]) -> Any:
    found = equation.primitive.get_bind_params(equation.params)
    # Before JAX 0.8 functions came apart from the other parameters.
    functions, parameters = found if isinstance(found, tuple) else ((), found)
    with jax.ensure_compile_time_eval():
        made = equation.primitive.bind(*functions, *values, **parameters)
    return [_numbers(m) for m in made] if equation.primitive.multiple_results else _numbers(made)


def _numbers(made: Any) -> Any:
    return made if jnp.issubdtype(made.dtype, jax.dtypes.extended) else np.asarray(made)
