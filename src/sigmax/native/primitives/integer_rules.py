"""Rules of operations with integers, see `integers`."""

import math
from typing import Any

import numpy as np

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.node import Node
from sigmax.native.primitives.elementwise import (
    ARITHMETIC,
    COMPARED,
    RUNNING,
    TOTAL,
    as_numbers,
    each,
    multiplied_out,
    product,
    reduced,
    running,
)
from sigmax.native.primitives.integers import (
    bounded,
    check_exact,
    combining,
    compared,
    each_integer,
    exact,
    held,
    is_nearest,
    limits,
)
from sigmax.native.primitives.interpret import rule
from sigmax.native.primitives.intervals import interval
from sigmax.native.refusal import Refused


def _out(equation: Any) -> Any:
    return equation.outvars[0].aval.dtype


@rule(*ARITHMETIC, integers=True)
def _plain(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    return each_integer(g, ARITHMETIC[equation.primitive.name], _out(equation))(a, b)


@rule("neg", integers=True)
def _negative(g: Graph, equation: Any, a: Array) -> Array:
    return each_integer(g, "-", _out(equation))(g.constants(0.0), a)


@rule("abs", integers=True)
def _abs(g: Graph, equation: Any, a: Array) -> Array:
    check_exact(g, *a.flat)
    return np.frompyfunc(lambda x: held(g, g.apply("abs", x), _out(equation)), 1, 1)(a)


@rule("sign", integers=True)
def _sign(g: Graph, equation: Any, a: Array) -> Array:
    return np.frompyfunc(lambda x: g.apply("sign", g.certain(x)), 1, 1)(a)


_COMPARED = COMPARED | TOTAL | {"max": "max", "min": "min"}


@rule(*_COMPARED, integers=True)
def _compared(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    operation = _COMPARED[equation.primitive.name]
    return np.frompyfunc(lambda x, y: compared(g, operation, x, y), 2, 1)(a, b)


@rule("clamp", integers=True)
def _clamp(g: Graph, equation: Any, low: Array, a: Array, high: Array) -> Array:
    def one(least: Node, x: Node, most: Node) -> Node:
        return compared(g, "min", compared(g, "max", x, least), most)

    return np.frompyfunc(one, 3, 1)(low, a, high)


@rule("div", integers=True)
def _div(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    dtype = _out(equation)
    about = np.iinfo(dtype)

    def one(x: Node, y: Node) -> Node:
        check_exact(g, x, y)
        low, high = interval(g, y)
        if low > 0 or high < 0:
            return held(g, g.apply("quotient", x, y), dtype)
        nothing = g.apply("==", y, g.constant(0.0))
        safe = g.apply("select", nothing, g.constant(1.0), y)
        size = max(abs(v) for v in interval(g, x))
        made = held(g, bounded(g, g.apply("quotient", x, safe), -size, size + 1), dtype)
        by_zero = float(about.max if about.min == 0 else -1)
        if by_zero > g.exact:
            raise Refused(f"a division of {dtype} by what may be zero cannot be lowered to C")
        return g.apply("select", nothing, g.constant(by_zero), made)

    return np.frompyfunc(one, 2, 1)(a, b)


@rule("rem", integers=True)
def _rem(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    dtype = _out(equation)

    def one(x: Node, y: Node) -> Node:
        x, y = g.certain(x), g.certain(y)
        if not exact(g, x) and y.known and y.value != 0 and is_nearest(g, x):
            return _rem_of_large(g, x, y, dtype)
        check_exact(g, x, y)
        low, high = interval(g, y)
        made = g.apply("fmod", x, y)
        return made if low > 0 or high < 0 else g.apply("select", g.apply("==", y, g.constant(0.0)), x, made)

    return np.frompyfunc(one, 2, 1)(a, b)


def _rem_of_large(g: Graph, x: Node, y: Node, dtype: Any) -> Node:
    """Of a float made an integer: exact below the limits of the type, beyond them of the nearest integer."""
    check_exact(g, y)
    least, beyond = limits(dtype)
    made = g.apply("fmod", g.apply("max", x, g.constant(least)), y)
    largest = float(math.fmod(int(np.iinfo(dtype).max) % abs(int(y.value)), y.value))
    return g.apply("select", g.apply(">=", x, g.constant(beyond)), g.constant(largest), made)


@rule("square", integers=True)
def _square(g: Graph, equation: Any, a: Array) -> Array:
    return each_integer(g, "*", _out(equation))(a, a)


@rule("integer_pow", parameters="y", integers=True)
def _integer_pow(g: Graph, equation: Any, a: Array) -> Array:
    if equation.params["y"] < 0:
        raise Refused("an integer to a negative power cannot be lowered to C")
    return multiplied_out(g, each_integer(g, "*", _out(equation)), a, equation.params["y"])


@rule("pow", integers=True)
def _pow(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    if not np.issubdtype(_out(equation), np.floating) or equation.invars[0].aval.dtype.kind != "f":
        raise Refused("a power of computed integers cannot be lowered to C")
    check_exact(g, *b.flat)
    return each(g, "pow")(a, b)


@rule("not", integers=True)
def _not(g: Graph, equation: Any, a: Array) -> Array:
    last = g.constants(float(np.iinfo(_out(equation)).max) if _out(equation).kind == "u" else -1.0)
    return each_integer(g, "-", _out(equation))(last, a)


_REDUCED = {"reduce_sum": "+", "reduce_prod": "*", "reduce_max": "max", "reduce_min": "min"}


@rule(*_REDUCED, parameters="axes", integers=True)
def _reduction(g: Graph, equation: Any, a: Array) -> Array:
    combine = np.frompyfunc(combining(g, _REDUCED[equation.primitive.name], _out(equation)), 2, 1)
    start = {"reduce_prod": 1, "reduce_max": np.iinfo(_out(equation)).min, "reduce_min": np.iinfo(_out(equation)).max}
    return reduced(g, combine, float(start.get(equation.primitive.name, 0)), a, equation.params["axes"])


@rule("argmax", "argmin", parameters="axes index_dtype", integers=True)
def _arg(g: Graph, equation: Any, a: Array) -> Array:
    (axis,) = equation.params["axes"]
    if equation.invars[0].aval.dtype.kind in "iu":
        check_exact(g, *a.flat)
    a = as_numbers(g, a)
    better = each(g, ">" if equation.primitive.name == "argmax" else "<")
    select = each(g, "select")
    best, place = a.take(0, axis), g.constants(np.zeros(np.delete(a.shape, axis)))
    for i in range(1, a.shape[axis]):
        # The first NaN wins, as it does elsewhere.
        one = a.take(i, axis)
        nan = each(g, "and")(each(g, "!=")(one, one), each(g, "==")(best, best))
        wins = each(g, "or")(better(one, best), nan)
        best, place = select(wins, one, best), select(wins, g.constants(float(i)), place)
    return boxed(place)


@rule(*RUNNING, parameters="axis reverse", integers=True)
def _running(g: Graph, equation: Any, a: Array) -> Array:
    combine = np.frompyfunc(combining(g, RUNNING[equation.primitive.name], _out(equation)), 2, 1)
    return running(combine, a, equation.params["axis"], equation.params["reverse"])


@rule("dot_general", parameters="dimension_numbers precision preferred_element_type", integers=True)
def _dot_general(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    dtype = _out(equation)
    if any(v.aval.dtype not in (dtype, bool) for v in equation.invars):
        raise Refused("a product of numbers of several types cannot be lowered to C")
    times, plus = each_integer(g, "*", dtype), each_integer(g, "+", dtype)
    return product(g, equation, times, plus, as_numbers(g, a), as_numbers(g, b))
