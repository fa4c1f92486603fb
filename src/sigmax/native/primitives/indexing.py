"""Rules of indexing, with known and with computed indices."""

import functools
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import jax
import numpy as np

from sigmax.native.graph import Array, Graph
from sigmax.native.node import Node
from sigmax.native.primitives.integers import Binary, combining, compared
from sigmax.native.primitives.interpret import rule
from sigmax.native.refusal import Refused

# More places than these are not chosen among one by one.
_MOST_CHOICES = 512


def _clipped(g: Graph, start: Node, largest: int) -> Node:
    if largest <= 0:
        return g.constant(0.0)
    return compared(g, "min", compared(g, "max", start, g.constant(0.0)), g.constant(float(largest)))


def _window(g: Graph, a: Array, starts: Sequence[Node], sizes: Sequence[int]) -> Array:
    """A block of an array that begins at computed places, moved inside where it would stick out."""
    starts = [_clipped(g, s, n - k) for s, n, k in zip(starts, a.shape, sizes, strict=True)]
    if all(s.known for s in starts):
        return g.opened(a[tuple(slice(int(s.value), int(s.value) + k) for s, k in zip(starts, sizes, strict=True))])
    out = np.empty(tuple(sizes), dtype=object)
    table = g.known_numbers(a)
    if table is not None:
        strides = [int(np.prod(a.shape[d + 1 :])) for d in range(a.ndim)]
        first = g.constant(0.0)
        for start, stride in zip(starts, strides, strict=True):
            first = g.apply("+", first, g.apply("*", start, g.constant(float(stride))))
        for place in np.ndindex(out.shape):
            offset = float(sum(i * s for i, s in zip(place, strides, strict=True)))
            out[place] = g.look_up(table, g.apply("+", first, g.constant(offset)))
        if table.dtype == bool or (a.dtype == object and a.flat[0].truth):
            out = np.frompyfunc(lambda x: g.apply("!=", x, g.constant(0.0)), 1, 1)(out)
        return out
    a = g.opened(a)
    choices = [[int(s.value)] if s.known else range(n - k + 1) for s, n, k in zip(starts, a.shape, sizes, strict=True)]
    if np.prod([len(c) for c in choices]) > _MOST_CHOICES:
        raise Refused(f"an index computed among more than {_MOST_CHOICES} computed values cannot be lowered to C")
    result = None
    for at in product(*choices):
        block = a[tuple(slice(i, i + k) for i, k in zip(at, sizes, strict=True))]
        if result is None:
            result = block
        else:
            here = _all_equal(g, starts, at)
            result = np.frompyfunc(lambda x, y, p=here: g.apply("select", p, x, y), 2, 1)(block, result)
    assert result is not None
    return result


def _all_equal(g: Graph, starts: Sequence[Node], at: Sequence[int]) -> Node:
    here = g.constant(True)
    for start, i in zip(starts, at, strict=True):
        if not start.known:
            here = g.apply("and", here, g.apply("==", start, g.constant(float(i))))
    return here


@rule("dynamic_slice", parameters="slice_sizes", any_width=True, tables=True)
def _dynamic_slice(g: Graph, equation: Any, a: Array, *starts: Array) -> Array:
    return _window(g, a, [g.opened(s)[()] for s in starts], equation.params["slice_sizes"])


def _put(g: Graph, out: Array, starts: Sequence[Node], block: Array, operation: Binary | None) -> None:
    """Write (or combine) a block into an array at computed places."""
    largest = [n - k for n, k in zip(out.shape, block.shape, strict=True)]
    choices = [[int(s.value)] if s.known else range(most + 1) for s, most in zip(starts, largest, strict=True)]
    if np.prod([len(c) for c in choices]) > _MOST_CHOICES:
        raise Refused(f"an index computed among more than {_MOST_CHOICES} places to write to cannot be lowered to C")
    before = out.copy()
    for at in product(*choices):
        here = _all_equal(g, starts, at)
        for place in np.ndindex(block.shape):
            to = tuple(i + j for i, j in zip(at, place, strict=True))
            if not all(0 <= i < n for i, n in zip(to, out.shape, strict=True)):
                continue
            new = block[place] if operation is None else operation(before[to], block[place])
            out[to] = g.apply("select", here, new, out[to])


@rule("dynamic_update_slice", any_width=True)
def _dynamic_update_slice(g: Graph, equation: Any, a: Array, block: Array, *starts: Array) -> Array:
    out = a.copy()
    inside = [_clipped(g, s[()], n - k) for s, n, k in zip(starts, a.shape, block.shape, strict=True)]
    _put(g, out, inside, block, None)
    return out


def _filled(equation: Any) -> bool:
    """Whether what lies outside is filled or dropped; else it is taken from inside.

    Raises:
        Refused: for another mode.
    """
    mode, modes = equation.params["mode"], jax.lax.GatherScatterMode
    if mode not in (modes.FILL_OR_DROP, modes.CLIP, modes.PROMISE_IN_BOUNDS):
        raise Refused(f"the operation {equation.primitive.name!r} with mode={mode} cannot be lowered to C")
    return bool(mode == modes.FILL_OR_DROP)


def _inside(g: Graph, starts: Sequence[Node], largest: Sequence[int]) -> Node:
    here = g.constant(True)
    for start, most in zip(starts, largest, strict=True):
        here = g.apply("and", here, compared(g, ">=", start, g.constant(0.0)))
        here = g.apply("and", here, compared(g, "<=", start, g.constant(float(most))))
    return here


def _starts(
    g: Graph,
    axes: int,
    indices: Array,
    place: tuple[int, ...],
    indexed: Sequence[int],
    batching: Iterable[tuple[int, int]],
) -> list[Node]:
    """Where the block of one place of the indices begins: by the indices themselves, along `batching` by the place."""
    starts = [g.constant(0.0)] * axes
    for j, axis in enumerate(indexed):
        starts[axis] = indices[(*place, j)]
    for axis, of in batching:
        starts[axis] = g.constant(float(place[of]))
    return starts


_OF_GATHER = "dimension_numbers slice_sizes mode fill_value unique_indices indices_are_sorted"


@rule("gather", parameters=_OF_GATHER, any_width=True, tables=True)
def _gather(g: Graph, equation: Any, a: Array, indices: Array) -> Array:
    d, sizes = equation.params["dimension_numbers"], equation.params["slice_sizes"]
    indices = g.opened(indices)
    batch = indices.shape[:-1]
    gone = (*d.collapsed_slice_dims, *d.operand_batching_dims)
    kept = [k for i, k in enumerate(sizes) if i not in gone]
    out = np.empty((*batch, *kept), dtype=object)
    for place in np.ndindex(*batch):
        batching = zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True)
        starts = _starts(g, a.ndim, indices, place, d.start_index_map, batching)
        block = _window(g, a, starts, sizes).reshape(kept)
        if _filled(equation):
            inside = _inside(g, starts, [n - k for n, k in zip(a.shape, sizes, strict=True)])
            block = np.frompyfunc(lambda x, p=inside: g.apply("select", p, x, _fill(g, equation, x)), 1, 1)(block)
            block = np.asarray(block, dtype=object).reshape(kept)
        out[place] = block if kept else block[()]
    # The window's axes go where the equation says, the batch's in their order to the places left.
    order: list[int] = [-1] * out.ndim
    for i, axis in enumerate(d.offset_dims):
        order[axis] = len(batch) + i
    rest = iter(range(len(batch)))
    return out.transpose([next(rest) if i < 0 else i for i in order])


def _fill(g: Graph, equation: Any, x: Node) -> Node:
    given = equation.params.get("fill_value")
    if x.truth:
        return g.constant(given is None or bool(given))
    if given is not None:
        return g.constant(float(given))
    dtype = np.dtype(equation.outvars[0].aval.dtype)
    if np.issubdtype(dtype, np.floating):
        return g.constant(np.nan)
    return g.constant(float(np.iinfo(dtype).min if np.issubdtype(dtype, np.signedinteger) else np.iinfo(dtype).max))


_SCATTERS = {
    "scatter": None,
    "scatter-add": "+",
    "scatter_add": "+",
    "scatter-mul": "*",
    "scatter_mul": "*",
    "scatter-sub": "-",
    "scatter_sub": "-",
    "scatter-min": "min",
    "scatter_min": "min",
    "scatter-max": "max",
    "scatter_max": "max",
}


def _combination(g: Graph, equation: Any) -> Binary | None:
    """What becomes of an element and its update; None where the update stands in its place."""
    operation, function = _SCATTERS[equation.primitive.name], equation.params.get("update_jaxpr")
    if operation is None:
        replaces = function is None or (not function.eqns and function.outvars[0] is function.invars[1])
        if not replaces:
            raise Refused(f"the operation {equation.primitive.name!r} with its own function cannot be lowered to C")
        return None
    if equation.outvars[0].aval.dtype == bool:
        raise Refused(f"the operation {equation.primitive.name!r} on truth values cannot be lowered to C")
    if equation.outvars[0].aval.dtype.kind in "iu":
        return combining(g, operation, equation.outvars[0].aval.dtype)
    return functools.partial(g.apply, operation)


_OF_SCATTER = "dimension_numbers mode update_jaxpr update_consts unique_indices indices_are_sorted"


@rule(*_SCATTERS, parameters=_OF_SCATTER)
def _scatter(g: Graph, equation: Any, a: Array, indices: Array, updates: Array) -> Array:
    d = equation.params["dimension_numbers"]
    operation = _combination(g, equation)
    out = a.copy()
    batch = indices.shape[:-1]
    windows = d.update_window_dims
    loose = [i for i in range(updates.ndim) if i not in windows]
    blocks = updates.transpose(*loose, *windows)
    gone = (*d.inserted_window_dims, *d.operand_batching_dims)
    shape = iter([updates.shape[i] for i in windows])
    sizes = [1 if i in gone else next(shape) for i in range(a.ndim)]
    for place in np.ndindex(*batch):
        batching = zip(d.operand_batching_dims, d.scatter_indices_batching_dims, strict=True)
        starts = _starts(g, a.ndim, indices, place, d.scatter_dims_to_operand_dims, batching)
        block = np.asarray(blocks[place], dtype=object).reshape(sizes)
        if not _filled(equation):
            starts = [_clipped(g, s, n - k) for s, n, k in zip(starts, a.shape, sizes, strict=True)]
        _put(g, out, starts, block, operation)
    return out
