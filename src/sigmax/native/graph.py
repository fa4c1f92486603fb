"""A step as a graph of scalar operations: known numbers folded, equal expressions made once."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.refusal import Refused
from sigmax.native.simplify import RULES

# Of NumPy: nodes (dtype object), or known numbers in the type that JAX gives them. Also a known array of JAX that NumPy
# has no type for.
Array = Any

# A map has millions of known numbers: no node for each.
_MOST_OPENED = 1_000_000


def boxed(made: Any) -> Array:
    """An array as it is, a single node as an array without axes: NumPy unpacks those."""
    if not isinstance(made, Node):
        return made if hasattr(made, "dtype") and hasattr(made, "reshape") else np.asarray(made)
    array = np.empty((), dtype=object)
    array[()] = made
    return array


def array_of(nodes: Iterable[Node]) -> Array:
    """Nodes as an array of one axis, also where there are none."""
    return np.fromiter(nodes, dtype=object)


def numbers_of(value: Any, dtype: Any) -> Array:
    """A known value in the type that JAX gives it.

    Raises:
        Refused: for a number that is known at a later time alone.
    """
    if isinstance(value, jax.core.Tracer):
        raise Refused("a number from outside that is being traced cannot be lowered to C")
    return value if jnp.issubdtype(dtype, jax.dtypes.extended) else np.asarray(value, dtype)


class Graph:
    """The nodes made so far.

    Attributes:
        nodes: in an order in which each comes after what it reads.
        tables: known numbers that are looked up by computed indices.
        dtype: of its numbers, float64 or float32.
        exact: integers up to this size are held exactly by numbers of this type.
        uncertain: by index, integers that may have overflowed, and what is right where they have; None if nothing is.
        intervals: between which numbers the nodes lie, as far as it was asked: see `interval`.
        choices: by index, truth values by which whole functions are chosen: see `choices`.
        label: what new nodes belong to.

    Args:
        dtype: of its numbers.
    """

    def __init__(self, dtype: Any = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.exact = 2.0 ** (np.finfo(self.dtype).nmant + 1)
        self.uncertain: dict[int, Node | None] = {}
        self.intervals: list[tuple[float, float]] = []
        self.nodes: list[Node] = []
        self.tables: list[np.ndarray] = []
        self.choices: set[int] = set()
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
        if self.dtype != np.float64:
            with np.errstate(over="ignore"):
                number = float(self.dtype.type(number))
        return self._node((float, number.hex()), "constant", (number,), False, True)

    def input(self, group: str, place: int, fixed: bool = False) -> Node:
        """Number `place` of a group of inputs; `fixed` for what stays the same over all steps."""
        return self._node((group, place), "input", (group, place), False, fixed)

    def inputs(self, group: str, shape: tuple[int, ...], fixed: bool = False) -> Array:
        """A whole group as an array, counted row by row."""
        made = [self.input(group, i, fixed) for i in range(math.prod(shape))]
        return array_of(made).reshape(shape)

    def constants(self, values: Any) -> Array:
        """Known numbers as an array of nodes."""
        return boxed(np.frompyfunc(self.constant, 1, 1)(np.asarray(values)))

    def opened(self, array: Array) -> Array:
        """An array with a node for each number, also of known numbers.

        Raises:
            Refused: for numbers of another type, or too many of them.
        """
        if array.dtype == object:
            return array
        if array.size > _MOST_OPENED:
            raise Refused(f"arithmetic on all of {array.size:,} known numbers cannot be lowered to C")
        self.check_type(array.dtype, any_width=True)
        if array.dtype.kind in "iu" and array.size and max(abs(int(array.min())), abs(int(array.max()))) > self.exact:
            raise Refused(f"integers beyond {self.exact:.0f} cannot be lowered to C")
        return self.constants(array)

    def alike(self, arrays: Sequence[Array]) -> list[Array]:
        """Arrays as they are if all are known numbers, else opened."""
        if all(a.dtype != object for a in arrays):
            return list(arrays)
        return [self.opened(a) for a in arrays]

    def known(self, array: Array, dtype: Any) -> Array:
        """An array of nodes as numbers of this type if all are known, else as it is."""
        if array.dtype != object or not all(x.operation == "constant" for x in array.flat):
            return array
        return np.array([x.arguments[0] for x in array.flat], np.dtype(dtype)).reshape(array.shape)

    def check_type(self, dtype: Any, any_width: bool = False) -> None:
        """Let through floats, integers and truth values.

        Floats are computed in the type of the graph, which may be narrower than JAX's, never wider: rounding to less
        is what somebody asks for. Of `any_width` they may be where they stay as they are.

        Raises:
            Refused: for any other type.
        """
        kind = getattr(dtype, "kind", "V")
        if kind == "f" and not any_width and dtype.itemsize < self.dtype.itemsize:
            raise Refused(f"numbers of type {dtype} among those of type {self.dtype} cannot be lowered to C")
        if kind not in "fiub":
            raise Refused(f"numbers of type {dtype} cannot be lowered to C")

    def certain(self, integer: Node) -> Node:
        """An integer that is right also where it has overflowed.

        Raises:
            Refused: where there is none.
        """
        found = self.uncertain.get(integer.index, integer)
        if found is None:
            raise Refused(f"integers that may grow beyond {self.exact:.0f} cannot be lowered to C")
        return found

    def known_numbers(self, array: Array) -> np.ndarray | None:
        """The numbers of an array, row by row; None where one of them is computed."""
        if id(array) not in self._numbers:
            if array.dtype != object:
                self.check_type(array.dtype, any_width=True)
                found = array.ravel()
            else:
                known = all(x.operation == "constant" for x in array.flat)
                found = np.array([float(x.value) for x in array.flat]) if known else None
            self._numbers[id(array)] = array, found
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

        The one exception is 0 · x = 0, which makes the zeros of a factor structural; the sign of a zero is not kept
        where a known zero is added or multiplied.
        """
        if operation == "select" and arguments[1].truth:
            operation = "select truth"
        if self.uncertain and operation == "select":
            return self._chosen(*arguments)
        return self._applied(operation, *arguments)

    def _chosen(self, p: Node, x: Node, y: Node) -> Node:
        """A choice is uncertain where a chosen integer may be."""
        y = self.uncertain.get(y.index, y) or y
        # Of an index counted from the end nothing overflows where it is chosen.
        back = p.operation == "<" and p.arguments[0] is y and p.arguments[1].known and p.arguments[1].value == 0
        back = back and x.operation == "+" and y in x.arguments and any(a.known and a.value >= 0 for a in x.arguments)
        x = x if back else self.uncertain.get(x.index, x) or x
        made = self._applied("select", p, x, y)
        if not made.known and ((not back and x.index in self.uncertain) or y.index in self.uncertain):
            self.uncertain[made.index] = None
        return made

    def _applied(self, operation: str, *arguments: Node) -> Node:
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
