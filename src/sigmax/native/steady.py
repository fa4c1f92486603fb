"""A graph of what a step computes as long as its choices stay as they are: more of it is fixed then."""

from typing import Any

from sigmax.native.graph import Graph
from sigmax.native.node import Node


class SteadyGraph(Graph):
    """Supposes that what is computed is finite, that nothing is missing, and that fixed bounds hold.

    Attributes:
        supposed: truth values, which are all true where that is so: else nothing that was computed is to be used.
    """

    def __init__(self, dtype: Any) -> None:
        super().__init__(dtype)
        self.supposed: list[Node] = []

    def _simplified(self, operation: str, a: tuple[Node, ...]) -> Node | None:
        if operation == "finite" and not a[0].fixed:
            return self._suppose(True, "finite", *a)
        if operation in ("!=", "==") and a[0] is a[1] and not a[0].fixed:
            return self._suppose(operation == "==", "==", *a)
        if operation in ("max", "min") and a[0].fixed != a[1].fixed:
            bound, other = a if a[0].fixed else a[::-1]
            self._suppose(True, "<=", *((other, bound) if operation == "max" else (bound, other)))
            return bound
        return super()._simplified(operation, a)

    def _suppose(self, answer: bool, operation: str, *a: Node) -> Node:
        # By itself: what is asked for here would be answered as what is supposed.
        key = ("supposed", operation, *(x.index for x in a))
        if key not in self._made:
            self.supposed.append(self._node(key, operation, a, True, False))
        return self.constant(answer)
