"""What an operation becomes where its arguments are known or repeat each other."""

import math
from typing import Any

from sigmax.native.node import Makes, Node


def _is(x: Node, value: float) -> bool:
    return x.operation == "constant" and x.arguments[0] == value


def _add(g: Makes, x: Node, y: Node) -> Node | None:
    if _is(x, 0):
        return y
    if _is(y, 0):
        return x
    if y.operation == "negative":
        return g.apply("-", x, y.arguments[0])
    if x.operation == "negative":
        return g.apply("-", y, x.arguments[0])
    return None


def _subtract(g: Makes, x: Node, y: Node) -> Node | None:
    # 0 - y is not -y, which gives 0 a sign.
    if _is(y, 0):
        return x
    if y.operation == "negative":
        return g.apply("+", x, y.arguments[0])
    return None


def _multiply(g: Makes, x: Node, y: Node) -> Node | None:
    if x.operation == "constant":
        x, y = y, x
    if y.operation == "constant":
        c = y.arguments[0]
        if c == 0:
            return g.constant(0.0)
        if c == 1:
            return x
        if c == -1:
            return g.apply("negative", x)
        if x.operation == "negative":
            return g.apply("*", x.arguments[0], g.constant(-c))
    elif x.operation == "negative" and y.operation == "negative":
        return g.apply("*", x.arguments[0], y.arguments[0])
    elif x.operation == "negative" or y.operation == "negative":
        x, y = (y, x) if y.operation == "negative" else (x, y)
        return g.apply("negative", g.apply("*", x.arguments[0], y))
    return None


def _divide(g: Makes, x: Node, y: Node) -> Node | None:
    if y.operation == "constant" and y.arguments[0] != 0 and math.isfinite(1 / y.arguments[0]):
        return g.apply("*", x, g.constant(1 / y.arguments[0]))
    if _is(x, 0):
        return g.constant(0.0)
    # A second division by the same number is a multiplication: a division takes as long as ten of them.
    if not _is(x, 1) and g.divided_by(y):
        return g.apply("*", x, g.apply("/", g.constant(1.0), y))
    return None


def _negate(g: Makes, x: Node) -> Node | None:
    # -(x - y) is not y - x: the one has a sign where both are equal.
    return x.arguments[0] if x.operation == "negative" else None


def _select(g: Makes, p: Node, x: Node, y: Node) -> Node | None:
    if p.operation == "constant":
        return x if p.arguments[0] else y
    if x is y:
        return x
    if p.operation == "not":
        return g.apply("select", p.arguments[0], y, x)
    if x.truth and x.known:
        return g.apply("or", p, y) if x.value else g.apply("and", g.apply("not", p), y)
    if y.truth and y.known:
        return g.apply("or", g.apply("not", p), x) if y.value else g.apply("and", p, x)
    # A choice inside a choice by the same truth value is made already.
    if x.operation in ("select", "select truth") and x.arguments[0] is p:
        return g.apply("select", p, x.arguments[1], y)
    if y.operation in ("select", "select truth") and y.arguments[0] is p:
        return g.apply("select", p, x, y.arguments[2])
    return None


def _and(g: Makes, x: Node, y: Node) -> Node | None:
    for a, b in ((x, y), (y, x)):
        if a.operation == "constant":
            return b if a.arguments[0] else a
    return x if x is y else None


def _or(g: Makes, x: Node, y: Node) -> Node | None:
    for a, b in ((x, y), (y, x)):
        if a.operation == "constant":
            return a if a.arguments[0] else b
    return x if x is y else None


def _not(g: Makes, x: Node) -> Node | None:
    return x.arguments[0] if x.operation == "not" else None


RULES: dict[str, Any] = {
    "+": _add,
    "-": _subtract,
    "*": _multiply,
    "/": _divide,
    "negative": _negate,
    "select": _select,
    "select truth": _select,
    "and": _and,
    "or": _or,
    "not": _not,
}
