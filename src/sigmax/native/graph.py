"""A step as a graph of scalar operations: known numbers folded, equal expressions made once."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.refusal import Refused
from sigmax.native.simplify import RULES

Array = Any  # of NumPy, dtype object: nodes; or a Table

# Known numbers in greater number are kept as a table, not as nodes: a map has millions.
_MOST_NODES, _MOST_OPENED = 2048, 1_000_000


class Table(np.ndarray):
    """Known numbers, float64, that stay numbers as long as they are only looked up or moved about."""


def boxed(made: Any) -> Array:
    """An array as it is, a single node as an array without axes: NumPy unpacks those."""
    if isinstance(made, np.ndarray):
        return made
    array = np.empty((), dtype=object)
    array[()] = made
    return array


def array_of(nodes: Iterable[Node]) -> Array:
    """Nodes as an array of one axis, also where there are none."""
    return np.fromiter(nodes, dtype=object)


class Graph:
    """The nodes made so far.

    Attributes:
        nodes: in an order in which each comes after what it reads.
        tables: known numbers that are looked up by computed indices.
        label: what new nodes belong to.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.tables: list[np.ndarray] = []
        self.label = ""
        self._made: dict[Any, Node] = {}
        self._denominators: set[int] = set()
        # By identity, the array being kept alive: maps are large, and are looked up many times.
        self._numbers: dict[int, tuple[Array, np.ndarray | None]] = {}

    def _node(self, key: Any, operation: str, arguments: tuple[Any, ...], truth: bool, fixed: bool) -> Node:
        node = self._made.get(key)
        if node is None:
            node = Node(operation, arguments, len(self.nodes), truth, fixed, self.label)
            self._made[key] = node
            self.nodes.append(node)
        return node

    def constant(self, value: Any) -> Node:
        """A known number or truth value."""
        if isinstance(value, bool | np.bool_):
            return self._node((bool, bool(value)), "constant", (bool(value),), True, True)
        number = float(value)
        return self._node((float, number.hex()), "constant", (number,), False, True)

    def input(self, group: str, place: int, fixed: bool = False) -> Node:
        """Number `place` of a group of inputs; `fixed` for what stays the same over all steps."""
        return self._node((group, place), "input", (group, place), False, fixed)

    def inputs(self, group: str, shape: tuple[int, ...], fixed: bool = False) -> Array:
        """A whole group as an array, counted row by row."""
        made = [self.input(group, i, fixed) for i in range(math.prod(shape))]
        return array_of(made).reshape(shape)

    def constants(self, values: Any) -> Array:
        """An array of known numbers, a `Table` where there are many."""
        given = np.asarray(values)
        if given.size > _MOST_NODES and given.dtype != bool:
            return np.ascontiguousarray(given, float).view(Table)
        return boxed(np.frompyfunc(self.constant, 1, 1)(given))

    def opened(self, array: Array) -> Array:
        """An array with a node for each number, also of a table.

        Raises:
            Refused: for a table that is too large for it.
        """
        if not isinstance(array, Table):
            return array
        if array.size > _MOST_OPENED:
            raise Refused(f"arithmetic on all of {array.size:,} known numbers cannot be lowered to C")
        return boxed(np.frompyfunc(self.constant, 1, 1)(array.view(np.ndarray)))

    def known_numbers(self, array: Array) -> np.ndarray | None:
        """The numbers of an array of constants, row by row; None where one of them is computed."""
        if isinstance(array, Table):
            return self._numbers.setdefault(id(array), (array, array.view(np.ndarray).ravel()))[1]
        if id(array) not in self._numbers:
            known = all(x.operation == "constant" for x in array.flat)
            self._numbers[id(array)] = array, np.array([float(x.value) for x in array.flat]) if known else None
        return self._numbers[id(array)][1]

    def divided_by(self, denominator: Node) -> bool:
        """Whether something has been divided by this before; remembered from now on."""
        before = denominator.index in self._denominators
        self._denominators.add(denominator.index)
        return before

    def look_up(self, table: np.ndarray, index: Node) -> Node:
        """An element of a table at a computed index, which must lie inside."""
        known = (other is table or np.array_equal(other, table, equal_nan=True) for other in self.tables)
        number = next((i for i, same in enumerate(known) if same), len(self.tables))
        if number == len(self.tables):
            self.tables.append(table)
        return self._node(("table", number, index.index), "table", (number, index), False, index.fixed)

    def apply(self, operation: str, *arguments: Node) -> Node:
        """An operation on nodes, simplified where numbers are known; NaN is not reasoned away.

        The one exception is 0 · x = 0, which makes the zeros of a factor structural.
        """
        if operation == "select" and arguments[1].truth:
            operation = "select truth"
        known = self._made.get((operation, *(a.index for a in arguments)))
        if known is not None:
            return known
        simpler = self._simplified(operation, arguments)
        if simpler is not None:
            return simpler
        about = OPERATIONS[operation]
        if about.commutes and arguments[0].index > arguments[1].index:
            arguments = (arguments[1], arguments[0])
        key = (operation, *(a.index for a in arguments))
        return self._node(key, operation, arguments, about.truth, all(a.fixed for a in arguments))

    def _simplified(self, operation: str, a: tuple[Node, ...]) -> Node | None:
        if all(x.operation == "constant" for x in a):
            with np.errstate(all="ignore"):
                return self.constant(OPERATIONS[operation].fold(*(x.arguments[0] for x in a)))
        rule = RULES.get(operation)
        simpler = rule(self, *a) if rule is not None else None
        return simpler if simpler is not None else self._into_branches(operation, a)

    def _into_branches(self, operation: str, a: tuple[Node, ...]) -> Node | None:
        """f(select(p, x, y), c) = select(p, f(x, c), f(y, c)) where all but p is fixed: nothing is left to compute."""
        if operation.startswith("select") or operation in ("and", "or", "xor", "not"):
            return None
        choices = [x for x in a if x.operation == "select"]
        if len(choices) != 1:
            return None
        choice = choices[0]
        p, x, y = choice.arguments
        if not (x.fixed and y.fixed and all(b.fixed for b in a if b is not choice)):
            return None
        if not (x.known or y.known):
            return None
        branches = (self.apply(operation, *(w if b is choice else b for b in a)) for w in (x, y))
        return self.apply("select", p, *branches)
