"""Constants of float32 in functions that run in float64: digits that were lost before anything was computed."""

from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from sigmax.native.refusal import line_of

# Of the 24 bits of a float32. What was rounded to it nearly always needs more, data such as halves never do.
_FEW_BITS = 16


def coarse_constants(function: Callable[..., Any], traced: ClosedJaxpr) -> list[str]:
    """Each constant of a traced function that seems to have lost digits in float32: what it is, and where."""
    found = []
    for value, where in _constants(traced.jaxpr, dict(zip(traced.jaxpr.constvars, traced.consts, strict=True))):
        if value.dtype not in (np.float32, np.float64):
            continue
        array = np.asarray(value)
        if _coarse(array):
            called = _name_in(function, array)
            shown = called or (f"{array}" if array.ndim == 0 else f"an array of shape {array.shape}")
            found.append(f"{shown}{f' ({where})' if where else ''}")
    return list(dict.fromkeys(found))


def _coarse(value: np.ndarray) -> bool:
    if value.dtype == np.float64:
        # A scalar of float32 is float64 by now. It shows in decimals: 0.10000000149011612 is the float32 0.1.
        if value.ndim or not np.isfinite(value) or abs(value) > np.finfo(np.float32).max:
            return False
        single = np.float32(value)
        return bool(single == value and _many_bits(value) and float(str(single)) != value)
    return value.dtype == np.float32 and bool(_many_bits(value))


def _many_bits(value: np.ndarray) -> bool:
    mantissa, _ = np.frexp(np.asarray(value, float))
    scaled = np.where(np.isfinite(mantissa), mantissa, 0) * 2**_FEW_BITS
    return bool((scaled != np.round(scaled)).any())


def _constants(jaxpr: Jaxpr, known: dict[Any, Any]) -> Iterator[tuple[Any, str]]:
    """Captured arrays and scalars, with the line that reads them."""
    for equation in jaxpr.eqns:
        for variable in equation.invars:
            value = variable.val if isinstance(variable, Literal) else known.get(variable)
            if value is not None and not isinstance(value, jax.core.Tracer) and hasattr(value, "dtype"):
                yield value, line_of(equation)
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda p: isinstance(p, ClosedJaxpr | Jaxpr)
        ):
            if isinstance(inner, ClosedJaxpr):
                yield from _constants(inner.jaxpr, dict(zip(inner.jaxpr.constvars, inner.consts, strict=True)))
            elif isinstance(inner, Jaxpr):
                yield from _constants(inner, {})


def _name_in(function: Any, value: np.ndarray) -> str:
    """The variable of a function, or of one that it calls or closes over, that holds the value."""
    waiting, seen = [function], set()
    while waiting:
        one = waiting.pop(0)
        if id(one) in seen:
            continue
        seen.add(id(one))
        waiting += [f for f in (getattr(one, "__wrapped__", None), getattr(one, "func", None)) if callable(f)]
        for name, held in _variables(one).items():
            if isinstance(held, np.ndarray | np.generic | jax.Array) and not isinstance(held, jax.core.Tracer):
                same = held.shape == value.shape and held.dtype == np.float32
                if same and np.array_equal(np.asarray(held, float), value, equal_nan=True):
                    return name
            elif callable(held):
                waiting.append(held)
    return ""


def _variables(function: Any) -> dict[str, Any]:
    """What a Python function can see by name: arguments by default, what it closes over, globals that it names."""
    code = getattr(function, "__code__", None)
    if code is None:
        return {}
    names, named = code.co_varnames[: code.co_argcount], _named(code)
    defaults = function.__defaults__ or ()
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    seen = dict(zip(names[len(names) - len(defaults) :], defaults, strict=True))
    seen |= {name: cell.cell_contents for name, cell in cells if _filled(cell)}
    return seen | {name: function.__globals__[name] for name in named if name in function.__globals__}


def _named(code: CodeType) -> set[str]:
    inner = (_named(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _filled(cell: Any) -> bool:
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False
