"""Indices beyond an array in the functions of a model: JAX takes another element, or writes none, without a word."""

from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from sigmax.native.refusal import line_of

# What becomes of an index on its way to the array; anything else is not followed.
_FOLLOWED = ("lt", "add", "select_n", "broadcast_in_dim", "convert_element_type", "reshape", "concatenate", "squeeze")


def check_indices(closed: ClosedJaxpr) -> None:
    """Refuse an index that is known before any number is and lies beyond its array.

    Indices computed from numbers are not looked at, nor what is in loops: there a mask may stand before it.

    Raises:
        IndexError: with the size of the array and the line of the function.
    """
    with jax.ensure_compile_time_eval():
        _check(closed.jaxpr, _numbers(closed.jaxpr.constvars, closed.consts))


def _check(jaxpr: Jaxpr, known: dict[Any, Any]) -> None:
    def value(v: Any) -> Any:
        return v.val if isinstance(v, Literal) else known.get(v)

    for equation in jaxpr.eqns:
        values = [value(v) for v in equation.invars]
        name, inner = equation.primitive.name, equation.params.get("jaxpr")
        if name == "dynamic_slice":
            _within(equation, values[1:], equation.params["slice_sizes"], range(len(values) - 1))
        elif name == "gather" and equation.params["mode"] == jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS:
            axes = equation.params["dimension_numbers"].start_index_map
            at = [None if values[1] is None else np.asarray(values[1])[..., j] for j in range(len(axes))]
            _within(equation, at, equation.params["slice_sizes"], axes)
        elif name == "dynamic_update_slice":
            _within(equation, values[2:], _shape(equation.invars[1]), range(len(values) - 2), "written")
        elif name.startswith("scatter") and equation.params["mode"] != jax.lax.GatherScatterMode.CLIP:
            axes = equation.params["dimension_numbers"].scatter_dims_to_operand_dims
            at = [None if values[1] is None else np.asarray(values[1])[..., j] for j in range(len(axes))]
            _within(equation, at, _window(equation), axes, "written")
        elif isinstance(inner, ClosedJaxpr) and name in ("jit", "pjit"):
            _check(inner.jaxpr, _numbers(inner.jaxpr.constvars, inner.consts) | _numbers(inner.jaxpr.invars, values))
        elif name in _FOLLOWED and all(v is not None and np.asarray(v).dtype.kind in "iub" for v in values):
            known[equation.outvars[0]] = equation.primitive.bind(*values, **equation.params)


def _numbers(variables: Any, values: Any) -> dict[Any, Any]:
    """Those that are known: neither computed from what is given nor traced from outside."""
    found = zip(variables, values, strict=True)
    return {v: c for v, c in found if c is not None and not isinstance(c, jax.core.Tracer)}


def _shape(variable: Any) -> tuple[int, ...]:
    return tuple(variable.aval.shape)


def _window(scatter: Any) -> list[int]:
    """How many elements along each axis of its array one index of a scatter writes."""
    numbers, updates = scatter.params["dimension_numbers"], _shape(scatter.invars[2])
    sizes = iter([updates[axis] for axis in numbers.update_window_dims])
    single = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
    return [1 if axis in single else next(sizes) for axis in range(len(_shape(scatter.invars[0])))]


def _within(equation: Any, starts: Any, sizes: Any, axes: Any, what: str = "read") -> None:
    shape = equation.invars[0].aval.shape
    for start, axis in zip(starts, axes, strict=True):
        if start is None:
            continue
        at, last = np.asarray(start), shape[axis] - sizes[axis]
        if at.size and not (at.min() >= 0 and at.max() <= last):
            where = line_of(equation)
            beyond = int(at.min() if at.min() < 0 else at.max() + sizes[axis] - 1)
            raise IndexError(
                f"element {beyond} of an array that has {shape[axis]} is {what}{f' ({where})' if where else ''}; "
                f"JAX would {'take another one' if what == 'read' else 'not write it'} without a word"
            )
