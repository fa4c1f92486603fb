"""Rules of what acts on each element, of reductions and of products."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.operations import OPERATIONS
from sigmax.native.primitives.interpret import rule
from sigmax.native.refusal import Refused

# Primitives by the operation they are, of numbers of any type.
ARITHMETIC = {"add": "+", "add_any": "+", "sub": "-", "mul": "*"}
COMPARED = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
TOTAL = {"lt_to": "<", "le_to": "<="}
RUNNING = {"cumsum": "+", "cumprod": "*", "cummax": "max", "cummin": "min"}
_OTHERWISE_NAMED = ARITHMETIC | COMPARED | {"neg": "negative", "is_finite": "finite"}
# Those whose primitive means something else, or has parameters.
_APART = {"and", "or", "xor", "not", "round", "select"}
_DIRECT = _OTHERWISE_NAMED | {name: name for name in OPERATIONS if name.isidentifier() and name not in _APART}


def each(g: Graph, operation: str) -> Callable[..., Array]:
    """An operation over arrays of nodes."""
    return np.frompyfunc(functools.partial(g.apply, operation), OPERATIONS[operation].arity, 1)


@rule(*_DIRECT, integers=False)
def _direct(g: Graph, equation: Any, *arrays: Array) -> Array:
    name, truth = equation.primitive.name, equation.invars[0].aval.dtype == bool
    if truth and equation.outvars[0].aval.dtype == bool and name in _OF_TRUTH:
        return each(g, _OF_TRUTH[name])(*arrays)
    if truth and name not in COMPARED:
        raise Refused(f"the operation {name!r} on truth values cannot be lowered to C")
    return each(g, _DIRECT[name])(*(as_numbers(g, a) for a in arrays))


_OF_TRUTH = {"max": "or", "min": "and", "add": "or", "mul": "and", "ne": "xor"}


def as_numbers(g: Graph, a: Array) -> Array:
    """Truth values as 0 and 1, numbers as they are."""
    one, zero = g.constant(1.0), g.constant(0.0)
    return boxed(np.frompyfunc(lambda x: g.apply("select", x, one, zero) if x.truth else x, 1, 1)(a))


@rule(*TOTAL, integers=False)
def _total_order(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    """The order in which NaN comes after everything."""
    plain = each(g, TOTAL[equation.primitive.name])(a, b)
    last = each(g, "!=")(b, b)
    if equation.primitive.name == "lt_to":
        last = each(g, "and")(last, each(g, "==")(a, a))
    return each(g, "or")(plain, last)


@rule("div", integers=False)
def _div(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    return each(g, "/")(a, b)


@rule("rem", integers=False)
def _rem(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    return each(g, "fmod")(a, b)


@rule("and", "or", "xor", "not", integers=False)
def _logic(g: Graph, equation: Any, *arrays: Array) -> Array:
    return each(g, equation.primitive.name)(*arrays)


@rule("square", integers=False)
def _square(g: Graph, equation: Any, a: Array) -> Array:
    return each(g, "*")(a, a)


@rule("rsqrt", integers=False)
def _rsqrt(g: Graph, equation: Any, a: Array) -> Array:
    return each(g, "/")(g.constants(1.0), each(g, "sqrt")(a))


@rule("logistic", integers=False)
def _logistic(g: Graph, equation: Any, a: Array) -> Array:
    grown = each(g, "exp")(each(g, "negative")(a))
    return each(g, "/")(g.constants(1.0), each(g, "+")(grown, g.constants(1.0)))


@rule("integer_pow", parameters="y", integers=False)
def _integer_pow(g: Graph, equation: Any, a: Array) -> Array:
    exponent = equation.params["y"]
    result = multiplied_out(g, each(g, "*"), a, abs(exponent))
    return result if exponent >= 0 else each(g, "/")(g.constants(1.0), result)


def multiplied_out(g: Graph, times: Callable[..., Array], power: Array, exponent: int) -> Array:
    """A power by squares."""
    result = None
    while exponent:
        if exponent & 1:
            result = power if result is None else times(result, power)
        exponent >>= 1
        power = times(power, power) if exponent else power
    return g.constants(np.ones(power.shape)) if result is None else result


@rule("round", parameters="rounding_method", integers=False)
def _round(g: Graph, equation: Any, a: Array) -> Array:
    to_even = int(equation.params["rounding_method"]) == 1
    return each(g, "rint" if to_even else "round")(a)


@rule("clamp", integers=False)
def _clamp(g: Graph, equation: Any, low: Array, a: Array, high: Array) -> Array:
    return each(g, "min")(each(g, "max")(a, low), high)


@rule("select_n", any_width=True)
def _select_n(g: Graph, equation: Any, which: Array, *cases: Array) -> Array:
    select = each(g, "select")
    if equation.invars[0].aval.dtype == bool:
        return select(which, cases[1], cases[0]) if len(cases) == 2 else cases[0]
    certain = np.frompyfunc(g.certain, 1, 1)(which)
    result = cases[-1]
    for number in range(len(cases) - 2, -1, -1):
        result = select(each(g, "<=")(certain, g.constants(float(number))), cases[number], result)
    return result


@rule("convert_element_type", parameters="new_dtype weak_type", any_width=True, integers=False)
def _convert(g: Graph, equation: Any, a: Array) -> Array:
    before, after = equation.invars[0].aval.dtype, equation.outvars[0].aval.dtype
    if before.kind == after.kind:
        if after.itemsize < before.itemsize:
            g.check_type(after)
        return a
    return as_numbers(g, a) if before.kind == "b" else each(g, "!=")(a, g.constants(0.0))


SAME = ("copy", "copy_p", "stop_gradient", "device_put", "optimization_barrier", "name", "pvary")


@rule(*SAME, parameters="name device devices srcs copy_semantics", moves=True)
def _unchanged(g: Graph, equation: Any, *arrays: Array) -> Any:
    return list(arrays) if equation.primitive.multiple_results else arrays[0]


@rule("reduce_precision", parameters="exponent_bits mantissa_bits", integers=False)
def _reduce_precision(g: Graph, equation: Any, a: Array) -> Array:
    bits, about = (equation.params["exponent_bits"], equation.params["mantissa_bits"]), np.finfo(g.dtype)
    if bits[0] < about.nexp or bits[1] < about.nmant:
        raise Refused(f"numbers of {bits[0]} bits of exponent and {bits[1]} of mantissa cannot be lowered to C")
    return a


def reduced(g: Graph, combine: Callable[..., Array], start: Any, a: Array, axes: tuple[int, ...]) -> Array:
    """An array with elements combined along axes; the start where there are none."""
    for axis in sorted(axes, reverse=True):
        parts = [a.take(i, axis) for i in range(a.shape[axis])]
        a = functools.reduce(combine, parts) if parts else g.constants(np.full(np.delete(a.shape, axis), start))
        a = boxed(a)
    return a


# What acts on each element, of numbers of any type.
EACH = frozenset(
    {*_DIRECT, *TOTAL, "div", "rem", "and", "or", "xor", "not", "square", "rsqrt", "logistic", "integer_pow", "round"}
    | {"clamp", "select_n", "convert_element_type", "reduce_precision"}
)

REDUCTIONS = {
    "reduce_sum": ("+", 0.0),
    "reduce_prod": ("*", 1.0),
    "reduce_max": ("max", -np.inf),
    "reduce_min": ("min", np.inf),
    "reduce_and": ("and", True),
    "reduce_or": ("or", False),
    "reduce_xor": ("xor", False),
}
REDUCED_TRUTH = {"reduce_max": ("or", False), "reduce_min": ("and", True)}


@rule(*REDUCTIONS, parameters="axes", integers=False)
def _reduction(g: Graph, equation: Any, a: Array) -> Array:
    name = equation.primitive.name
    truth = equation.invars[0].aval.dtype == bool
    if truth and name in ("reduce_sum", "reduce_prod"):
        raise Refused(f"the operation {name!r} on truth values cannot be lowered to C")
    operation, start = (REDUCED_TRUTH if truth else {}).get(name, REDUCTIONS[name])
    return reduced(g, each(g, operation), start, a, equation.params["axes"])


@rule(*RUNNING, parameters="axis reverse", integers=False)
def _running(g: Graph, equation: Any, a: Array) -> Array:
    if equation.invars[0].aval.dtype == bool:
        raise Refused(f"the operation {equation.primitive.name!r} on truth values cannot be lowered to C")
    combine = each(g, RUNNING[equation.primitive.name])
    return running(combine, a, equation.params["axis"], equation.params["reverse"])


def running(combine: Callable[..., Array], a: Array, axis: int, reverse: bool) -> Array:
    """An array in which each element is combined with all before it, or after it if `reverse`."""
    parts = [a.take([i], axis) for i in range(a.shape[axis])]
    order = parts[::-1] if reverse else parts
    for i in range(1, len(order)):
        order[i] = combine(order[i - 1], order[i])
    return np.concatenate(order[::-1] if reverse else order, axis) if order else a


@rule("dot_general", parameters="dimension_numbers precision preferred_element_type", integers=False)
def _dot_general(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    if equation.outvars[0].aval.dtype.kind == "b":
        raise Refused("a product of truth values cannot be lowered to C")
    return product(g, equation, each(g, "*"), each(g, "+"), as_numbers(g, a), as_numbers(g, b))


def product(
    g: Graph, equation: Any, times: Callable[..., Array], plus: Callable[..., Array], a: Array, b: Array
) -> Array:
    """A product of arrays over the axes that the equation names.

    Raises:
        Refused: where it is to be computed in a narrower type.
    """
    precision = equation.params["precision"]
    for one in precision if isinstance(precision, tuple) else (precision,):
        if not (one is None or isinstance(one, jax.lax.Precision)):
            raise Refused(f"the operation 'dot_general' with precision={precision} cannot be lowered to C")
    (ca, cb), (ba, bb) = equation.params["dimension_numbers"]
    fa = [i for i in range(a.ndim) if i not in (*ca, *ba)]
    fb = [i for i in range(b.ndim) if i not in (*cb, *bb)]
    batch, rows, columns = [a.shape[i] for i in ba], [a.shape[i] for i in fa], [b.shape[i] for i in fb]
    summed = math.prod(a.shape[i] for i in ca)
    left = a.transpose(*ba, *fa, *ca).reshape(*batch, math.prod(rows), 1, summed)
    right = b.transpose(*bb, *fb, *cb).reshape(*batch, 1, math.prod(columns), summed)
    made = reduced(g, plus, 0.0, boxed(times(left, right)), (left.ndim - 1,))
    return made.reshape((*batch, *rows, *columns))
