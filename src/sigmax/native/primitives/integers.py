"""Integers as numbers: exact in their width, or refused.

A number of float64 holds every integer up to 2⁵³. `interval` tells which ones stay below: they are computed as they
are, and brought back into a narrow type where they overflow it. A float beyond that becomes an integer of which no
more is known than that it is large (JAX takes the nearest one of the type): it may be compared with smaller ones,
limited, moved by a known number, and made a float again. All else with it is refused.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from sigmax.native.graph import Array, Graph
from sigmax.native.node import Node
from sigmax.native.primitives.intervals import interval
from sigmax.native.refusal import Refused

# Numbers up to this vanish beside the limits of the widest types.
_STEP = 500

Binary = Callable[[Node, Node], Node]


def limits(dtype: Any) -> tuple[float, float]:
    """The least number of a type, and the first one beyond it."""
    about = np.iinfo(dtype)
    return float(about.min), float(about.max // 2 + 1) * 2


def exact(g: Graph, *nodes: Node) -> bool:
    """Whether all are held exactly."""
    return all(-g.exact <= low and high <= g.exact for low, high in (interval(g, n) for n in nodes))


def _small(g: Graph, *nodes: Node) -> bool:
    return all(-g.exact / 2 <= low and high <= g.exact / 2 for low, high in (interval(g, n) for n in nodes))


def check_exact(g: Graph, *nodes: Node) -> None:
    """Let through integers that are held exactly.

    Raises:
        Refused: for others.
    """
    if not exact(g, *nodes) or any(n.index in g.uncertain for n in nodes):
        raise Refused(f"arithmetic on integers that may lie beyond {g.exact:.0f} cannot be lowered to C")


def held(g: Graph, node: Node, dtype: Any) -> Node:
    """The result of exact arithmetic as an integer of a type: where it overflows it goes round."""
    low, high = interval(g, node)
    least, beyond = limits(dtype)
    if not exact(g, node):
        g.uncertain[node.index] = None
        return node
    if least <= low and high < beyond:
        return node
    apply, width = g.apply, beyond - least
    if width > 2 * g.exact or not _small(g, node):
        g.uncertain[node.index] = None
        return node
    turns = apply("floor", apply("*", apply("-", node, g.constant(least)), g.constant(1 / width)))
    return bounded(g, apply("-", node, apply("*", turns, g.constant(width))), least, beyond)


def bounded(g: Graph, node: Node, least: float, beyond: float) -> Node:
    """A node of which more is known than its operations tell."""
    interval(g, node)
    low, high = g.intervals[node.index]
    g.intervals[node.index] = max(low, least), min(high, beyond - 1)
    return node


def arithmetic(g: Graph, operation: str, dtype: Any) -> Binary:
    """Addition, subtraction or multiplication of integers of a type."""

    def apply(x: Node, y: Node) -> Node:
        x, y = g.certain(x), g.certain(y)
        made = g.apply(operation, x, y)
        if exact(g, x, y):
            return held(g, made, dtype)
        if made.index not in g.uncertain and made is not x and made is not y and not made.known:
            g.uncertain[made.index] = _moved(g, operation, x, y, dtype)
        return made

    return apply


def _moved(g: Graph, operation: str, x: Node, y: Node, dtype: Any) -> Node | None:
    """A large signed integer plus a known number: the one at the limit of its type, for all beyond it, goes round."""
    least, beyond = limits(dtype)
    if operation == "+" and x.known:
        x, y = y, x
    if operation not in ("+", "-") or not y.known or least == 0 or abs(y.value) > _STEP or not is_nearest(g, x):
        return None
    step = y.value if operation == "+" else -y.value
    over = g.apply(">=", x, g.constant(beyond)) if step > 0 else g.apply("<=", x, g.constant(least))
    return g.apply("select", over, g.constant(least if step > 0 else beyond), g.apply("+", x, g.constant(step)))


def is_nearest(g: Graph, node: Node) -> bool:
    """Whether it stands for the nearest integer of its type, and has not been moved yet."""
    return node.operation in ("integer", "max", "min") and node.index not in g.uncertain


def each_integer(g: Graph, operation: str, dtype: Any) -> Callable[..., Array]:
    """Arithmetic over arrays of integers."""
    return np.frompyfunc(arithmetic(g, operation, dtype), 2, 1)


def compared(g: Graph, operation: str, x: Node, y: Node) -> Node:
    """A comparison of integers, of which one at most is large; also max and min.

    Raises:
        Refused: where both are.
    """
    x, y = g.certain(x), g.certain(y)
    if not (exact(g, x, y) or _small(g, x) or _small(g, y)) and x is not y:
        raise Refused(f"integers that both may lie beyond {g.exact:.0f} cannot be lowered to C")
    (a, b), (c, d) = interval(g, x), interval(g, y)
    if operation in ("max", "min"):
        if b <= c or d <= a:
            return x if (b <= c) == (operation == "min") else y
        return g.apply(operation, x, y)
    decided = {"<": (b < c, a >= d), "<=": (b <= c, a > d), ">": (a > d, b <= c), ">=": (a >= d, b < c)}
    for truth, sure in zip((True, False), decided.get(operation, ()), strict=False):
        if sure:
            return g.constant(truth)
    return g.apply(operation, x, y)


def combining(g: Graph, operation: str, dtype: Any) -> Binary:
    """An operation of two integers of a type."""
    return functools.partial(compared, g, operation) if operation in ("max", "min") else arithmetic(g, operation, dtype)
