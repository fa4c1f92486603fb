"""A belief as one row of numbers: the mean, then the lower factor row by row."""

from typing import NamedTuple

import numpy as np

from sigmax.native import Graph, Refused
from sigmax.native.graph import Array
from sigmax.native.node import Node
from sigmax.running.step import Belief


class Packing(NamedTuple):
    """How a belief becomes a row.

    Attributes:
        points: numbers of the mean.
        n: rows of the factor.
    """

    points: int
    n: int

    @property
    def size(self) -> int:
        """Numbers in a row."""
        return self.points + self.n * (self.n + 1) // 2

    def symbols(self, g: Graph, group: str) -> list[Array]:
        """Mean and factor as inputs of a graph, zeros above the diagonal."""
        row = g.inputs(group, (self.size,))
        factor = g.constants(np.zeros((self.n, self.n)))
        factor[np.tril_indices(self.n)] = row[self.points :]
        return [row[: self.points], factor]

    def nodes(self, arrays: list[Array]) -> list[Node]:
        """The row of a belief that was computed, checked to be as `symbols` supposes.

        Raises:
            Refused: where the factor is not triangular by construction.
        """
        mean, factor = arrays
        if any(not (node.known and node.value == 0) for node in factor[np.triu_indices(self.n, 1)]):
            raise Refused("a form whose factor is not lower triangular by construction")
        return [*mean, *factor[np.tril_indices(self.n)]]

    def unpacked(self, rows: np.ndarray) -> Belief:
        """Rows (B, size) as a belief, batch last."""
        factor = np.zeros((self.n, self.n, len(rows)), rows.dtype)
        factor[np.tril_indices(self.n)] = rows[:, self.points :].T
        return Belief(rows[:, : self.points].T.copy(), factor)

    def packed(self, belief: Belief) -> np.ndarray:
        """The rows of a belief, batch last."""
        mean, factor = (np.asarray(a) for a in belief)
        return np.ascontiguousarray(np.concatenate([mean, factor[np.tril_indices(self.n)]]).T)
