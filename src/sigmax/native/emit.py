"""A graph written as C over vector lanes."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.pieces import Dialect, Program, function, needed


def literal(value: float) -> str:
    """A number in C."""
    if np.isnan(value):
        return '__builtin_nan("")'
    if np.isinf(value):
        return "__builtin_inf()" if value > 0 else "-__builtin_inf()"
    return repr(float(value))


def lanes_source(program: Program, vectors: Mapping[str, str], alone: int = 0) -> str:
    """The C of a program; `vectors` names the library's vector functions by operation.

    Of a single track, calls of a vector function that do not wait for each other are made in one, each in one of
    `alone` lanes. Nothing else differs, so neither does a bit.

    It defines `constants()`, the number of values that stay the same; `setup(parameters, c)`, which
    computes them; `workspace()`, 0; and `step(c, shared, inputs…, outputs…)`, which does without one.
    """
    order = needed(program.results)
    read = [*program.results, *(a for n in order if not n.fixed for a in n.inputs)]
    kept = list({n.index: n for n in read if n.fixed and not n.known}.values())
    calls = sorted({OPERATIONS[n.operation].calls for n in order if n.operation in OPERATIONS} - {""})
    lines = [
        '#include "lanes.h"',
        *(library_function(name, vectors) for name in calls),
    ]
    for number, table in enumerate(program.graph.tables):
        lines.append(f"static const R table_{number}[] = {{{', '.join(map(literal, table))}}};")
    lines += [
        f"long constants(void) {{ return {max(len(kept), 1)}; }}",
        "long workspace(void) { return 0; }",
        *_setup(kept),
    ]
    return "\n".join([*lines, *function(program, "step", dialect(kept, vectors, alone))]) + "\n"


def dialect(kept: Sequence[Node], vectors: Mapping[str, str], alone: int) -> Dialect:
    """How a graph is spelled over lanes, `kept` being what setup made; see `lanes_source`."""
    places = {n.index: i for i, n in enumerate(kept)}

    def fixed(node: Node) -> str | None:
        if node.index not in places:
            return None
        value = f"K(c[{places[node.index]}])"
        return f"v_truth({value})" if node.truth else value

    return Dialect(
        number="V",
        truth="M",
        linkage="static __attribute__((noinline))",
        entry="",
        before=("const R *c, V *shared", "c, shared"),
        spell=spelled,
        constant=constant,
        fixed=fixed,
        input=lambda group, place: None,
        stored="v_number({})",
        loaded="v_truth({})",
        told="v_number({})",
        somewhere=("v_any(v_unequal({}, K(0)))", "v_any(v_equal({}, K(0)))"),
        arrange=lambda work: _calls_side_by_side(work, vectors),
        together=lambda work: _side_by_side(work, vectors, max(alone, 1)),
        pack=lambda name, nodes, arguments: _packed(name, vectors, nodes, arguments, alone),
    )


def _calls(node: Node, vectors: Mapping[str, str]) -> bool:
    return node.operation in OPERATIONS and OPERATIONS[node.operation].calls in vectors


def _calls_side_by_side(work: Sequence[Node], vectors: Mapping[str, str]) -> Sequence[Node]:
    """Sorted so that calls of one function follow each other where none waits for another."""
    waits: dict[int, int] = {}
    for n in work:
        before = [waits[a.index] + _calls(a, vectors) for a in n.inputs if a.index in waits]
        waits[n.index] = max(before, default=0)

    def place(n: Node) -> tuple[int, str, int]:
        return waits[n.index], n.operation if _calls(n, vectors) else "", n.index

    return sorted(work, key=place)


def _side_by_side(work: Sequence[Node], vectors: Mapping[str, str], most: int) -> Iterator[Sequence[Node]]:
    """Runs of calls of one vector function that do not wait for each other, and every other node alone."""
    run: list[Node] = []
    for n in work:
        fits = run and len(run) < most and n.operation == run[0].operation and _calls(n, vectors)
        if run and not (fits and not any(a is b for a in n.inputs for b in run)):
            yield run
            run = []
        run.append(n)
    if run:
        yield run


def _packed(
    name: str, vectors: Mapping[str, str], nodes: Sequence[Node], arguments: Sequence[Sequence[str]], lanes: int
) -> tuple[str, Sequence[str]]:
    """One call for several nodes; lanes that are left over repeat the first."""
    every = [*arguments, *[arguments[0]] * (lanes - len(arguments))]
    packed = [f"(L){{{', '.join(f'({a})[0]' for a in column)}}}" for column in zip(*every, strict=True)]
    symbol = vectors[OPERATIONS[nodes[0].operation].calls]
    return f"const L {name} = {symbol}({', '.join(packed)});", [f"K({name}[{i}])" for i in range(len(nodes))]


def library_function(name: str, vectors: Mapping[str, str]) -> str:
    """What makes a function of the mathematical library one of lanes."""
    two = "_2" if OPERATIONS[name].arity == 2 else ""
    return f"VECTOR{two}({name}, {vectors[name]})" if name in vectors else f"LANE_BY_LANE{two}({name})"


def _setup(kept: Sequence[Node]) -> list[str]:
    """Computed over lanes too, so that the bits are those of the step."""
    lines = ["void setup(const R *parameters, R *c) {"]
    names: dict[int, str] = {}
    for node in needed(kept):
        names[node.index] = constant(node) if node.known else f"t{node.index}"
        if node.operation == "input":
            lines.append(f"V t{node.index} = K(parameters[{node.arguments[1]}]);")
        elif not node.known:
            expression = spelled(node, [names[a.index] for a in node.inputs])
            lines.append(f"{'M' if node.truth else 'V'} t{node.index} = {expression};")
    for i, node in enumerate(kept):
        value = f"v_number({names[node.index]})" if node.truth else names[node.index]
        lines.append(f"c[{i}] = ({value})[0];")
    return [*lines, "(void)parameters; (void)c;", "}"]


def constant(node: Node) -> str:
    """A known number or truth value in all lanes."""
    if node.truth:
        return "ALL" if node.value else "(ALL ^ ALL)"
    return f"K({literal(node.value)})"


def spelled(node: Node, names: Sequence[str]) -> str:
    """An operation on what has these names."""
    if node.operation == "table":
        return f"v_look_up(table_{node.arguments[0]}, {names[0]})"
    return OPERATIONS[node.operation].lanes.format(*names)
