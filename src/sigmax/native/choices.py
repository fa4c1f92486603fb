"""What a choice alone reads, and is computed only where one lane at least takes that side of it."""

from collections.abc import Callable, Container, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from sigmax.native.node import Node

# Fewer operations cost less than asking whether they are needed.
_FEWEST = 40


class Side(NamedTuple):
    """One side of a choice: where `of` is true, or where it is not."""

    of: Node
    taken: bool


# Sides of choices inside each other, the outermost first.
Sides = tuple[Side, ...]


class Segment(NamedTuple):
    """Nodes that follow each other, and the sides of choices that need them; none where they are always needed."""

    sides: Sides
    nodes: Sequence[Node]


def segments(work: Sequence[Node], results: Sequence[Node], choices: Container[int]) -> list[Segment]:
    """Nodes in an order in which each comes after what it reads, those of a side of a choice together.

    Args:
        work: in the order of the graph.
        results: nodes that are always needed.
        choices: by index, truth values by which whole functions are chosen; others are not worth a branch.
    """
    sides = _worthwhile(_sides(work, results, {n.index for n in work if n.index in choices}))
    if not any(sides.values()):
        return [Segment((), work)]
    stage: dict[int, int] = {}
    for n in work:
        own = sides[n.index]
        before = [a for a in (*n.inputs, *(side.of for side in own)) if a.index in stage]
        stage[n.index] = max((stage[a.index] + (sides[a.index] != own) for a in before), default=0)

    def place(n: Node) -> tuple[int, list[tuple[int, bool]]]:
        return stage[n.index], [(side.of.index, side.taken) for side in sides[n.index]]

    made = [Segment(sides[group[0].index], group) for group in _runs(sorted(work, key=place), place)]
    # The last is always needed: results are read there.
    return made if not made[-1].sides else [*made, Segment((), [])]


def _runs(work: Sequence[Node], key: Callable[[Node], Any]) -> list[list[Node]]:
    return [list(run) for _, run in groupby(work, key=key)]


def _sides(work: Sequence[Node], results: Sequence[Node], choices: Container[int]) -> dict[int, Sides]:
    """Of each node the sides that all who read it have in common."""
    found: dict[int, Sides | None] = {n.index: None for n in work}

    def asked(node: Node, sides: Sides) -> None:
        if node.index in found:
            before = found[node.index]
            found[node.index] = sides if before is None else _common(before, sides)

    for node in results:
        asked(node, ())
    made: dict[int, Sides] = {}
    for n in reversed(work):
        # What was there before the choice was made stays outside of it.
        own: Sides = ()
        for side in found[n.index] or ():
            if side.of.index > n.index:
                break
            own = (*own, side)
        made[n.index] = own
        for place, a in enumerate(n.inputs):
            asked(a, (*own, *_asked_by(n, place, choices)))
    return {n.index: made[n.index] for n in work}


def _asked_by(n: Node, place: int, choices: Container[int]) -> Sides:
    """The side on which an argument of a node is read."""
    of = n.inputs[0]
    if n.operation in ("select", "select truth") and place and of.index in choices and n.inputs[1] is not n.inputs[2]:
        return (Side(of, place == 1),)
    if n.operation == "and" and n.inputs[1 - place].index in choices and n.inputs[place].index not in choices:
        return (Side(n.inputs[1 - place], True),)
    return ()


def _common(one: Sides, other: Sides) -> Sides:
    shared: Sides = ()
    for a, b in zip(one, other, strict=False):
        if a.of is not b.of or a.taken is not b.taken:
            break
        shared = (*shared, a)
    return shared


def _worthwhile(sides: Mapping[int, Sides]) -> dict[int, Sides]:
    """Without those of few nodes."""
    count: dict[tuple[int, bool], int] = {}
    for own in sides.values():
        for side in own:
            count[side.of.index, side.taken] = count.get((side.of.index, side.taken), 0) + 1
    return {
        index: tuple(side for side in own if count[side.of.index, side.taken] >= _FEWEST)
        for index, own in sides.items()
    }
