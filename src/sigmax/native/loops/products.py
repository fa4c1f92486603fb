"""Reductions and products as loops within loops."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.native.emit import literal
from sigmax.native.loops.text import over
from sigmax.native.loops.views import View, walk
from sigmax.native.loops.writer import Value, Writer, moved, writes
from sigmax.native.operations import OPERATIONS
from sigmax.native.primitives.elementwise import REDUCED_TRUTH, REDUCTIONS


@writes(*REDUCTIONS)
def _reduction(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    name, (value,), aval = equation.primitive.name, values, equation.outvars[0].aval
    truth, axes = equation.invars[0].aval.dtype == bool, equation.params["axes"]
    if truth and name in ("reduce_sum", "reduce_prod"):
        return None
    operation, start = (REDUCED_TRUTH if truth else {}).get(name, REDUCTIONS[name])
    count = math.prod(value.shape[d] for d in axes)
    bounds = None if truth or value.bounds is None else _bounds(operation, value.bounds, count)
    if aval.dtype.kind in "iu" and (bounds is None or not _exact(w, bounds, aval.dtype)):
        return None
    if count == 0:
        return None
    view = w.settled(value)
    kept = [d for d in range(view.at.ndim) if d not in axes]
    out = w.lines.new(tuple(aval.shape), truth, bounds)
    steps, to = walk(view.at.transpose(*kept, *axes)), walk(out.at)
    outer = [f"i{k}" for k in range(len(kept))]
    inner = [f"j{k}" for k in range(len(axes))]
    element = w.lines.element(view.buffer, steps, [*outer, *inner])
    loops = over(inner, [view.shape[d] for d in axes])
    if truth:
        first = "ALL" if start else "(ALL ^ ALL)"
        term, kind, last = f"v_truth({element})", "M", "v_number(s)"
    else:
        first, term, kind, last = f"K({literal(float(start))})", element, "V", "s"
    body = [
        f"{kind} s = {first};",
        f"{loops} s = {OPERATIONS[operation].lanes.format('s', term)};",
        f"{w.lines.element(out.buffer, to, outer)} = {last};",
    ]
    w.lines.nest([view.shape[d] for d in kept], body, w.label)
    return [out]


def _bounds(operation: str, bounds: tuple[float, float], count: int) -> tuple[float, float] | None:
    """Between which numbers a reduction of so many lies, None where nobody says."""
    low, high = bounds
    if operation != "+":
        return bounds if operation in ("max", "min") else None
    low, high = min(low, low * count), max(high, high * count)
    whole = low.is_integer() and high.is_integer()
    return (low, high) if whole else (low - abs(low) * 1e-6, high + abs(high) * 1e-6)


def _exact(w: Writer, bounds: tuple[float, float], dtype: Any) -> bool:
    """Whether integers of a type between these are held exactly."""
    about, exact = np.iinfo(dtype), 2.0 ** (np.finfo(w.dtype).nmant + 1)
    return max(float(about.min), -exact) <= bounds[0] and bounds[1] <= min(float(about.max), exact)


@writes("dot_general")
def _dot_general(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    aval = equation.outvars[0].aval
    if aval.dtype.kind != "f" or equation.params["precision"] is not None:
        return None
    if any(v.aval.dtype.kind != "f" for v in equation.invars):
        return None
    (ca, cb), (ba, bb) = equation.params["dimension_numbers"]
    a, b = (v if isinstance(v, np.ndarray) else w.settled(v) for v in values)
    fa = [d for d in range(len(a.shape)) if d not in (*ca, *ba)]
    fb = [d for d in range(len(b.shape)) if d not in (*cb, *bb)]
    a, b = _turned(a, (*ba, *fa, *ca)), _turned(b, (*bb, *fb, *cb))
    batch, rows, columns, summed = len(ba), len(fa), len(fb), len(ca)
    shape = tuple(aval.shape)
    if not ca:
        return [_without_sum(w, a, b, batch, rows, columns, shape)]
    terms = tuple(a.shape[-summed:])
    if 0 in terms:
        return None
    if not ba:
        r, s, k = math.prod(a.shape[:rows]), math.prod(b.shape[:columns]), math.prod(terms)
        a, b, out = _reshaped(a, (r, k)), _reshaped(b, (s, k)), w.lines.new((r, s))
        if isinstance(a, np.ndarray):
            _sparse(w, a, b, out)
        elif isinstance(b, np.ndarray):
            _sparse(w, b, a, out.moved(np.transpose))
        else:
            matrix_product(w, a, _turned(b, (1, 0)), out)
        return [out.moved(lambda at: at.reshape(shape))]
    out = w.lines.new(shape)
    a, b = (w.lying(v) if isinstance(v, np.ndarray) else v for v in (a, b))
    a = a.moved(lambda at: at.reshape(*at.shape[: batch + rows], *(1,) * columns, *terms))
    b = b.moved(lambda at: at.reshape(*at.shape[:batch], *(1,) * rows, *at.shape[batch:]))
    outer, inner = [f"i{d}" for d in range(len(shape))], [f"j{d}" for d in range(summed)]
    texts = [w.lines.element(v.buffer, walk(v.spread((*shape, *terms)).at), [*outer, *inner]) for v in (a, b)]
    to = w.lines.element(out.buffer, walk(out.at), outer)
    w.lines.nest(shape, ["V s = K(0);", f"{over(inner, terms)} s += {texts[0]} * {texts[1]};", f"{to} = s;"], w.label)
    return [out]


def _turned(value: Value, axes: Sequence[int]) -> Value:
    return moved(value, lambda a: a.transpose(axes))


def _reshaped(value: Value, shape: tuple[int, ...]) -> Value:
    return moved(value, lambda a: a.reshape(shape))


def _without_sum(w: Writer, a: Value, b: Value, batch: int, rows: int, columns: int, shape: tuple[int, ...]) -> Value:
    """Each element of one with each of the other."""
    a = _reshaped(a, (*a.shape[: batch + rows], *(1,) * columns))
    b = _reshaped(b, (*b.shape[:batch], *(1,) * rows, *b.shape[batch:]))
    group, (x, y) = w.joined([a, b], shape)
    return group.element(group.graph.apply("*", group.node(x), group.node(y)))


def _sparse(w: Writer, known: np.ndarray, b: View, out: View) -> None:
    """A known matrix (r, k) times the rows of b (s, k): its zeros cost nothing."""
    rows, columns = np.nonzero(known)
    first = w.lines.text.table(np.searchsorted(rows, np.arange(len(known) + 1)), "int")
    which, weight = w.lines.text.table(columns, "int"), w.lines.text.table(known[rows, columns], "R")
    term = w.lines.element(b.buffer, walk(b.at), ["i1", f"{which}[p]"])
    to = w.lines.element(out.buffer, walk(out.at), ["i0", "i1"])
    body = [
        "V s = K(0);",
        f"for (int p = {first}[i0]; p < {first}[i0 + 1]; p++) s += K({weight}[p]) * {term};",
        f"{to} = s;",
    ]
    w.lines.nest(out.shape, body, w.label)


def matrix_product(w: Writer, a: Value, b: Value, out: View, symmetric: bool = False) -> None:
    """A (r, k) times b (k, s), written to `out`, which lies row by row."""
    (a, of_a), (b, of_b) = (_even(w, v) for v in (a, b))
    (r, k), s = a.shape, b.shape[1]
    w.lines.say(
        f"k_product({r}, {s}, {k}, {w.lines.pointer(a)}, {of_a[0]}, {of_a[1]}, {w.lines.pointer(b)}, {of_b[0]}, "
        f"{of_b[1]}, {w.lines.pointer(out)}, {int(symmetric)});",
        w.label,
    )


def _even(w: Writer, value: Value) -> tuple[View, tuple[Any, ...]]:
    """A matrix whose rows and columns follow each other in even steps, and these."""
    view = w.lying(value) if isinstance(value, np.ndarray) else w.settled(value)
    steps = walk(view.at)
    if view.buffer.same or steps.table is not None or not all(isinstance(s, int) for s in steps.axes):
        view = w.lying(view, fresh=True)
        steps = walk(view.at)
    return view, steps.axes
