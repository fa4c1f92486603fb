"""A belief as one row of numbers: the mean, then the lower factor row by row; of several beliefs, theirs behind it."""

from itertools import starmap
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.filters import Bank, Filter, FromInformation
from sigmax.mixtures.mixture import MixtureBelief
from sigmax.modelling.model import Model
from sigmax.native import Graph, Refused
from sigmax.native.graph import Array
from sigmax.native.node import Node
from sigmax.preparation.joining import modes_of
from sigmax.steps.adaptive_noises import AdaptiveBelief, adapted_noises
from sigmax.steps.information_steps import numbers_of_start
from sigmax.steps.step import Belief


class Packing(NamedTuple):
    """How a belief becomes a row.

    Attributes:
        points: numbers of the mean.
        n: rows of the factor.
        members: the packing of each mode or member of a bank, whose logarithms of probabilities end the row; none for a
            filter of one belief.
        known: numbers of what else a filter knows, which end the row: of noises that it finds, of an open start.
    """

    points: int
    n: int
    members: tuple["Packing", ...] = ()
    known: int = 0

    @classmethod
    def of(cls, filter: Filter, model: Model) -> "Packing":
        """That of the beliefs of a filter on a model."""
        own = cls(model.space.size, model.space.dim)
        if isinstance(filter, Bank):
            return own._replace(members=(own,) * filter.kept)
        if isinstance(filter, FromInformation):
            return own._replace(known=numbers_of_start(own.n))
        each = modes_of(filter, model)
        if len(each) == 1:
            return own._replace(known=adapted_noises(filter, model).size)
        return own._replace(members=tuple(starmap(cls.of, each)))

    @property
    def head(self) -> int:
        """Numbers of the mean and the factor themselves."""
        return self.points + self.n * (self.n + 1) // 2

    @property
    def size(self) -> int:
        """Numbers in a row."""
        return self.head + sum(m.size for m in self.members) + self.tail

    @property
    def tail(self) -> int:
        """Numbers that end a row: nothing stands behind the factor where there are none."""
        return len(self.members) + self.known

    @property
    def length(self) -> int:
        """Arrays of a belief, one after the other."""
        return 2 + 2 * len(self.members) + bool(self.tail)

    def belief(self, arrays: Any) -> Any:
        """The belief of its arrays."""
        if not self.members:
            return AdaptiveBelief(*arrays) if self.known else Belief(*arrays)
        pairs = zip(arrays[2:-1:2], arrays[3:-1:2], strict=True)
        return MixtureBelief(arrays[0], arrays[1], tuple(Belief(*pair) for pair in pairs), arrays[-1])

    def arrays(self, belief: Any) -> list[Any]:
        """The arrays of a belief."""
        if not self.members:
            return list(belief)
        return [belief.mean, belief.factor, *(a for mode in belief.members for a in mode), belief.log_weight]

    def symbols(self, g: Graph, group: str) -> list[Array]:
        """The arrays as inputs of a graph, zeros above diagonals."""
        return self._split(g.inputs(group, (self.size,)), lambda n: g.constants(np.zeros((n, n))))

    def _split(self, row: Any, zeros: Any) -> list[Any]:
        factor = zeros(self.n)
        factor[np.tril_indices(self.n)] = row[self.points : self.head]
        found, at = [row[: self.points], factor], self.head
        for mode in self.members:
            found += mode._split(row[at : at + mode.size], zeros)
            at += mode.size
        return [*found, row[at:]] if self.tail else found

    def nodes(self, arrays: list[Array]) -> list[Node]:
        """The row of a belief that was computed, checked to be as `symbols` supposes.

        Raises:
            Refused: where a factor is not triangular by construction.
        """
        made: list[Node] = []
        for packing, mean, factor in self._each(arrays):
            if any(not (node.known and node.value == 0) for node in factor[np.triu_indices(packing.n, 1)]):
                raise Refused("a form whose factor is not lower triangular by construction")
            made += [*mean, *factor[np.tril_indices(packing.n)]]
        return [*made, *arrays[-1]] if self.tail else made

    def _each(self, arrays: list[Any]) -> list[tuple["Packing", Any, Any]]:
        """Each mean and factor with its packing."""
        return list(zip((self, *self.members), arrays[: self.length - bool(self.tail) : 2], arrays[1::2], strict=True))

    def unpacked(self, rows: np.ndarray) -> Any:
        """Rows (B, size) as a belief, batch last."""
        return self.belief(self._split(rows.T.copy(), lambda n: np.zeros((n, n, len(rows)), rows.dtype)))

    def packed(self, belief: Any) -> np.ndarray:
        """The rows of a belief, batch last."""
        return np.ascontiguousarray(np.asarray(self._row(belief, 0)).T)

    def rest(self, belief: Any) -> Any:
        """What stands behind the mean and the factor (k, ...) in the row of a belief."""
        return self._row(belief, 1)

    def _row(self, belief: Any, first: int) -> Any:
        arrays = self.arrays(belief)
        made = [part for p, m, S in self._each(arrays)[first:] for part in (m, S[np.tril_indices(p.n)])]
        return jnp.concatenate([*made, *([arrays[-1]] if self.tail else [])])

    def behind(self, rest: Any) -> list[Any]:
        """The arrays of what stands behind the mean and the factor, over time (T, k, ...)."""
        found, at = [], 0
        for mode in self.members:
            mean, lower = rest[:, at : at + mode.points], rest[:, at + mode.points : at + mode.size]
            factor = jnp.zeros((len(rest), mode.n, mode.n, *rest.shape[2:]), rest.dtype)
            i, j = np.tril_indices(mode.n)
            found += [mean, factor.at[:, i, j].set(lower)]
            at += mode.size
        return [*found, rest[:, at:]] if self.tail else []
