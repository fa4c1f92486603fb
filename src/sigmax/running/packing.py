"""A belief as one row of numbers: mean, lower factor row by row, and what the form carries."""

from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.native import Graph, Refused
from sigmax.native.graph import Array
from sigmax.native.node import Node
from sigmax.running.step import Belief


class Packing(NamedTuple):
    """How a belief becomes a row.

    Attributes:
        n: components of the state.
        carried: shapes of the arrays that the form carries.
        structure: how they belong together.
    """

    n: int
    carried: tuple[tuple[int, ...], ...]
    structure: Any

    @property
    def size(self) -> int:
        """Numbers in a row."""
        return self.n + self.n * (self.n + 1) // 2 + sum(len(_lower(shape)) for shape in self.carried)

    def symbols(self, g: Graph, group: str) -> list[Array]:
        """Mean, factor and carried arrays as inputs of a graph: zeros above the diagonal, symmetric where carried."""
        row = iter(g.inputs(group, (self.size,)))
        mean = np.array([next(row) for _ in range(self.n)], dtype=object)
        factor = g.constants(np.zeros((self.n, self.n)))
        for place in _lower((self.n, self.n)):
            factor[place] = next(row)
        arrays = [mean, factor]
        for shape in self.carried:
            array = np.empty(shape, dtype=object)
            for place in _lower(shape):
                array[place] = array[place[::-1]] = next(row)
            arrays.append(array)
        return arrays

    def nodes(self, arrays: list[Array]) -> list[Node]:
        """The row of a belief that was computed, checked to be as `symbols` supposes.

        Raises:
            Refused: where the factor is not triangular or a carried matrix not symmetric by construction.
        """
        mean, factor, *carried = arrays
        row = [*mean]
        for i, j in np.ndindex(self.n, self.n):
            if j > i and not (factor[i, j].known and factor[i, j].value == 0):
                raise Refused("a form whose factor is not lower triangular by construction")
        row += [factor[place] for place in _lower((self.n, self.n))]
        for array in carried:
            if any(array[place] is not array[place[::-1]] for place in _lower(array.shape)):
                raise Refused("a form that carries a matrix which is not symmetric by construction")
            row += [array[place] for place in _lower(array.shape)]
        return row

    def unpacked(self, rows: np.ndarray) -> Belief:
        """Rows (B, size) as a belief, batch last."""
        B, at = len(rows), self.n
        mean = rows[:, :at].T.copy()
        arrays: list[np.ndarray] = []
        for shape in ((self.n, self.n), *self.carried):
            places = np.array(_lower(shape)).T
            array = np.zeros((*shape, B), rows.dtype)
            values = rows[:, at : at + places.shape[1]].T
            if arrays:
                array[tuple(places[::-1])] = values
            array[tuple(places)] = values
            at += places.shape[1]
            arrays.append(array)
        return Belief(mean, arrays[0], jax.tree.unflatten(self.structure, arrays[1:]))

    def packed(self, belief: Belief) -> np.ndarray:
        """The rows of a belief, batch last, made by this form."""
        _, factor, carried = belief
        arrays = [np.asarray(factor), *map(np.asarray, jax.tree.leaves(carried))]
        parts = [np.asarray(belief.mean), *(a[tuple(np.array(_lower(a.shape[:-1])).T)] for a in arrays)]
        return np.ascontiguousarray(np.concatenate(parts).T)


def _lower(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The places of a square array on and below the diagonal, row by row; all places of another."""
    square = len(shape) == 2 and shape[0] == shape[1]
    return [place for place in np.ndindex(*shape) if not square or place[1] <= place[0]]
