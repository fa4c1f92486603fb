"""What moves elements about: places are moved by the rules of `structure`; what has none in common is copied."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from sigmax.native.loops.groups import Element
from sigmax.native.loops.views import View
from sigmax.native.loops.writer import Value, Writer, moved, writes
from sigmax.native.primitives.interpret import RULES


@writes("concatenate", "stack")
def _concatenate(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value]:
    stacked = equation.primitive.name == "stack"
    axis = equation.params["axis" if stacked else "dimension"]
    if stacked:
        values = [_new_axis(w, v, axis) for v in values]
    parts = _neighbours([v for v in values if v.shape[axis]], axis)
    if len(parts) == 1:
        return list(parts)
    out = _like(w, equation, parts, lambda arrays: np.concatenate(arrays, axis))
    at = 0
    for part in parts:
        size = part.shape[axis]
        place = (slice(None),) * axis + (slice(at, at + size),)
        w.put(part, out._replace(at=out.at[place], zero=None))
        at += size
    return [out]


def _new_axis(w: Writer, value: Value, axis: int) -> Value:
    value = w.settled(value) if isinstance(value, Element) else value
    return moved(value, lambda a: np.expand_dims(a, axis))


def _neighbours(values: Sequence[Value], axis: int) -> list[Value]:
    """Arrays that lie in one buffer as one array, and known ones."""
    parts: list[Value] = []
    for value in values:
        before = parts[-1] if parts else None
        if isinstance(value, View) and isinstance(before, View) and value.buffer is before.buffer:
            zero = _joined_zeros([before, value], axis)
            parts[-1] = View(
                before.buffer, np.concatenate([before.at, value.at], axis), before.truth, zero, _bounds([before, value])
            )
        elif isinstance(value, np.ndarray) and isinstance(before, np.ndarray):
            parts[-1] = np.concatenate([before, value], axis)
        else:
            parts.append(value)
    return parts


def _zero(value: Value) -> np.ndarray:
    if isinstance(value, np.ndarray):
        return np.asarray(value == 0)
    return np.zeros(value.shape, bool) if value.zero is None else value.zero


def _joined_zeros(values: Sequence[Value], axis: int) -> np.ndarray | None:
    zero = np.concatenate([_zero(v) for v in values], axis)
    return zero if zero.any() else None


def _bounds(values: Sequence[Value]) -> tuple[float, float] | None:
    """Between which integers all lie; None of numbers."""
    each = [_bounds_of(v) for v in values if 0 not in v.shape]
    if not each or any(b is None for b in each):
        return None
    return min(b[0] for b in each if b), max(b[1] for b in each if b)


def _bounds_of(value: Value) -> tuple[float, float] | None:
    if isinstance(value, np.ndarray):
        return (float(value.min()), float(value.max())) if value.dtype.kind in "iu" else None
    return value.bounds


def _like(w: Writer, equation: Any, parts: Sequence[Value], join: Any) -> View:
    """A new array of what the parts are: truth values, integers, zeros."""
    aval = equation.outvars[0].aval
    zero = join([_zero(p) for p in parts])
    bounds = _bounds(parts) if aval.dtype.kind in "iu" else None
    out = w.lines.new(tuple(aval.shape), aval.dtype == bool, bounds)
    return out._replace(zero=zero if zero.any() else None)


@writes("pad")
def _pad(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    value, filling = values
    if not isinstance(filling, np.ndarray) or isinstance(value, np.ndarray):
        return None
    view = w.settled(value)
    # Places are counted from 1, so that nothing is at 0.
    places = RULES["pad"].function(_Alike, equation, view.at + 1, np.asarray(0)) - 1
    return [filled(w, view._replace(at=places, zero=None), filling)]


class _Alike:
    """A graph, as far as the rule of "pad" needs one for numbers."""

    @staticmethod
    def alike(arrays: Sequence[np.ndarray]) -> Sequence[np.ndarray]:
        return arrays


def filled(w: Writer, view: View, filling: np.ndarray) -> View:
    """An array whose places below 0 are holes, with something known in them."""
    zero = (view.at < 0) if not filling.any() else None
    out = w.lines.new(view.shape, view.truth, _bounds([view, filling]) if view.bounds else None)
    there = view.at >= 0
    w.put(View(view.buffer, view.at[there], view.truth, None, view.bounds), out._replace(at=out.at[there]))
    w.put(np.broadcast_to(filling, ((~there).sum(),)), out._replace(at=out.at[~there]))
    return out._replace(zero=zero)


@writes("dynamic_slice")
def _dynamic_slice(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    a, *starts = values
    if not all(isinstance(s, np.ndarray) for s in starts):
        return None
    sizes = equation.params["slice_sizes"]
    first = [min(max(int(s), 0), n - k) for s, n, k in zip(starts, a.shape, sizes, strict=True)]
    return [w.settled(a).moved(lambda at: at[tuple(slice(i, i + k) for i, k in zip(first, sizes, strict=True))])]


@writes("gather")
def _gather(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    a, indices = values
    if not isinstance(indices, np.ndarray) or isinstance(a, np.ndarray):
        return None
    places = _blocks(equation, a.shape, indices)
    if places is None:
        return None
    return [w.settled(a).moved(lambda at: at.ravel()[places])]


def _blocks(equation: Any, shape: tuple[int, ...], indices: np.ndarray) -> np.ndarray | None:
    """Which elements, counted row by row, a gather takes; None where one lies outside."""
    d, sizes = equation.params["dimension_numbers"], equation.params["slice_sizes"]
    numbers = np.arange(int(np.prod(shape))).reshape(shape)
    gone = (*d.collapsed_slice_dims, *d.operand_batching_dims)
    kept = [k for i, k in enumerate(sizes) if i not in gone]
    batch = indices.shape[:-1]
    out = np.empty((*batch, *kept), int)
    for place in np.ndindex(*batch):
        starts = [0] * len(shape)
        for j, axis in enumerate(d.start_index_map):
            starts[axis] = int(indices[(*place, j)])
        for axis, of in zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True):
            starts[axis] = place[of]
        if any(not 0 <= s <= n - k for s, n, k in zip(starts, shape, sizes, strict=True)):
            return None
        out[place] = numbers[tuple(slice(s, s + k) for s, k in zip(starts, sizes, strict=True))].reshape(kept)
    order = [-1] * out.ndim
    for i, axis in enumerate(d.offset_dims):
        order[axis] = len(batch) + i
    rest = iter(range(len(batch)))
    return out.transpose([next(rest) if i < 0 else i for i in order])


@writes("scatter", "scatter-add", "scatter_add", "scatter-mul", "scatter_mul")
def _scatter(w: Writer, equation: Any, values: Sequence[Value]) -> list[Value] | None:
    a, indices, updates = values
    aval, function = equation.outvars[0].aval, equation.params.get("update_jaxpr")
    operation = {"add": "+", "mul": "*"}.get(equation.primitive.name[8:])
    plain = operation or function is None or (not function.eqns and function.outvars[0] is function.invars[1])
    if not isinstance(indices, np.ndarray) or not plain or (operation and aval.dtype.kind != "f"):
        return None
    to = _targets(equation, a.shape, indices, updates.shape)
    if to is None or len(np.unique(to)) != to.size:
        return None
    rest = np.setdiff1d(np.arange(int(np.prod(a.shape))), to.ravel())
    out = _like(w, equation, [a, updates], lambda zeros: np.zeros(a.shape, bool))
    places = out.at.ravel()
    w.put(_picked(w, a, rest), out._replace(at=places[rest]))
    new = _picked(w, updates, np.arange(to.size))
    if operation is None:
        w.put(new, out._replace(at=places[to.ravel()]))
    else:
        group, (x, y) = w.joined([_picked(w, a, to.ravel()), new], (to.size,))
        group.store(group.graph.apply(operation, group.node(x), group.node(y)), out._replace(at=places[to.ravel()]))
    return [out]


def _picked(w: Writer, value: Value, places: np.ndarray) -> Value:
    return moved(w.settled(value), lambda a: a.ravel()[places])


def _targets(equation: Any, shape: tuple[int, ...], indices: np.ndarray, updates: tuple[int, ...]) -> np.ndarray | None:
    """Which element of a scatter's operand each update goes to; None where one lies outside."""
    d = equation.params["dimension_numbers"]
    gone = (*d.inserted_window_dims, *d.operand_batching_dims)
    windows = iter([updates[i] for i in d.update_window_dims])
    sizes = [1 if i in gone else next(windows) for i in range(len(shape))]
    numbers = jax.lax.GatherDimensionNumbers(
        offset_dims=d.update_window_dims,
        collapsed_slice_dims=d.inserted_window_dims,
        start_index_map=d.scatter_dims_to_operand_dims,
        operand_batching_dims=d.operand_batching_dims,
        start_indices_batching_dims=d.scatter_indices_batching_dims,
    )
    return _blocks(_Window({"dimension_numbers": numbers, "slice_sizes": sizes}), shape, indices)


class _Window:
    def __init__(self, params: dict[str, Any]) -> None:
        self.params = params
