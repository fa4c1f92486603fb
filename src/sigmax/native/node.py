"""One scalar operation, and what makes more of them."""

from typing import Any, Protocol

from sigmax.native.operations import OPERATIONS


class Node:
    """One scalar: an input, a known number, an element of a table, or an operation on other nodes.

    Attributes:
        operation: a key of `OPERATIONS`, "constant", "input" or "table".
        arguments: nodes; of a constant its value, of an input its group and place, of a table its
            number and the node of the index.
        index: position in the graph, after all its arguments.
        truth: whether it is a truth value.
        fixed: whether it depends on nothing but known numbers and fixed inputs.
        label: what it belongs to, for readers of the C.
    """

    __slots__ = ("arguments", "fixed", "index", "label", "operation", "truth")

    def __init__(
        self, operation: str, arguments: tuple[Any, ...], index: int, truth: bool, fixed: bool, label: str
    ) -> None:
        self.operation, self.arguments, self.index = operation, arguments, index
        self.truth, self.fixed, self.label = truth, fixed, label

    @property
    def known(self) -> bool:
        """Whether it is a number."""
        return self.operation == "constant"

    @property
    def value(self) -> Any:
        """The number of a constant."""
        return self.arguments[0]

    @property
    def inputs(self) -> tuple["Node", ...]:
        """The nodes it reads."""
        if self.operation in OPERATIONS:
            return self.arguments
        return self.arguments[1:] if self.operation == "table" else ()

    def __repr__(self) -> str:
        return f"{self.value}" if self.known else f"{self.operation}#{self.index}"


class Makes(Protocol):
    """A graph, as far as a rule needs to know it."""

    def constant(self, value: Any) -> Node:
        """A known number or truth value."""

    def apply(self, operation: str, *arguments: Node) -> Node:
        """An operation on nodes, as simple as the rules make it."""

    def divided_by(self, denominator: Node) -> bool:
        """Whether something has been divided by this before; remembered from now on."""
