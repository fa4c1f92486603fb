"""A traced function as C with a loop for each group of equations: the code grows with them, not with the numbers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.loops import algebra, islands, moves, products  # noqa: F401, rules register themselves
from sigmax.native.loops.flat import FlatCall, FlatTrace
from sigmax.native.loops.moves import filled
from sigmax.native.loops.text import HEAD, Lines, Text
from sigmax.native.loops.views import Buffer, View, walk
from sigmax.native.loops.writer import Value, Writer
from sigmax.native.node import Node
from sigmax.native.refusal import Refused

# Numbers of one lane that a step may take for its workspace: 256 MB at eight lanes of float64.
_LARGEST = 4_000_000


class Loops(NamedTuple):
    """What is to be compiled.

    Attributes:
        source: the C, which includes kernels.h.
    """

    source: str


def loops_in(source: str) -> bool:
    """Whether a source is one of these."""
    return source.startswith(HEAD)


def written(
    traced: FlatTrace,
    arrays: Sequence[Array],
    groups: Sequence[str],
    made: Callable[[list[Array]], Mapping[str, Sequence[Node]]],
    dtype: Any,
    vectors: Mapping[str, str],
) -> Loops:
    """A traced function of arrays, as for a straight line: `constants()`, `setup(parameters, c)`, `step(c, w, …)`.

    Beside these it defines `workspace()`, how many numbers of each lane w holds.

    Args:
        traced: the function.
        arrays: nodes of its arguments: inputs, those of "parameters" fixed, and zeros.
        groups: of inputs, in the order of the C function.
        made: results as arrays of nodes -> nodes of each group of outputs.
        dtype: of the numbers.
        vectors: names of the library's vector functions by operation.

    Raises:
        Refused: for what cannot be lowered.
    """
    text = Text(vectors)
    first, step = Writer(Lines(text), dtype), Writer(Lines(text), dtype)
    buffers = {name: Buffer(name) for name in groups} | {"parameters": Buffer("parameters", same=True)}
    values: dict[int, Value] = {}
    fixed: dict[int, Value] = {}
    for i, nodes in zip(traced.inputs, arrays, strict=True):
        value = _argument(nodes, buffers)
        if isinstance(value, View) and value.buffer.same:
            fixed[i] = value
        elif isinstance(value, View) and (value.at < 0).any():
            values[i] = filled(step, value, np.zeros(()))
        else:
            values[i] = value
    of_setup, of_step, known = _sorted(traced.calls, fixed, values, step)
    values |= known
    ready = {*fixed, *(o for call in of_setup for o in call.outputs)}
    read = dict.fromkeys(
        [*(i for call in of_step for i in call.inputs if isinstance(i, int)), *_numbers(traced.outputs)]
    )
    wanted = [i for i in read if i in ready]
    kept = fixed | known
    first.run(of_setup, kept, wanted)
    constants = 0
    for i in wanted:
        values[i], constants = _constant(first, kept[i], constants)
    step.run(of_step, values, traced.outputs)
    held = list[Buffer]()
    results = made([_nodes(values[o] if isinstance(o, int) else o, held) for o in traced.outputs])
    for name, nodes in results.items():
        _hand_over(step, Buffer(name), nodes, held)
    step.close_all()
    size = max(step.lines.memory.size, 1)
    largest = max(size, first.lines.memory.size)
    if largest > _LARGEST:
        raise Refused(f"a half-step that works on {largest:,} numbers at a time, more than {_LARGEST:,}")
    arguments = ", ".join([*(f"const V *{g}" for g in groups), *(f"V *{g}" for g in results)])
    return Loops(
        "\n".join(
            [
                *text.before(),
                f"long constants(void) {{ return {max(constants, 1)}; }}",
                f"long workspace(void) {{ return {size}; }}",
                *_setup(first.lines),
                f"void step(const R *c, V *w, {arguments}) {{",
                *step.lines.lines,
                "}",
                "",
            ]
        )
    )


def _numbers(values: Sequence[Any]) -> list[int]:
    return [v for v in values if isinstance(v, int)]


def _argument(nodes: Array, buffers: Mapping[str, Buffer]) -> Value:
    """An argument: known numbers, or places of an input, below 0 where there are zeros."""
    flat = list(nodes.flat)
    group = next((n.arguments[0] for n in flat if n.operation == "input"), None)
    if group is None:
        return np.array([n.value for n in flat], np.float64).reshape(nodes.shape)
    at = np.array([n.arguments[1] if n.operation == "input" else -1 for n in flat]).reshape(nodes.shape)
    if group != "parameters":
        return View(buffers[group], at)
    # Zeros stand among the parameters too.
    there = np.flatnonzero(at >= 0)[0]
    every = at.flat[there] - there + np.arange(at.size).reshape(at.shape)
    return View(buffers[group], every, zero=(at < 0) if (at < 0).any() else None)


def _sorted(
    calls: Sequence[FlatCall], fixed: Mapping[int, Value], values: Mapping[int, Value], writer: Writer
) -> tuple[list[FlatCall], list[FlatCall], dict[int, Value]]:
    """Calls that read nothing but what stays the same over all steps, the others, and what is known at once."""
    known = {i: v for i, v in values.items() if isinstance(v, np.ndarray)}
    same = set(fixed)
    of_setup: list[FlatCall] = []
    of_step: list[FlatCall] = []
    for call in calls:
        inputs = _numbers(call.inputs)
        if all(i in known for i in inputs):
            given = [known[i] if isinstance(i, int) else i for i in call.inputs]
            known |= zip(call.outputs, writer.results(call.equation, given), strict=True)
        elif all(i in known or i in same for i in inputs):
            of_setup.append(call)
            same.update(call.outputs)
        else:
            of_step.append(call)
    return of_setup, of_step, known


def _constant(first: Writer, value: Value, at: int) -> tuple[Value, int]:
    """What setup makes, written to c from a place on; and the next place."""
    if isinstance(value, np.ndarray):
        return value, at
    size = value.at.size
    to = value._replace(buffer=Buffer("c", same=True), at=at + np.arange(size).reshape(value.shape))
    indices = [f"i{d}" for d in range(len(value.shape))]
    number = first.lines.element(value.buffer, walk(value.at), indices)
    place = first.lines.place(walk(to.at), indices)
    first.lines.nest(value.shape, [f"c[{place}] = ({number})[0];"])
    return to, at + size


def _nodes(value: Value, held: list[Buffer]) -> Array:
    """A result as an array of nodes: known ones, and inputs by the buffer's number and the place in it."""
    g = Graph()
    if isinstance(value, np.ndarray):
        return g.constants(value)
    held.append(value.buffer)
    number = str(len(held) - 1)
    nodes = np.array([g.input(number, place) for place in value.at.ravel().tolist()], dtype=object)
    if value.zero is not None:
        nodes[value.zero.ravel()] = g.constant(0.0)
    return boxed(nodes.reshape(value.shape)) if value.shape else boxed(nodes[0])


def _hand_over(step: Writer, to: Buffer, nodes: Sequence[Node], held: Sequence[Buffer]) -> None:
    """Write a group of outputs: what lies in one buffer in one go."""
    begin = 0
    for end in range(1, len(nodes) + 1):
        if end < len(nodes) and _home(nodes[end]) == _home(nodes[begin]):
            continue
        run = nodes[begin:end]
        value: Value = np.array([float(n.value) for n in run]) if run[0].known else None
        if value is None:
            value = View(held[int(run[0].arguments[0])], np.array([n.arguments[1] for n in run]))
        step.put(value, View(to, np.arange(begin, end)))
        begin = end


def _home(node: Node) -> Any:
    return None if node.known else node.arguments[0]


def _setup(lines: Lines) -> list[str]:
    return [
        "void setup(const R *parameters, R *c) {",
        f"    char *block = __builtin_malloc({max(lines.memory.size, 1)} * sizeof(V) + 64);",
        "    V *w = (V *)(((unsigned long)block + 63) & ~63UL);",
        *lines.lines,
        "    __builtin_free(block);",
        "    (void)parameters, (void)c, (void)w;",
        "}",
    ]
