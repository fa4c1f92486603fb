"""A graph written as C over vector lanes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sigmax.native.graph import Graph, Node
from sigmax.native.operations import OPERATIONS

# Compilers take more than proportionally long over long functions.
_LONGEST = 700


class Program(NamedTuple):
    """What is to be compiled: outputs by group, from inputs by group and from parameters.

    Attributes:
        graph: the operations.
        inputs: the groups of inputs that differ from lane to lane, in the order of the C function.
        outputs: nodes of each group of outputs, in the same order.
    """

    graph: Graph
    inputs: Sequence[str]
    outputs: Mapping[str, Sequence[Node]]


def needed(outputs: Iterable[Node]) -> list[Node]:
    """All that the outputs are made from, themselves included, in the order of the graph."""
    found: set[int] = set()
    kept: list[Node] = []
    waiting = list(outputs)
    while waiting:
        node = waiting.pop()
        if node.index not in found:
            found.add(node.index)
            kept.append(node)
            waiting.extend(node.inputs)
    return sorted(kept, key=lambda node: node.index)


def literal(value: float) -> str:
    """A number in C."""
    if np.isnan(value):
        return '__builtin_nan("")'
    if np.isinf(value):
        return "__builtin_inf()" if value > 0 else "-__builtin_inf()"
    return repr(float(value))


def lanes_source(program: Program, vectors: Mapping[str, str]) -> str:
    """The C of a program; `vectors` names the library's vector functions by operation.

    It defines `constants()`, the number of values that stay the same; `setup(parameters, c)`, which
    computes them; and `step(c, inputs…, outputs…)`.
    """
    flat = [node for group in program.outputs.values() for node in group]
    order = needed(flat)
    moving = [n for n in order if not n.fixed]
    read = [*flat, *(a for n in moving for a in n.inputs)]
    kept = list({n.index: n for n in read if n.fixed and not n.known}.values())
    places = {n.index: i for i, n in enumerate(kept)}
    calls = sorted({OPERATIONS[n.operation].calls for n in order if n.operation in OPERATIONS} - {""})
    lines = ['#include "lanes.h"', *(_library_function(name, vectors) for name in calls)]
    for number, table in enumerate(program.graph.tables):
        lines.append(f"static const R table_{number}[] = {{{', '.join(map(literal, table))}}};")
    lines += [f"long constants(void) {{ return {max(len(kept), 1)}; }}", *_setup(kept)]
    lines += _steps(program, moving, places)
    return "\n".join(lines) + "\n"


def _library_function(name: str, vectors: Mapping[str, str]) -> str:
    two = "_2" if OPERATIONS[name].arity == 2 else ""
    return f"VECTOR{two}({name}, {vectors[name]})" if name in vectors else f"LANE_BY_LANE{two}({name})"


def _setup(kept: Sequence[Node]) -> list[str]:
    """Computed over lanes too, so that the bits are those of the step."""
    lines = ["void setup(const R *restrict parameters, R *restrict c) {"]
    names: dict[int, str] = {}
    for node in needed(kept):
        names[node.index] = f"t{node.index}"
        if node.operation == "input":
            lines.append(f"V t{node.index} = K(parameters[{node.arguments[1]}]);")
        elif not node.known:
            lines.append(_statement(node, names))
        else:
            names[node.index] = _constant(node)
    for i, node in enumerate(kept):
        value = f"({names[node.index]})[0]"
        lines.append(f"c[{i}] = {value}{' != 0' if node.truth else ''};")
    return [*lines, "(void)parameters; (void)c;", "}"]


def _constant(node: Node) -> str:
    if node.truth:
        return "((M){0} - 1)" if node.value else "((M){0})"
    return f"K({literal(node.value)})"


def _statement(node: Node, names: Mapping[int, str]) -> str:
    if node.operation == "table":
        expression = f"v_look_up(table_{node.arguments[0]}, {names[node.arguments[1].index]})"
    else:
        expression = OPERATIONS[node.operation].lanes.format(*(names[a.index] for a in node.arguments))
    return f"{'M' if node.truth else 'V'} t{node.index} = {expression};"


def _steps(program: Program, moving: Sequence[Node], places: Mapping[int, int]) -> list[str]:
    """The function `step`, in pieces that hand on what they share through a workspace."""
    work = [n for n in moving if n.operation != "input"]
    pieces = max(1, round(len(work) / _LONGEST))
    bounds = [round(i * len(work) / pieces) for i in range(pieces + 1)]
    piece_of = {n.index: k for k in range(pieces) for n in work[bounds[k] : bounds[k + 1]]}
    flat = [(group, i, n) for group, nodes in program.outputs.items() for i, n in enumerate(nodes)]
    last_use = dict(piece_of)
    for n in work:
        for a in n.inputs:
            if a.index in piece_of:
                last_use[a.index] = max(last_use[a.index], piece_of[n.index])
    slots, count = _slots(work, piece_of, last_use, pieces)
    arguments = "".join(f", const V *restrict {g}" for g in program.inputs)
    arguments += "".join(f", V *restrict {g}" for g in program.outputs)
    passed = "".join(f", {g}" for g in (*program.inputs, *program.outputs))
    lines: list[str] = []
    for k in range(pieces):
        body: list[str] = []
        names: dict[int, str] = {}
        mine = work[bounds[k] : bounds[k + 1]]
        outputs = [(g, i, n) for g, i, n in flat if piece_of.get(n.index, pieces - 1) == k]
        for n in mine:
            for a in n.inputs:
                if a.index not in names:
                    names[a.index] = _name(a, places, slots, body)
            body.append(_statement(n, names))
            names[n.index] = f"t{n.index}"
            if last_use[n.index] > k:
                body.append(f"w[{slots[n.index]}] = (V)t{n.index};")
        for g, i, n in outputs:
            if n.index not in names:
                names[n.index] = _name(n, places, slots, body)
            value = f"v_select({names[n.index]}, K(1), K(0))" if n.truth else names[n.index]
            body.append(f"{g}[{i}] = {value};")
        lines += [f"static __attribute__((noinline)) void piece_{k}(const R *restrict c{arguments}, V *restrict w) {{"]
        lines += [*body, "".join(f"(void){g};" for g in ("c", *program.inputs, *program.outputs, "w")), "}"]
    lines += [f"void step(const R *restrict c{arguments}) {{", f"V w[{max(count, 1)}];"]
    lines += [*(f"piece_{k}(c{passed}, w);" for k in range(pieces)), "}"]
    return lines


def _name(node: Node, places: Mapping[int, int], slots: Mapping[int, int], body: list[str]) -> str:
    """How a value made elsewhere is called in a piece."""
    if node.known:
        return _constant(node)
    if node.index in places:
        value = f"K(c[{places[node.index]}])"
        return f"({value} != 0)" if node.truth else value
    if node.operation == "input":
        return f"{node.arguments[0]}[{node.arguments[1]}]"
    body.append(f"{'M' if node.truth else 'V'} t{node.index} = {'(M)' if node.truth else ''}w[{slots[node.index]}];")
    return f"t{node.index}"


def _slots(
    work: Sequence[Node], piece_of: Mapping[int, int], last_use: Mapping[int, int], pieces: int
) -> tuple[dict[int, int], int]:
    """Places in the workspace for what outlives its piece, used again when free."""
    free: list[int] = []
    ending: list[list[int]] = [[] for _ in range(pieces + 1)]
    slots: dict[int, int] = {}
    count, piece = 0, 0
    for n in work:
        if piece_of[n.index] != piece:
            piece = piece_of[n.index]
            free += ending[piece - 1]
        if last_use[n.index] > piece:
            if not free:
                free.append(count)
                count += 1
            slots[n.index] = free.pop()
            ending[last_use[n.index]].append(slots[n.index])
    return slots, count
