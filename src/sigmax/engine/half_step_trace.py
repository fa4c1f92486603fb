"""A half-step that was traced, and whether it becomes a straight line or loops."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jax.extend.core import ClosedJaxpr

from sigmax.native import Graph, Program, Refused, evaluate
from sigmax.native.graph import Array
from sigmax.native.loops import Loops, flat, operations, written
from sigmax.native.machine import vector_functions
from sigmax.native.node import Node

# About so many scalar operations are compiled in less time, and run in less, as a straight line than as loops.
LONGEST = 25_000
# And so many where most of them stand on sides of choices, which loops do not leave out.
_LONGEST_CHOSEN = 160_000


class HalfStepTrace(NamedTuple):
    """A half-step that was traced.

    Attributes:
        graph: that of its arguments.
        inputs: their groups.
        function: of the arguments.
        arguments: as arrays of nodes.
        made: results as arrays of nodes -> nodes of each group of outputs.
    """

    graph: Graph
    inputs: Sequence[str]
    function: ClosedJaxpr
    arguments: Sequence[Array]
    made: Callable[[list[Array]], Mapping[str, Sequence[Node]]]

    def straight(self) -> Program:
        """It as one straight line.

        Raises:
            Refused: for what cannot be lowered.
        """
        # Constants are folded to what the compiled code would compute, infinities and all.
        with np.errstate(all="ignore"):
            return Program(self.graph, self.inputs, self.made(evaluate(self.graph, self.function, self.arguments)))

    def loops(self) -> Loops:
        """It as loops.

        Raises:
            Refused: for what cannot be lowered.
        """
        vectors = vector_functions(self.graph.dtype == np.float32)
        with np.errstate(all="ignore"):
            return written(flat(self.function), self.arguments, self.inputs, self.made, self.graph.dtype, vectors)

    def chosen(self, longest: float) -> Program | Loops:
        """Loops where it takes more operations than so many, and where they cover it; else a straight line.

        Raises:
            Refused: for what cannot be lowered.
        """
        try:
            every = operations(self.function)
            chosen = longest < every < _LONGEST_CHOSEN and operations(self.function, choices=False) < every / 2
            if every > longest and not chosen:
                return self.loops()
        except Refused:
            # Where a straight line cannot be had either, it says why.
            pass
        return self.straight()
