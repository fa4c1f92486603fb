"""Between which numbers a node lies, NaN apart: what tells whether integers are held exactly."""

import math

from sigmax.native.graph import Graph
from sigmax.native.node import Node

Interval = tuple[float, float]
_EVERYTHING = (-math.inf, math.inf)


def interval(g: Graph, node: Node) -> Interval:
    """The least and the largest value that a node can have."""
    for n in g.nodes[len(g.intervals) : node.index + 1]:
        g.intervals.append(_widened(n, _of(g, n)))
    return g.intervals[node.index]


def _widened(node: Node, found: Interval) -> Interval:
    """Rounding moves what is no integer."""
    low, high = found
    if math.isnan(low) or math.isnan(high):
        return _EVERYTHING
    if node.operation in ("+", "-", "*") and not (low.is_integer() and high.is_integer()):
        return low - abs(low) * 1e-6, high + abs(high) * 1e-6
    return found


def _of(g: Graph, node: Node) -> Interval:
    operation = node.operation
    if operation == "constant":
        value = float(node.value)
        return (value, value) if not math.isnan(value) else _EVERYTHING
    if operation == "table":
        numbers = g.tables[node.arguments[0]]
        return (float(numbers.min()), float(numbers.max())) if numbers.size else _EVERYTHING
    known = [g.intervals[a.index] for a in node.inputs]
    if operation == "select":
        (_, (a, b), (c, d)) = known
        p, x, y = node.arguments
        if p.operation == "<" and p.arguments[0] is y and p.arguments[1].known and x.operation == "+":
            # Where y is chosen it is not below the limit, and where x = y + n is, y is below it.
            limit = p.arguments[1].value
            rest = [n for n in x.arguments if n is not y]
            if len(rest) == 1 and rest[0].known:
                b, c = min(b, limit + rest[0].value), max(c, min(limit, d))
        return min(a, c), max(b, d)
    if node.truth:
        return 0.0, 1.0
    return _of_numbers(operation, known)


def _of_numbers(operation: str, known: list[Interval]) -> Interval:
    (a, b), (c, d) = known[0] if known else _EVERYTHING, known[1] if len(known) > 1 else _EVERYTHING
    match operation:
        case "+":
            return a + c, b + d
        case "-":
            return a - d, b - c
        case "*":
            corners = [0.0 if 0.0 in (x, y) else x * y for x in (a, b) for y in (c, d)]
            return min(corners), max(corners)
        case "negative":
            return -b, -a
        case "abs":
            return (0.0 if a <= 0 <= b else min(abs(a), abs(b))), max(abs(a), abs(b))
        case "max":
            return max(a, c), max(b, d)
        case "min":
            return min(a, c), min(b, d)
        case "integer":
            return min(_whole(a), 0.0), max(_whole(b), 0.0)
        case "floor":
            return _below(a), _below(b)
        case "unsigned zero":
            return a, b
        case "sign":
            return (-1.0 if a < 0 else 0.0 if a == 0 else 1.0), (1.0 if b > 0 else 0.0 if b == 0 else -1.0)
        case "quotient" if c > 0 or d < 0:
            # A divisor of 1 or more makes nothing larger.
            size = max(abs(a), abs(b)) / max(min(abs(c), abs(d)), 1.0)
            return (-_whole(size) if a < 0 or c < 0 else 0.0), (_whole(size) if b > 0 or c < 0 else 0.0)
        case "fmod":
            size = min(max(abs(a), abs(b)), max(abs(c), abs(d)))
            return (-size if a < 0 else 0.0), (size if b > 0 else 0.0)
    return _EVERYTHING


def _below(value: float) -> float:
    # A float as all bounds are: an `int` has no `is_integer` before Python 3.12.
    return float(math.floor(value)) if math.isfinite(value) else value


def _whole(value: float) -> float:
    return float(math.trunc(value)) if math.isfinite(value) else value
