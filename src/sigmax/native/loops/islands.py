"""An equation that has a rule over scalars alone: a straight line of its own between arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.loops.views import View
from sigmax.native.loops.writer import Value, Writer, writes
from sigmax.native.pieces import Program
from sigmax.native.primitives.integers import bounded
from sigmax.native.primitives.interpret import apply_rule
from sigmax.native.primitives.intervals import interval
from sigmax.native.refusal import Refused

_MOST = 50_000


@writes("island")
def _island(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    many = Refused(f"the operation {equation.primitive.name!r} on so many numbers cannot be lowered to C")
    if sum(int(np.prod(v.aval.shape)) for v in (*equation.invars, *equation.outvars)) > _MOST:
        raise many
    g = Graph(w.dtype)
    inputs = {f"a{k}": w.lying(v) for k, v in enumerate(values) if not isinstance(v, np.ndarray)}
    given = [_symbols(g, f"a{k}", inputs[f"a{k}"]) if f"a{k}" in inputs else v for k, v in enumerate(values)]
    results = [g.opened(r) for r in apply_rule(g, equation, given)]
    out = []
    for result, variable in zip(results, equation.outvars, strict=True):
        if variable.aval.dtype.kind in "iu":
            result = boxed(np.frompyfunc(g.certain, 1, 1)(result))
        out.append((result, _like(w, g, result, variable.aval)))
    program = Program(g, tuple(inputs), {f"o{k}": list(result.flat) for k, (result, _) in enumerate(out)})
    name = w.lines.text.island(program)
    if name is None:
        raise many
    pointers = [w.lines.pointer(v) for v in (*inputs.values(), *(view for _, view in out))]
    w.lines.say(f"{name}({', '.join(pointers)});", w.label)
    return [view for _, view in out]


def _symbols(g: Graph, name: str, view: View) -> Array:
    nodes = g.inputs(name, view.shape)
    if view.bounds is not None:
        for node in nodes.flat:
            bounded(g, node, view.bounds[0], view.bounds[1] + 1)
    zero = g.constant(0.0)
    if view.zero is not None:
        nodes = boxed(np.where(view.zero, boxed(zero), nodes))
    return boxed(np.frompyfunc(lambda x: g.apply("!=", x, zero), 1, 1)(nodes)) if view.truth else nodes


def _like(w: Writer, g: Graph, result: Array, aval: Any) -> View:
    nodes = list(result.flat)
    zero = np.array([n.known and not n.value for n in nodes], bool).reshape(result.shape)
    bounds = None
    if aval.dtype.kind in "iu":
        each = [interval(g, n) for n in nodes]
        bounds = min(low for low, _ in each), max(high for _, high in each)
    view = w.lines.new(tuple(aval.shape), aval.dtype == bool, bounds)
    return view._replace(zero=zero if zero.any() else None)
