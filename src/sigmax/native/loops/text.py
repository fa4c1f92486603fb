"""The text of a program of loops: tables, islands, library functions, and the lines of one C function."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sigmax.native.emit import dialect, library_function, literal, spelled
from sigmax.native.loops.views import Buffer, Memory, View, Walk
from sigmax.native.node import Node
from sigmax.native.operations import OPERATIONS
from sigmax.native.pieces import Program, function

HEAD = '#include "kernels.h"'
# Beyond this a compiler takes longer over one straight line than over all loops.
_LARGEST_ISLAND = 30_000


class Text:
    """What stands before the functions of a program, each thing once.

    Args:
        vectors: names of the library's vector functions by operation.
    """

    def __init__(self, vectors: Mapping[str, str]) -> None:
        self.vectors = vectors
        self._tables: dict[Any, str] = {}
        self._lines: list[str] = []
        self._calls: set[str] = set()
        self._islands = 0

    def table(self, values: np.ndarray | Sequence[int], kind: str) -> str:
        """The name of a table of integers, kind "int", or of numbers, kind "R"."""
        numbers = np.asarray(values, np.float64 if kind == "R" else np.int64).ravel()
        key = kind, numbers.tobytes()
        if key not in self._tables:
            self._tables[key] = f"table_{len(self._tables)}"
            inside = ", ".join(map(literal if kind == "R" else str, numbers.tolist()))
            self._lines.append(f"static const {kind} {self._tables[key]}[] = {{{inside}}};")
        return self._tables[key]

    def spelled(self, node: Node, names: Sequence[str]) -> str:
        """An operation on what has these names."""
        self._calls |= {OPERATIONS[node.operation].calls} - {""}
        return spelled(node, names)

    def island(self, program: Program) -> str | None:
        """The name of a function that is a straight line, or None where it is too long."""
        if program.operations > _LARGEST_ISLAND:
            return None
        name = f"island_{self._islands}"
        self._islands += 1
        tables = [self.table(numbers, "R") for numbers in program.graph.tables]

        def spell(node: Node, names: Sequence[str]) -> str:
            if node.operation == "table":
                return f"v_look_up({tables[node.arguments[0]]}, {names[0]})"
            return self.spelled(node, names)

        own = dialect((), self.vectors, 0)._replace(
            spell=spell, entry="static __attribute__((noinline)) ", before=("", "")
        )
        self._lines += function(program, name, own)
        return name

    def before(self) -> list[str]:
        """The lines."""
        return [HEAD, *(library_function(c, self.vectors) for c in sorted(self._calls)), *self._lines]


class Lines:
    """The lines of one function, and the workspace that it takes.

    Args:
        text: what stands before it.
    """

    def __init__(self, text: Text) -> None:
        self.text, self.memory, self.lines = text, Memory(), list[str]()
        self._label = ""

    def new(self, shape: tuple[int, ...], truth: bool = False, bounds: tuple[float, float] | None = None) -> View:
        """An array of its own, row by row, with nothing in it yet."""
        size = int(np.prod(shape))
        return View(Buffer("w", False, self.memory, size), np.arange(size).reshape(shape), truth, None, bounds)

    def say(self, line: str, label: str = "") -> None:
        """One more line; a label stands before it where it changes."""
        if label and label != self._label:
            self._label = label
            self.lines.append(f"    /* {label.replace('*/', '')} */")
        self.lines.append(f"    {line}")

    def nest(self, sizes: Sequence[int], body: Iterable[str], label: str = "") -> None:
        """Lines in loops over i0, i1 and so on."""
        self.say(over([f"i{d}" for d in range(len(sizes))], sizes) + " {", label)
        self.lines += [f"        {line}" for line in body]
        self.lines.append("    }")

    def element(self, buffer: Buffer, steps: Walk, indices: Sequence[str]) -> str:
        """What stands at indices."""
        place = self.place(steps, indices)
        inside = f"{self.text.table(steps.table, 'int')}[{place}]" if steps.table is not None else place
        whole = f"{buffer.name}[{buffer.offset} + {inside}]" if buffer.offset else f"{buffer.name}[{inside}]"
        return f"K({whole})" if buffer.same else whole

    def place(self, steps: Walk, indices: Sequence[str]) -> str:
        """The number of a place."""
        terms = [str(steps.start)] if steps.start else []
        for index, step in zip(indices, steps.axes, strict=True):
            if isinstance(step, tuple):
                terms.append(f"{self.text.table(step, 'int')}[{index}]")
            elif step:
                terms.append(index if step == 1 else f"{index} * {step}")
        return " + ".join(terms) or "0"

    def pointer(self, view: View) -> str:
        """Where an array begins that lies row by row."""
        return f"{view.buffer.name} + {view.buffer.offset + (int(view.at.flat[0]) if view.at.size else 0)}"


def over(indices: Sequence[str], sizes: Sequence[int]) -> str:
    """The heads of loops, one in the other."""
    return " ".join(f"for (long {i} = 0; {i} < {n}; {i}++)" for i, n in zip(indices, sizes, strict=True))


def lies_row_by_row(view: View) -> bool:
    """Whether its numbers, one of each lane, follow each other."""
    size = view.at.size
    if view.buffer.same or not size:
        return not view.buffer.same
    return np.array_equal(view.at.ravel(), np.arange(size) + view.at.flat[0])
