"""Rules of what acts on each element, of reductions and of products."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.interpret import rule
from sigmax.native.operations import OPERATIONS
from sigmax.native.refusal import Refused

_OTHERWISE_NAMED = {
    "add": "+",
    "add_any": "+",
    "sub": "-",
    "mul": "*",
    "neg": "negative",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "eq": "==",
    "ne": "!=",
    "is_finite": "finite",
}
# Those whose primitive means something else, or has parameters.
_APART = {"and", "or", "xor", "not", "round", "select"}
_DIRECT = _OTHERWISE_NAMED | {name: name for name in OPERATIONS if name.isidentifier() and name not in _APART}


def each(g: Graph, operation: str) -> Callable[..., Array]:
    """An operation over arrays of nodes."""
    return np.frompyfunc(functools.partial(g.apply, operation), OPERATIONS[operation].arity, 1)


def _floating(equation: Any) -> bool:
    return bool(jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.floating))


@rule(*_DIRECT)
def _direct(g: Graph, equation: Any, *arrays: Array) -> Array:
    name = equation.primitive.name
    if equation.outvars[0].aval.dtype == bool and name in ("max", "min"):
        return each(g, "or" if name == "max" else "and")(*arrays)
    return each(g, _DIRECT[name])(*(_numbers(g, a) for a in arrays))


def _numbers(g: Graph, a: Array) -> Array:
    """Truth values as 0 and 1, numbers as they are."""
    return np.frompyfunc(lambda x: g.apply("select", x, g.constant(1.0), g.constant(0.0)) if x.truth else x, 1, 1)(a)


@rule("lt_to", "le_to")
def _total_order(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    """The order in which NaN comes after everything."""
    plain = each(g, "<" if equation.primitive.name == "lt_to" else "<=")(a, b)
    last = each(g, "!=")(b, b)
    if equation.primitive.name == "lt_to":
        last = each(g, "and")(last, each(g, "==")(a, a))
    return each(g, "or")(plain, last)


@rule("div")
def _div(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    quotient = each(g, "/")(a, b)
    return quotient if _floating(equation) else each(g, "trunc")(quotient)


@rule("rem")
def _rem(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    return each(g, "fmod")(a, b)


@rule("and", "or", "xor", "not")
def _logic(g: Graph, equation: Any, *arrays: Array) -> Array:
    if equation.outvars[0].aval.dtype != bool:
        if not all(x.known for a in arrays for x in a.flat):
            raise Refused("operations on the bits of computed integers cannot be lowered to C")
        name = {"and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert}
        values = [np.array([int(x.value) for x in a.flat]).reshape(a.shape) for a in arrays]
        return g.constants(name[equation.primitive.name](*values))
    return each(g, equation.primitive.name)(*arrays)


@rule("square")
def _square(g: Graph, equation: Any, a: Array) -> Array:
    return each(g, "*")(a, a)


@rule("rsqrt")
def _rsqrt(g: Graph, equation: Any, a: Array) -> Array:
    return each(g, "/")(g.constants(1.0), each(g, "sqrt")(a))


@rule("logistic")
def _logistic(g: Graph, equation: Any, a: Array) -> Array:
    grown = each(g, "exp")(each(g, "negative")(a))
    return each(g, "/")(g.constants(1.0), each(g, "+")(grown, g.constants(1.0)))


@rule("integer_pow")
def _integer_pow(g: Graph, equation: Any, a: Array) -> Array:
    exponent = equation.params["y"]
    times, result, power, left = each(g, "*"), None, a, abs(exponent)
    while left:
        if left & 1:
            result = power if result is None else times(result, power)
        left >>= 1
        power = times(power, power) if left else power
    if result is None:
        return g.constants(np.ones(a.shape))
    return result if exponent > 0 else each(g, "/")(g.constants(1.0), result)


@rule("round")
def _round(g: Graph, equation: Any, a: Array) -> Array:
    to_even = int(equation.params["rounding_method"]) == 1
    return each(g, "rint" if to_even else "round")(a)


@rule("clamp")
def _clamp(g: Graph, equation: Any, low: Array, a: Array, high: Array) -> Array:
    return each(g, "min")(each(g, "max")(a, low), high)


@rule("select_n")
def _select_n(g: Graph, equation: Any, which: Array, *cases: Array) -> Array:
    select = each(g, "select")
    if equation.invars[0].aval.dtype == bool:
        return select(which, cases[1], cases[0])
    result = cases[-1]
    for number in range(len(cases) - 2, -1, -1):
        result = select(each(g, "<=")(which, g.constants(float(number))), cases[number], result)
    return result


@rule("convert_element_type")
def _convert(g: Graph, equation: Any, a: Array) -> Array:
    before, after = equation.invars[0].aval.dtype, equation.outvars[0].aval.dtype
    if before == after:
        return a
    if before.kind == "b":
        return each(g, "select")(a, g.constants(1.0), g.constants(0.0))
    if after.kind == "b":
        return each(g, "!=")(a, g.constants(0.0))
    if jnp.issubdtype(before, jnp.floating) and jnp.issubdtype(after, jnp.integer):
        return each(g, "trunc")(a)
    if not (jnp.issubdtype(after, jnp.floating) or jnp.issubdtype(after, jnp.integer)):
        raise Refused(f"numbers of type {after} cannot be lowered to C")
    return a


@rule("copy", "copy_p", "stop_gradient", "device_put", "reduce_precision", "optimization_barrier", "name", "pvary")
def _unchanged(g: Graph, equation: Any, *arrays: Array) -> Any:
    return list(arrays) if equation.primitive.multiple_results else arrays[0]


def _reduced(g: Graph, operation: str, start: Any, a: Array, axes: tuple[int, ...]) -> Array:
    combine = each(g, operation)
    for axis in sorted(axes, reverse=True):
        parts = [a.take(i, axis) for i in range(a.shape[axis])]
        a = functools.reduce(combine, parts) if parts else g.constants(np.full(np.delete(a.shape, axis), start))
        a = boxed(a)
    return a


_REDUCTIONS = {
    "reduce_sum": ("+", 0.0),
    "reduce_prod": ("*", 1.0),
    "reduce_max": ("max", -np.inf),
    "reduce_min": ("min", np.inf),
    "reduce_and": ("and", True),
    "reduce_or": ("or", False),
    "reduce_xor": ("xor", False),
}


@rule(*_REDUCTIONS)
def _reduction(g: Graph, equation: Any, a: Array) -> Array:
    operation, start = _REDUCTIONS[equation.primitive.name]
    return _reduced(g, operation, start, a, equation.params["axes"])


@rule("argmax", "argmin")
def _arg(g: Graph, equation: Any, a: Array) -> Array:
    (axis,) = equation.params["axes"]
    a = _numbers(g, a)
    better = each(g, ">" if equation.primitive.name == "argmax" else "<")
    select = each(g, "select")
    best, place = a.take(0, axis), g.constants(np.zeros(np.delete(a.shape, axis)))
    for i in range(1, a.shape[axis]):
        # The first NaN wins, as it does elsewhere.
        one = a.take(i, axis)
        nan = each(g, "and")(each(g, "!=")(one, one), each(g, "==")(best, best))
        wins = each(g, "or")(better(one, best), nan)
        best, place = select(wins, one, best), select(wins, g.constants(float(i)), place)
    return place


_RUNNING = {"cumsum": "+", "cumprod": "*", "cummax": "max", "cummin": "min"}


@rule(*_RUNNING)
def _running(g: Graph, equation: Any, a: Array) -> Array:
    axis, reverse = equation.params["axis"], equation.params["reverse"]
    combine = each(g, _RUNNING[equation.primitive.name])
    parts = [a.take(i, axis) for i in range(a.shape[axis])]
    order = parts[::-1] if reverse else parts
    for i in range(1, len(order)):
        order[i] = combine(order[i - 1], order[i])
    return np.stack(order[::-1] if reverse else order, axis)


@rule("dot_general")
def _dot_general(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    (ca, cb), (ba, bb) = equation.params["dimension_numbers"]
    fa = [i for i in range(a.ndim) if i not in (*ca, *ba)]
    fb = [i for i in range(b.ndim) if i not in (*cb, *bb)]
    batch, rows, columns = [a.shape[i] for i in ba], [a.shape[i] for i in fa], [b.shape[i] for i in fb]
    left = a.transpose(*ba, *fa, *ca).reshape(*batch, int(np.prod(rows)), 1, -1)
    right = b.transpose(*bb, *fb, *cb).reshape(*batch, 1, int(np.prod(columns)), left.shape[-1])
    made = _reduced(g, "+", 0.0, each(g, "*")(left, right), (left.ndim - 1,))
    return made.reshape(*batch, *rows, *columns)
