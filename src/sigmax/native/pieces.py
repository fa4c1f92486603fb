"""A graph as a C function, in pieces that compilers get through in time; the same for lanes and for one number."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from sigmax.native.choices import Sides, segments
from sigmax.native.graph import Graph
from sigmax.native.node import Node

# Compilers take more than proportionally long over long functions.
_LONGEST = 700
# Beyond this a compiler takes minutes and gigabytes, such as over 70 states or the 3⁷ points of a Gauss–Hermite rule.
LARGEST = 250_000
# Numbers of its tables, which a compiler reads one by one.
LARGEST_TABLES = 500_000


class Program(NamedTuple):
    """What is to be compiled: outputs by group, from inputs by group and from parameters.

    Attributes:
        graph: the operations.
        inputs: the groups of inputs that differ from call to call, in the order of the C function.
        outputs: nodes of each group of outputs, in the same order.
    """

    graph: Graph
    inputs: Sequence[str]
    outputs: Mapping[str, Sequence[Node]]

    @property
    def results(self) -> list[Node]:
        """The nodes of all groups of outputs."""
        return [node for group in self.outputs.values() for node in group]

    @property
    def operations(self) -> int:
        """How many scalar operations it takes."""
        return sum(n.operation not in ("input", "constant") for n in needed(self.results))


class Dialect(NamedTuple):
    """How a graph is spelled.

    Attributes:
        number: type of a number.
        truth: type of a truth value.
        linkage: what stands before the functions of the pieces.
        entry: what stands before the function itself.
        before: the arguments before the inputs: declared, and as they are passed on.
        spell: a node and the names of its arguments -> the expression.
        constant: a node that is known -> its expression.
        fixed: a node that `before` brings -> its expression, or None where it brings no such node.
        input: group and place -> the name under which an input is declared, or None to use it in place.
        stored: a truth value as a number to be kept, "{}" being the value.
        loaded: the same back.
        told: a truth value as the number 0 or 1.
        somewhere: whether a truth value that was kept is true for any lane, and whether it is false for any.
        unwritten: how kept numbers begin where a side of a choice may be passed over; compilers that are strict ask.
        comment: what is written where the label of the nodes changes, and beside an output.
        arrange: the nodes in the order in which they are computed.
        together: nodes that follow each other -> those of them that one call computes.
        pack: a name, such nodes and the names of their arguments -> the line of the call, and an expression for each.
    """

    number: str
    truth: str
    linkage: str
    entry: str
    before: tuple[str, str]
    spell: Callable[[Node, Sequence[str]], str]
    constant: Callable[[Node], str]
    fixed: Callable[[Node], str | None]
    input: Callable[[str, int], str | None]
    stored: str
    loaded: str
    told: str
    somewhere: tuple[str, str]
    unwritten: str = ""
    comment: Callable[[str], str] = lambda text: ""
    arrange: Callable[[Sequence[Node]], Sequence[Node]] = lambda work: work
    together: Callable[[Sequence[Node]], Iterable[Sequence[Node]]] = lambda work: zip(work)
    pack: Callable[[str, Sequence[Node], Sequence[Sequence[str]]], tuple[str, Sequence[str]]] | None = None


def needed(outputs: Iterable[Node], brought: Callable[[Node], bool] = lambda node: False) -> list[Node]:
    """All that the outputs are made from, themselves included, in the order of the graph.

    What is `brought` is left out, with what it alone is made from.
    """
    found: set[int] = set()
    kept: list[Node] = []
    waiting = list(outputs)
    while waiting:
        node = waiting.pop()
        if node.index not in found and not brought(node):
            found.add(node.index)
            kept.append(node)
            waiting.extend(node.inputs)
    return sorted(kept, key=lambda node: node.index)


class _Cut(NamedTuple):
    """Work cut into pieces.

    Attributes:
        pieces: the nodes of each.
        of: the piece of a node, by its index.
        last: the last piece that reads it.
        slots: where in the workspace a node lies that outlives its piece.
        size: of the workspace.
        sides: the sides of choices that a piece is needed for.
    """

    pieces: list[Sequence[Node]]
    of: dict[int, int]
    last: dict[int, int]
    slots: dict[int, int]
    size: int
    sides: list[Sides]


def _cut(work: Iterable[tuple[Sides, Sequence[Node]]]) -> _Cut:
    pieces: list[Sequence[Node]] = []
    sides: list[Sides] = []
    for own, nodes in work:
        count = max(1, round(len(nodes) / _LONGEST))
        bounds = [round(i * len(nodes) / count) for i in range(count + 1)]
        pieces += [nodes[a:b] for a, b in pairwise(bounds)]
        sides += [own] * count
    of = {n.index: k for k, piece in enumerate(pieces) for n in piece}
    last = dict(of)
    for k, piece in enumerate(pieces):
        for a in (*(a for n in piece for a in n.inputs), *(side.of for side in sides[k])):
            if a.index in of:
                last[a.index] = max(last[a.index], k)
    free: list[int] = []
    slots: dict[int, int] = {}
    ending: list[list[int]] = [[] for _ in pieces]
    size = 0
    for k, piece in enumerate(pieces):
        free += ending[k - 1] if k else []
        for n in piece:
            if last[n.index] > k:
                if not free:
                    free.append(size)
                    size += 1
                slots[n.index] = free.pop()
                ending[last[n.index]].append(slots[n.index])
    return _Cut(pieces, of, last, slots, size, sides)


def function(program: Program, name: str, dialect: Dialect) -> list[str]:
    """A program as the function `name(…, inputs…, outputs…)` with its pieces before it."""
    order = needed(program.results, lambda n: dialect.fixed(n) is not None)
    work = [n for n in order if n.operation not in ("input", "constant")]
    parts = segments(work, program.results, program.graph.choices)
    cut = _cut((sides, dialect.arrange(nodes)) for sides, nodes in parts)
    declared, passed = dialect.before
    groups = [*program.inputs, *program.outputs]
    number = dialect.number
    arguments = ", ".join(
        [*([declared] if declared else []), *(f"const {number} *{g}" for g in program.inputs)]
        + [f"{number} *{g}" for g in program.outputs]
    )
    handed = ", ".join([*([passed] if passed else []), *groups])
    lines: list[str] = []
    if len(cut.pieces) == 1:
        return [f"{dialect.entry}void {name}({arguments}) {{", *_piece(program, cut, 0, dialect, groups), "}"]
    for k in range(len(cut.pieces)):
        lines.append(f"{dialect.linkage} void {name}_{k}({arguments}, {number} *w) {{")
        lines += [*_piece(program, cut, k, dialect, [*groups, "w"]), "}"]
    unwritten = dialect.unwritten if any(cut.sides) else ""
    lines += [f"{dialect.entry}void {name}({arguments}) {{", f"    {number} w[{max(cut.size, 1)}]{unwritten};"]
    for k, sides in enumerate(cut.sides):
        asked = " && ".join(dialect.somewhere[not s.taken].format(f"w[{cut.slots[s.of.index]}]") for s in sides)
        lines.append(f"    {f'if ({asked}) ' if asked else ''}{name}_{k}({handed}, w);")
    return [*lines, "}"]


def _piece(program: Program, cut: _Cut, k: int, dialect: Dialect, arguments: Sequence[str]) -> list[str]:
    body: list[str] = []
    names: dict[int, str] = {}
    used: set[str] = set()

    def read(node: Node) -> str:
        if node.index not in names:
            names[node.index] = _brought(node, cut, dialect, body, used)
        return names[node.index]

    label = ""
    for n, expression in _expressions(cut.pieces[k], dialect, read, body):
        if n.label != label:
            label = n.label
            body.append(dialect.comment(label))
        names[n.index] = f"t{n.index}"
        body.append(f"    {_type(n, dialect)} t{n.index} = {expression};")
        if cut.last[n.index] > k:
            used.add("w")
            body.append(f"    w[{cut.slots[n.index]}] = {(dialect.stored if n.truth else '{}').format(f't{n.index}')};")
    final = len(cut.pieces) - 1
    for group, nodes in program.outputs.items():
        for i, n in enumerate(nodes):
            if cut.of.get(n.index, final) == k:
                used.add(group)
                body.append(f"    {group}[{i}] = {(dialect.told if n.truth else '{}').format(read(n))};")
    unused = [a for a in arguments if a not in used]
    declared = dialect.before[1]
    unused += [declared] if declared and declared not in used else []
    return [line for line in body if line] + [f"    (void){a};" for a in unused]


def _expressions(
    work: Sequence[Node], dialect: Dialect, read: Callable[[Node], str], body: list[str]
) -> Iterator[tuple[Node, str]]:
    """Each node and what computes it, calls made for several of them being written to the body before."""
    for nodes in dialect.together(work):
        arguments = [[read(a) for a in n.inputs] for n in nodes]
        if dialect.pack is None or len(nodes) == 1:
            yield from ((n, dialect.spell(n, names)) for n, names in zip(nodes, arguments, strict=True))
        else:
            call, expressions = dialect.pack(f"p{nodes[0].index}", nodes, arguments)
            body.append(f"    {call}")
            yield from zip(nodes, expressions, strict=True)


def _type(node: Node, dialect: Dialect) -> str:
    return f"const {dialect.truth if node.truth else dialect.number}"


def _brought(node: Node, cut: _Cut, dialect: Dialect, body: list[str], used: set[str]) -> str:
    """How a value that was made elsewhere is called in a piece."""
    if node.known:
        return dialect.constant(node)
    fixed = dialect.fixed(node)
    if fixed is not None:
        used.add(dialect.before[1])
        return fixed
    if node.operation == "input":
        group, place = node.arguments
        used.add(group)
        name = dialect.input(group, place)
        if name is None:
            return f"{group}[{place}]"
        body.append(f"    const {dialect.number} {name} = {group}[{place}];")
        return name
    used.add("w")
    value = f"w[{cut.slots[node.index]}]"
    body.append(f"    {_type(node, dialect)} t{node.index} = {dialect.loaded.format(value) if node.truth else value};")
    return f"t{node.index}"
