"""Equations that act on each element of one shape, in one loop: its body is a graph of scalar operations."""

import itertools
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.native.emit import constant
from sigmax.native.graph import Graph, boxed
from sigmax.native.loops.text import Lines
from sigmax.native.loops.views import View, Walk, fused, known_walk, walk
from sigmax.native.node import Node
from sigmax.native.pieces import needed
from sigmax.native.primitives.integers import bounded
from sigmax.native.primitives.interpret import apply_rule
from sigmax.native.primitives.intervals import interval


class Element:
    """An array whose elements a loop makes that is not written yet.

    Attributes:
        group: the loop.
        node: what it makes for each element.
        like: what it will be, but for where it lies.
        view: where it lies, once it is written.
    """

    def __init__(self, group: "Group", node: Node, zero: np.ndarray | None, bounds: tuple[float, float] | None) -> None:
        self.group, self.node, self.zero, self.bounds = group, node, zero, bounds
        self.view: View | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array."""
        return self.group.shape


class Group:
    """A loop over the elements of one shape.

    Args:
        shape: that of everything in it.
        dtype: of its numbers.
        label: what it belongs to.
    """

    def __init__(self, shape: tuple[int, ...], dtype: Any, label: str) -> None:
        self.shape, self.label, self.graph = shape, label, Graph(dtype)
        self._read: list[View | np.ndarray] = []
        self._walks: list[Walk] = []
        self._places: dict[Any, int] = {}
        self._elements: list[weakref.ref[Element]] = []
        self._stores: list[tuple[Node, View]] = []

    def node(self, value: Any) -> Node:
        """An element of an array, or of something that this loop makes."""
        g = self.graph
        if isinstance(value, Element):
            return value.node
        if isinstance(value, np.ndarray):
            first = value.flat[0]
            if (value == first).all() or (value != value).all():
                return g.constant(first)
            numbers, steps = known_walk(value)
            key: Any = (numbers.tobytes(), steps.axes)
            place = self._place(key, numbers, steps)
            node, truth = g.input("known", place), value.dtype == bool
            if value.dtype.kind in "iu":
                bounded(g, node, float(value.min()), float(value.max()) + 1)
        else:
            steps = walk(value.at)
            table = None if steps.table is None else steps.table.tobytes()
            place = self._place((id(value.buffer), steps.start, steps.axes, table), value, steps)
            node, truth = g.input("read", place), value.truth
            if value.bounds is not None:
                bounded(g, node, value.bounds[0], value.bounds[1] + 1)
        return g.apply("!=", node, g.constant(0.0)) if truth else node

    def _place(self, key: Any, what: View | np.ndarray, steps: Walk) -> int:
        if key not in self._places:
            self._places[key] = len(self._read)
            self._read.append(what)
            self._walks.append(steps)
        return self._places[key]

    def made(self, equation: Any, values: Sequence[Any]) -> list[Any]:
        """The results of an equation of arrays of this shape, known numbers among them."""
        nodes = [self.node(v) for v in values]
        zeros = [_zeros(v) for v in values]
        results = apply_rule(self.graph, equation, [boxed(n) for n in nodes])
        masks = self._zero_by_construction(equation, nodes, zeros, len(results))
        out = []
        for variable, result, zero in zip(equation.outvars, results, masks, strict=True):
            whole = variable.aval.dtype.kind in "iu"
            node = self.graph.opened(result)[()]
            node = self.graph.certain(node) if whole else node
            bounds = interval(self.graph, node)
            told = whole or bool(np.isfinite(bounds).all())
            out.append(self._result(node, values, zero, bounds if told else None, variable))
        return out

    def _result(self, node: Node, values: Sequence[Any], zero: Any, bounds: Any, variable: Any) -> Any:
        if node.known or (zero is not None and zero.all()):
            return np.full(self.shape, node.value if node.known else 0, variable.aval.dtype)
        if node.operation == "input" and node.arguments[0] == "read":
            return next(v for v in values if not isinstance(v, np.ndarray) and self.node(v) is node)
        return self.element(node, zero, bounds)

    def element(self, node: Node, zero: np.ndarray | None = None, bounds: tuple[float, float] | None = None) -> Element:
        """The array of all that a node is."""
        element = Element(self, node, zero, bounds)
        self._elements.append(weakref.ref(element))
        return element

    def _zero_by_construction(
        self, equation: Any, nodes: Sequence[Node], zeros: Sequence[np.ndarray | None], count: int
    ) -> list[np.ndarray | None]:
        """Where results are 0 because arguments are, found by the rule itself."""
        found: list[np.ndarray | None] = [None] * count
        having = [i for i, zero in enumerate(zeros) if zero is not None]
        for k in range(1, len(having) + 1):
            for chosen in itertools.combinations(having, k):
                mask = np.logical_and.reduce([zero for i, zero in enumerate(zeros) if i in chosen and zero is not None])
                if not mask.any():
                    continue
                nothing = [self._nothing(n) if i in chosen else n for i, n in enumerate(nodes)]
                for r, result in enumerate(apply_rule(self.graph, equation, [boxed(n) for n in nothing])):
                    node = self.graph.opened(result)[()]
                    if node.known and not node.value:
                        known = found[r]
                        found[r] = mask if known is None else known | mask
        return found

    def _nothing(self, like: Node) -> Node:
        return self.graph.constant(False if like.truth else 0.0)

    def store(self, node: Node, to: View) -> None:
        """Write what a node is to places that nobody has read."""
        self._stores.append((node, to))
        if self not in to.buffer.writers:
            to.buffer.writers.append(self)

    def written(self, lines: Lines) -> None:
        """Write the loop; what is still wanted of it is kept."""
        stores = list(self._stores)
        kept: dict[int, View] = {}
        for element in filter(None, (r() for r in self._elements)):
            if element.node.index not in kept:
                kept[element.node.index] = lines.new(self.shape, element.node.truth)
                stores.append((element.node, kept[element.node.index]))
            element.view = kept[element.node.index]._replace(zero=element.zero, bounds=element.bounds)
        for _, to in self._stores:
            if self in to.buffer.writers:
                to.buffer.writers.remove(self)
        if stores and 0 not in self.shape:
            self._loop(lines, stores)
        self._read, self._stores = [], []

    def _loop(self, lines: Lines, stores: Sequence[tuple[Node, View]]) -> None:
        work = needed([node for node, _ in stores])
        places = [n.arguments[1] for n in work if n.operation == "input"]
        sizes, walks = fused(self.shape, [*(self._walks[p] for p in places), *(walk(to.at) for _, to in stores)])
        indices = [f"i{d}" for d in range(len(sizes))]
        read = dict(zip(places, walks, strict=False))
        names: dict[int, str] = {}
        body = []
        for n in work:
            names[n.index] = f"t{n.index}"
            if n.known:
                names[n.index] = constant(n)
            elif n.operation == "input":
                place = n.arguments[1]
                what, steps = self._read[place], read[place]
                if isinstance(what, View):
                    text = lines.element(what.buffer, steps, indices)
                else:
                    text = f"K({lines.text.table(what, 'R')}[{lines.place(steps, indices)}])"
                body.append(f"const V t{n.index} = {text};")
            else:
                text = lines.text.spelled(n, [names[a.index] for a in n.inputs])
                body.append(f"const {'M' if n.truth else 'V'} t{n.index} = {text};")
        for (node, to), steps in zip(stores, walks[len(places) :], strict=True):
            value = f"v_number({names[node.index]})" if node.truth else names[node.index]
            body.append(f"{lines.element(to.buffer, steps, indices)} = {value};")
        lines.nest(sizes, body, self.label)


def _zeros(value: Any) -> np.ndarray | None:
    """Where an array is 0 by construction, None if it is not."""
    if not isinstance(value, np.ndarray):
        return value.zero if value.zero is None or value.zero.any() else None
    zero = value == 0
    return zero if zero.any() and not zero.all() else None
