"""Which components of its argument each intermediate result of a function reads, whether linearly, and its cost."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.kernel import kernels
from sigmax.dependence.line import Call, Line, straightened
from sigmax.native import Defect, Graph, Refused
from sigmax.native.graph import Array, array_of, boxed, numbers_of
from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.pieces import needed
from sigmax.native.primitives.interpret import apply_rule
from sigmax.native.refusal import say_once

# Scalar operations in units of a multiplication.
_COSTS = {"/": 5.0, "sqrt": 6.0, "table": 5.0, "atan2": 40.0, "pow": 40.0, "fmod": 30.0}
_FUNCTION = 20.0
# What cannot be seen into is taken to be costly.
OPAQUE = 1000.0


class Part(NamedTuple):
    """A part of a function: all its operations that read the same components.

    Attributes:
        reads: the components, counted from 0, in rising order.
        cost: of one evaluation, in multiplications.
        what: in words.
    """

    reads: tuple[int, ...]
    cost: float
    what: str = ""


class Masks(NamedTuple):
    """The components that a value reads, and those of them that do not enter it as a straight line: bit by bit."""

    reads: int
    nonlinear: int


class Reading(NamedTuple):
    """What a function reads.

    Attributes:
        line: the function itself, equation by equation.
        size: n, of the argument.
        results: the scalar operation behind each component of the result.
        masks: of each scalar operation, by its index.
        places: masks of each place of the line: all its elements together.
        carries: by place, the components that enter some element as a straight line; all bits where an
            element is linear altogether.
        opaque: cost of what cannot be seen into, by the index of its first element.
    """

    line: Line
    size: int
    results: tuple[Node, ...]
    masks: Sequence[Masks]
    places: Mapping[int, Masks]
    carries: Mapping[int, int]
    opaque: Mapping[int, float]

    @property
    def nonlinear(self) -> int:
        """The components that do not enter every result as a straight line, bit by bit."""
        found = 0
        for node in self.results:
            found |= self.masks[node.index].nonlinear
        return found

    def sampled_rows(self, angular: Sequence[bool]) -> tuple[int, ...]:
        """The results that are not linear in all they read, and the angles that read what is nonlinear in others.

        A sigma set sees the deviations of an angle within a turn, so that one that is spread over turns is linear
        no more: where it varies anyway, it is sampled.
        """
        varying, found = self.nonlinear, []
        for i, (node, turning) in enumerate(zip(self.results, angular, strict=True)):
            masks = self.masks[node.index]
            if masks.nonlinear or (turning and masks.reads & varying):
                found.append(i)
        return tuple(found)

    def parts(self, rows: Sequence[int]) -> tuple[Part, ...]:
        """What has to be sampled: the operations behind these results, by the nonlinear components they read."""
        varying = self.nonlinear
        found: dict[int, tuple[float, Counter[str]]] = {}
        for node in needed([self.results[i] for i in rows]):
            key = self.masks[node.index].reads & varying
            cost = cost_of(node, self.opaque)
            if key and cost:
                total, names = found.setdefault(key, (0.0, Counter()))
                found[key] = (total + cost, names)
                names["opaque" if node.index in self.opaque else node.operation] += 1
        made = [Part(components(key), cost, _in_words(names)) for key, (cost, names) in found.items()]
        return tuple(sorted(made, key=lambda part: (len(part.reads), part.reads)))


def components(mask: int) -> tuple[int, ...]:
    """The places of the bits of a mask."""
    return tuple(i for i in range(mask.bit_length()) if mask >> i & 1)


def cost_of(node: Node, opaque: Mapping[int, float]) -> float:
    """The cost of one scalar operation, in multiplications."""
    if node.operation in ("input", "constant"):
        return opaque.get(node.index, 0.0)
    return _COSTS.get(node.operation, _FUNCTION if _is_function(node.operation) else 1.0)


def _is_function(operation: str) -> bool:
    return operation in OPERATIONS and bool(OPERATIONS[operation].calls)


def _in_words(names: Counter[str]) -> str:
    """The costly operations by number, the rest together."""
    named = {"table": "look-up", "/": "division", "sqrt": "root"}
    costly = {k: v for k, v in names.items() if k in _COSTS or k == "opaque" or _is_function(k)}
    said = [f"{v} {named.get(k, k)}" for k, v in sorted(costly.items(), key=lambda item: (-item[1], item[0]))]
    cheap = sum(names.values()) - sum(costly.values())
    return ", ".join([*said, *([f"{cheap} arithmetic"] if cheap else [])])


def reading(function: Callable[..., Any], n: int, rest: Sequence[Any] = (), dtype: Any = jnp.float64) -> Reading:
    """What `function(x, *rest)` reads of x (n,), operation by operation.

    Args:
        function: as in a model; it is traced, not computed.
        n: components of x.
        rest: its other arguments, arrays or their shapes and types.
        dtype: type of x and of the result.
    """

    def given(x: Any, *others: Any) -> jax.Array:
        return jnp.asarray(function(x, *others)).astype(dtype)

    specs = [jax.ShapeDtypeStruct(jnp.shape(a), jnp.result_type(a)) for a in rest]
    with kernels(False):
        traced = jax.make_jaxpr(given)(jax.ShapeDtypeStruct((n,), dtype), *specs)
    line = straightened(traced)
    g = Graph(dtype)
    opaque: dict[int, float] = {}
    hidden: dict[int, Masks] = {}
    masks: list[Masks] = []
    known: dict[int, Array] = {place: _known(g, place, value) for place, value in line.constants.items()}
    known[line.inputs[0]] = g.inputs("x", (n,))
    known |= {i: g.inputs(f"rest {i}", s.shape, True) for i, s in zip(line.inputs[1:], specs, strict=True)}
    for call in line.calls:
        arrays = [known[i] for i in call.inputs]
        try:
            made = apply_rule(g, call.equation, arrays)
        except Refused as error:
            if isinstance(error, Defect):
                say_once(f"sigmax takes it that a function reads all it is given: {error}")
            _extend(masks, g, hidden)
            made = _hidden(g, call, arrays, masks, hidden, opaque)
        known |= zip(call.outputs, map(boxed, made), strict=True)
    # Before the masks are made: a result that is known to the last number becomes constants here.
    results = tuple(g.opened(known[line.output]).flat)
    _extend(masks, g, hidden)
    elements = {place: _elements(array, masks) for place, array in known.items()}
    places = {place: _together(found) for place, found in elements.items()}
    carries = {place: _carried(found) for place, found in elements.items()}
    return Reading(line, n, results, masks, places, carries, opaque)


def _known(g: Graph, place: int, value: Any) -> Array:
    if isinstance(value, jax.core.Tracer):
        return g.inputs(f"constant {place}", np.shape(value), True)
    return numbers_of(value, jnp.result_type(value))


def _elements(array: Array, masks: Sequence[Masks]) -> list[Masks]:
    return [] if array.dtype != object else [masks[node.index] for node in array.flat]


def _together(found: Sequence[Masks]) -> Masks:
    reads = nonlinear = 0
    for one in found:
        reads, nonlinear = reads | one.reads, nonlinear | one.nonlinear
    return Masks(reads, nonlinear)


def _carried(found: Sequence[Masks]) -> int:
    carried = 0
    for one in found:
        carried |= -1 if one.reads and not one.nonlinear else one.reads & ~one.nonlinear
    return carried


def _hidden(
    g: Graph,
    call: Call,
    arrays: Sequence[Array],
    masks: Sequence[Masks],
    hidden: dict[int, Masks],
    opaque: dict[int, float],
) -> list[Array]:
    """What cannot be seen into reads everything it is given, nonlinear."""
    reads = 0
    for array in arrays:
        reads |= _together(_elements(array, masks)).reads
    made: list[Array] = []
    for place, variable in zip(call.outputs, call.equation.outvars, strict=True):
        nodes = [g.input(f"hidden {place}", i) for i in range(int(np.prod(variable.aval.shape)))]
        hidden |= {node.index: Masks(reads, reads) for node in nodes}
        if nodes and not made:
            opaque[nodes[0].index] = OPAQUE
        made.append(array_of(nodes).reshape(variable.aval.shape))
    return made


def _extend(masks: list[Masks], g: Graph, hidden: Mapping[int, Masks]) -> None:
    """Masks of the nodes that have been made since."""
    for node in g.nodes[len(masks) :]:
        masks.append(_masks(node, masks, hidden))


def _masks(node: Node, masks: Sequence[Masks], hidden: Mapping[int, Masks]) -> Masks:
    if node.operation == "input":
        group, place = node.arguments
        return Masks(1 << place, 0) if group == "x" else hidden.get(node.index, Masks(0, 0))
    read = [masks[a.index] for a in node.inputs]
    together = _together(read)
    linear = (
        node.operation in ("+", "-", "negative")
        or (node.operation == "*" and not (read[0].reads and read[1].reads))
        or (node.operation == "/" and not read[1].reads)
        or (node.operation == "select" and not read[0].reads)
    )
    return together if linear else Masks(together.reads, together.reads)
