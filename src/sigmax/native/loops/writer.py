"""Equations written as loops: which rule each is, and when a loop that waits for more is closed."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sigmax.native.graph import Graph
from sigmax.native.loops.flat import FlatCall
from sigmax.native.loops.groups import Element, Group
from sigmax.native.loops.text import Lines, lies_row_by_row
from sigmax.native.loops.views import View
from sigmax.native.primitives.elementwise import EACH, SAME
from sigmax.native.primitives.interpret import RULES, apply_rule
from sigmax.native.refusal import Refused, line_of

# A value: known numbers, an array that lies somewhere, or one that a loop is going to make.
Value = Any
# A rule of an equation: the writer, the equation and its values -> the results, or None where it does not apply.
WRITERS: dict[str, Callable[..., list[Value] | None]] = {}


def writes(*names: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let a function write these primitives."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        WRITERS.update(dict.fromkeys(names, function))
        return function

    return register


class Writer:
    """Writes equations into the lines of a function.

    Args:
        lines: where to.
        dtype: of the numbers.
    """

    def __init__(self, lines: Lines, dtype: Any) -> None:
        self.lines, self.dtype, self.label = lines, dtype, ""
        self._groups: dict[tuple[int, ...], Group] = {}

    def run(self, calls: Sequence[FlatCall], values: dict[int, Value], wanted: Sequence[Any]) -> None:
        """Write calls; `values` holds what is there and, in the end, what is wanted.

        Raises:
            Refused: for what cannot be lowered.
        """
        last = {i: k for k, call in enumerate(calls) for i in (*call.inputs, *call.outputs) if isinstance(i, int)}
        last |= dict.fromkeys((w for w in wanted if isinstance(w, int)), len(calls))
        for k, call in enumerate(calls):
            given = [self.current(values[i] if isinstance(i, int) else i) for i in call.inputs]
            for i in {i for i in call.inputs if isinstance(i, int) and last[i] == k}:
                del values[i]
            self.label = call.label
            made = self.results(call.equation, given)
            values |= {i: v for i, v in zip(call.outputs, made, strict=True) if last[i] > k}
            # What nobody else holds is not wanted when its loop is written.
            del given, made
        for w in wanted:
            if isinstance(w, int):
                values[w] = self.settled(values[w])

    def results(self, equation: Any, given: list[Value]) -> list[Value]:
        """The results of one equation.

        Raises:
            Refused: for what cannot be lowered, with the line it came from.
        """
        try:
            made = self._results(equation, given)
            shaped = zip(made, (v.aval for v in equation.outvars), strict=True)
            return [np.zeros(a.shape, a.dtype) if 0 in a.shape else m for m, a in shaped]
        except Refused as error:
            raise type(error)(error.what, line_of(equation) or error.where) from error.__cause__

    def _results(self, equation: Any, given: list[Value]) -> list[Value]:
        name, outs = equation.primitive.name, [v.aval for v in equation.outvars]
        if all(0 in a.shape for a in outs):
            return list(outs)
        if all(isinstance(a, np.ndarray) for a in given):
            g = Graph(self.dtype)
            made = apply_rule(g, equation, given)
            return [np.asarray(g.known(m, a.dtype)) for m, a in zip(made, outs, strict=True)]
        if name in SAME:
            return list(given)
        if name in EACH and all(_fits(a.shape, outs[0].shape) for a in given):
            return self.each(equation, given)
        moves = RULES.get(name)
        if moves is not None and moves.moves and name not in WRITERS:
            made = moves.function(None, equation, self.settled(given[0]).at)
            return self._moved(equation, given[0], made if equation.primitive.multiple_results else [made])
        for writes_it in (WRITERS.get(name), WRITERS["island"]):
            found = None if writes_it is None else writes_it(self, equation, given)
            if found is not None:
                return found
        raise AssertionError("an island covers an equation or refuses it")

    def _moved(self, equation: Any, value: Value, made: Sequence[np.ndarray]) -> list[Value]:
        view = self.settled(value)
        if view.zero is None:
            return [view._replace(at=np.asarray(at)) for at in made]
        zeros = RULES[equation.primitive.name].function(None, equation, view.zero)
        several = zeros if equation.primitive.multiple_results else [zeros]
        return [view._replace(at=np.asarray(at), zero=np.asarray(z)) for at, z in zip(made, several, strict=True)]

    # Loops that wait for more.
    def current(self, value: Value) -> Value:
        """Where an array lies by now, if it lies anywhere."""
        return value.view if isinstance(value, Element) and value.view is not None else value

    def settled(self, value: Value) -> Value:
        """The same with everything written that makes it."""
        value = self.current(value)
        if isinstance(value, Element):
            self.close(value.group)
            value = value.view
        if isinstance(value, View):
            for group in list(value.buffer.writers):
                self.close(group)
        return value

    def close(self, group: Group) -> None:
        """Write a loop."""
        if self._groups.get(group.shape) is group:
            del self._groups[group.shape]
        group.written(self.lines)

    def close_all(self) -> None:
        """Write all loops that wait."""
        for group in list(self._groups.values()):
            self.close(group)

    def open(self, shape: tuple[int, ...]) -> Group:
        """The loop that waits for more of a shape."""
        if shape not in self._groups:
            self._groups[shape] = Group(shape, self.dtype, self.label)
        return self._groups[shape]

    def joined(self, values: Sequence[Value], shape: tuple[int, ...]) -> tuple[Group, list[Value]]:
        """The loop of a shape, and values as it can read them."""
        for value in values:
            waits = self.current(value)
            if not (isinstance(waits, Element) and waits.group is self._groups.get(shape)):
                self.settled(waits)
        group = self.open(shape)
        return group, [_spread(self.current(v), shape) for v in values]

    def each(self, equation: Any, given: Sequence[Value]) -> list[Value]:
        """An equation that acts on each element."""
        group, values = self.joined(given, tuple(equation.outvars[0].aval.shape))
        return group.made(equation, values)

    # Arrays in memory.
    def put(self, value: Value, to: View) -> None:
        """Have an array written to a place that nobody has read yet."""
        if 0 not in to.shape:
            group, (value,) = self.joined([value], to.shape)
            group.store(group.node(value), to)

    def lying(self, value: Value, fresh: bool = False) -> View:
        """An array row by row in the workspace; `fresh` in a place of its own, to be overwritten."""
        value = self.settled(value)
        if isinstance(value, View) and not fresh and lies_row_by_row(value):
            return value
        if isinstance(value, np.ndarray):
            to = self.lines.new(value.shape, value.dtype == bool)
        else:
            to = self.lines.new(value.shape, value.truth, value.bounds)._replace(zero=value.zero)
        self.put(value, to)
        return self.settled(to)


def moved(value: Value, move: Callable[[np.ndarray], np.ndarray]) -> Value:
    """Known numbers, or those of a view, in other places of an array."""
    return move(value) if isinstance(value, np.ndarray) else value.moved(move)


def _fits(shape: Sequence[int], whole: Sequence[int]) -> bool:
    return not shape or (len(shape) == len(whole) and all(a in (1, b) for a, b in zip(shape, whole, strict=True)))


def _spread(value: Value, shape: tuple[int, ...]) -> Value:
    if isinstance(value, Element) or value.shape == shape:
        return value
    return moved(value, lambda a: np.broadcast_to(a, shape))
