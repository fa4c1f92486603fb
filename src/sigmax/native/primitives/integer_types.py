"""Integers from numbers and truth values, numbers from integers, and integers of other types."""

import math
from typing import Any

import numpy as np

from sigmax.native.graph import Array, Graph
from sigmax.native.node import Node
from sigmax.native.primitives.elementwise import as_numbers
from sigmax.native.primitives.integers import arithmetic, bounded, compared, exact, held, is_nearest, limits
from sigmax.native.primitives.interpret import rule
from sigmax.native.primitives.intervals import interval
from sigmax.native.refusal import Refused


@rule("convert_element_type", parameters="new_dtype weak_type", any_width=True, integers=True)
def _convert(g: Graph, equation: Any, a: Array) -> Array:
    before, after = equation.invars[0].aval.dtype, equation.outvars[0].aval.dtype
    if after.kind == "b":
        return np.frompyfunc(lambda x: compared(g, "!=", x, g.constant(0.0)), 1, 1)(a)
    if before.kind == "b":
        return as_numbers(g, a)
    if after.kind == "f":
        return np.frompyfunc(lambda x: _to_float(g, x, before), 1, 1)(a)
    if before.kind == "f":
        return np.frompyfunc(lambda x: _from_float(g, x, after), 1, 1)(a)
    return np.frompyfunc(lambda x: _to_other(g, x, before, after), 1, 1)(a)


def _from_float(g: Graph, x: Node, dtype: Any) -> Node:
    """The nearest integer of the type towards zero, NaN being 0; a large one may lie beyond the type."""
    made = g.apply("integer", x)
    least, beyond = limits(dtype)
    low, high = interval(g, made)
    if low < least and (least == 0 or -least <= g.exact):
        made = g.apply("max", made, g.constant(least))
    if high >= beyond and beyond <= g.exact:
        made = g.apply("min", made, g.constant(beyond - 1))
    return made


def _to_other(g: Graph, x: Node, before: Any, after: Any) -> Node:
    """An integer in another type: beyond it, it goes round."""
    least, beyond = limits(after)
    (low, high), narrow = interval(g, x), beyond - least <= g.exact
    if exact(g, x) and x.index not in g.uncertain and (narrow or (least <= low and high < beyond)):
        return held(g, x, after)
    if not narrow:
        raise Refused(f"integers that may lie beyond {g.exact:.0f} as {after} cannot be lowered to C")
    if x.known:
        return g.constant(float((int(x.value) - int(least)) % int(beyond - least) + int(least)))
    # The last bits of a sum are those of its parts, also where it overflows or is not held exactly.
    if x.operation == "select":
        p, *cases = x.arguments
        return g.apply("select", p, *(_to_other(g, case, before, after) for case in cases))
    if x.operation == "+" and any(part.known for part in x.arguments):
        return arithmetic(g, "+", after)(*(_to_other(g, part, before, after) for part in x.arguments))
    if not is_nearest(g, x):
        raise Refused(f"integers that may lie beyond {g.exact:.0f} as {after} cannot be lowered to C")
    return _last_bits(g, x, before, after)


def _last_bits(g: Graph, x: Node, before: Any, after: Any) -> Node:
    """A float as the nearest integer of a wide type, and that in a narrow one."""
    apply, (least, beyond), (first, last) = g.apply, limits(after), limits(before)
    width = g.constant(beyond - least)
    within = apply("max", x, g.constant(first))
    turns = apply("floor", apply("*", within, g.constant(1 / (beyond - least))))
    rest = bounded(g, apply("-", within, apply("*", turns, width)), 0.0, beyond - least)
    rest = apply("select", apply(">=", x, g.constant(last)), g.constant(beyond - least - 1), rest)
    if least < 0:
        rest = apply("select", apply(">=", rest, g.constant(beyond)), apply("-", rest, width), rest)
    return bounded(g, rest, least, beyond)


def _to_float(g: Graph, x: Node, dtype: Any) -> Node:
    """An integer of a type as a float; a large one as the float that it was, within the limits of its type."""
    x = g.certain(x)
    (low, high), (least, beyond) = interval(g, x), limits(dtype)
    if low < least:
        x = g.apply("max", x, g.constant(least))
    if high > beyond:
        x = g.apply("min", x, g.constant(beyond))
    return g.apply("unsigned zero", x) if low <= 0 <= high and _may_be_negative_zero(x) else x


def _may_be_negative_zero(x: Node, depth: int = 9) -> bool:
    """Whether an integer 0 may come with a sign: of products, remainders and the like."""
    if x.operation in ("integer", "table", "abs") or not depth:
        return not depth
    if x.known:
        return math.copysign(1.0, x.value) < 0
    if x.operation == "+":
        return all(_may_be_negative_zero(a, depth - 1) for a in x.arguments)
    if x.operation in ("max", "min", "select", "-"):
        cases = {"select": x.arguments[1:], "-": x.arguments[:1]}.get(x.operation, x.arguments)
        return any(_may_be_negative_zero(a, depth - 1) for a in cases)
    return True
