"""Arrays of objects as arrays of JAX: what lies together in one array is taken from it together."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.tracing.number import Number

# More pieces than these are picked from an array at once.
_FEW_PIECES = 4


def gathered(value: Any) -> Any:
    """An array as JAX computes with it: of NumPy where all is known."""
    if isinstance(value, Number):
        return value.value
    if not isinstance(value, np.ndarray) or not value.view(np.ndarray).dtype.hasobject:
        return value
    items = value.view(np.ndarray).ravel().tolist()
    traced = [i for i in items if isinstance(i, Number | jax.Array)]
    if not traced:
        return np.array(items, None if items else float).reshape(value.shape)
    source: Any = getattr(traced[0], "source", None)
    if len(traced) == len(items) and all(getattr(i, "source", None) is source for i in traced) and source.ndim:
        places = [i.place for i in items]
        if places == list(range(source.size)):
            return source.reshape(value.shape)
        if len(list(_runs(items))) > _FEW_PIECES:
            return source.at[np.array(places)].get(mode="promise_in_bounds").reshape(value.shape)
    kind = jnp.result_type(*{i.dtype for i in traced})
    known = [i for i in items if not isinstance(i, Number | jax.Array)]
    if known and not jnp.issubdtype(kind, jnp.floating):
        kind = jnp.result_type(kind, np.asarray(known).dtype)
    pieces = [_piece(run).astype(kind) for run in _runs(items)]
    whole = jnp.concatenate(pieces) if len(pieces) > 1 else jnp.asarray(pieces[0])
    return whole.reshape(value.shape)


def _runs(items: Sequence[Any]) -> Iterator[list[Any]]:
    """Elements that follow each other in one array, or are known."""
    run: list[Any] = []
    for item in items:
        if run and not _follows(run[-1], item):
            yield run
            run = []
        run.append(item)
    yield run


def _follows(last: Any, item: Any) -> bool:
    if isinstance(last, Number) and isinstance(item, Number):
        same = last.source is item.source
        return same and last.place is not None and item.place is not None and item.place == last.place + 1
    return not isinstance(last, Number | jax.Array) and not isinstance(item, Number | jax.Array)


def _piece(run: list[Any]) -> Any:
    first = run[0]
    if isinstance(first, Number) and first.place is not None:
        return jax.lax.slice(first.source, (first.place,), (first.place + len(run),))
    if isinstance(first, Number | jax.Array):
        return jnp.reshape(gathered(first), (1,))
    return np.array(run)
