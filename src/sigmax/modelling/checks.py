"""Checks at the edge of the library; values being traced are let through."""

import os
from collections.abc import Iterator, KeysView, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from decimal import Decimal
from functools import cache
from numbers import Real
from pathlib import Path
from types import NoneType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError

# What holds no number that is being traced: asked for often, and its leaves take time. Iterators are not to be used up.
_UNTRACED = (np.ndarray, float, int, NoneType, Iterator)


def is_traced(value: Any) -> bool:
    """Whether a value is being differentiated or compiled, so that its numbers are not known."""
    if isinstance(value, _UNTRACED):
        return False
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def strings(what: str, given: Any, ordered: bool = True) -> tuple[str, ...]:
    """Names, or one alone, as a tuple.

    Raises:
        InputError: for anything but text, and for a set or a dict where their order says what they name.
    """
    if ordered and isinstance(given, AbstractSet | Mapping) and not isinstance(given, KeysView):
        kind = type(given).__name__
        raise InputError(f"{what} must be names in order, a tuple or a list; a {kind} has no order to go by: {given!r}")
    names = [given] if isinstance(given, str) else members(given)
    if names is None or not all(isinstance(name, str) for name in names):
        raise InputError(f"{what} must be one or several names in quotes; it is {given!r}")
    return tuple(names)


def members(given: Any) -> list[Any] | None:
    """What a collection holds, None where it is none."""
    try:
        return list(given)
    except TypeError:
        return None


def numbers(what: str, value: Any, missing: bool = False) -> Any:
    """`value` as an array of float64 or float32: the one place where what people hand over becomes numbers.

    Args:
        what: what it is called in messages.
        value: anything array-like: lists, arrays of any real type, masked arrays, series and frames.
        missing: whether None, NA, NaT and what is masked may stand in it, as NaN.

    Raises:
        InputError: where it does not consist of real numbers, or something is missing that may not.
    """
    if type(value) is np.ndarray and value.dtype in _OURS:
        return value
    if is_traced(value):
        array = jnp.asarray(value)
        if jnp.issubdtype(array.dtype, jnp.complexfloating):
            raise InputError(f"{what} must be an array of real numbers; it has the type {array.dtype}")
        return array if array.dtype in _OURS else array.astype(float)
    try:
        return _floats(what, value, missing)
    except InputError:
        raise
    except Exception as error:  # arrays of other libraries raise what they like
        raise InputError(f"{what} must be an array of real numbers; {error}") from error


def own(array: Any) -> Any:
    """A copy that nobody can change: what was checked stays as it was. Arrays of JAX never change."""
    if isinstance(array, np.ndarray):
        array = array.copy()
        array.flags.writeable = False
    return array


def by_name(what: str, value: Any, names: Sequence[str] | None) -> Any:
    """A table of pandas, polars or Arrow, or a series, in the order of `names`; anything else as it is.

    Where one side has no names, such as columns that are only counted, the order is taken for that of the names.

    Raises:
        InputError: where it has other names.
    """
    # Arrow's tables have names beside columns, others have columns that are names.
    labels = getattr(value, "column_names", getattr(value, "columns", None))
    frame = labels is not None
    if labels is None and type(value).__name__ == "Series" and hasattr(value, "index"):
        labels = getattr(value.index, "tolist", list)()
    if type(value) is np.ndarray or labels is None or not names:
        return value
    given = list(labels)
    wanted = list(map(str, names))
    counted = [[f"{kind}{i}" for i in range(len(wanted))] for kind in ("state", "measurement")]
    known = all(isinstance(name, str) for name in given) and wanted not in counted
    if not given or not known or given[: len(wanted)] == wanted:
        return value
    if len(given) != len(wanted) or set(given) != set(wanted):
        kind = "columns" if frame else "entries"
        raise InputError(
            f"{what} has {kind} {given}, the model {wanted}: rename them, or give their values alone, {what}.to_numpy()"
        )
    return value.select(wanted) if hasattr(value, "column_names") else value[wanted]


_OURS = (np.dtype(np.float64), np.dtype(np.float32))


def _floats(what: str, value: Any, missing: bool) -> np.ndarray:
    data, mask = _unmasked(_whole(value))
    array = np.asarray(data)
    if array.dtype.kind == "O":
        array, absent = _from_objects(array)
        mask = mask | absent
    elif jnp.issubdtype(array.dtype, jnp.floating) or array.dtype.kind in "iub":
        array = array if array.dtype in _OURS else array.astype(float)
    else:
        raise TypeError(f"it has the type {array.dtype}")
    if not np.any(mask):
        return array
    if not missing:
        place = [int(i) for i in np.argwhere(mask)[0]]
        where = f"at {place} it" if place else "it"
        raise InputError(f"{what} must be complete; {where} is masked or None, and only measurements may be missing")
    return np.where(mask, np.nan, array)


def _unmasked(value: Any) -> tuple[Any, Any]:
    """Masked arrays, alone or in lists, as their data and what is masked; anything else as it is, and False."""
    if np.ma.isMaskedArray(value):
        return np.ma.getdata(value), np.ma.getmaskarray(value)
    if isinstance(value, list | tuple) and any(isinstance(v, list | tuple | np.ma.MaskedArray) for v in value):
        parts = [_unmasked(v) for v in value]
        if any(mask is not False for _, mask in parts):
            data = [part for part, _ in parts]
            return data, np.array([np.broadcast_to(mask, np.shape(part)) for part, mask in parts])
    return value, False


def _whole(value: Any) -> Any:
    """Lists in which None stands for a whole row, with a row of None in its place."""
    if not isinstance(value, list | tuple) or not any(_is_row(v) for v in value):
        return value
    found = [_whole(v) for v in value]
    if all(v is not None for v in found):
        return found
    like = np.shape(next(v for v in found if _is_row(v)))
    return [np.full(like, None, object).tolist() if v is None else v for v in found]


def _is_row(value: Any) -> bool:
    return isinstance(value, list | tuple | np.ndarray) and not np.ma.isMaskedArray(value)


def _from_objects(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of any Python type, and where there are none: None, NA and NaT, which differ from themselves."""
    found, absent = np.zeros(array.shape), np.zeros(array.shape, bool)
    for place, one in np.ndenumerate(array):
        if one is None or type(one).__name__ in ("NAType", "NaTType", "MaskedConstant"):
            absent[place] = True
        elif isinstance(one, Real | Decimal | np.bool_):
            found[place] = float(one)
        else:
            raise TypeError(f"{one!r} is {type(one).__name__}")
    return found, absent


def finite(what: str, value: Any) -> None:
    """Refuse NaN and infinity.

    Raises:
        InputError: naming the first place that is not finite.
    """
    if not is_traced(value) and not np.isfinite(value).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(np.asarray(value)))[0])
        raise InputError(f"{what} must be finite; it has {np.asarray(value)[place]} at {list(place)}")


def enough_memory(what: str, floats: float) -> None:
    """Refuse what this machine has no memory for, before any of it is taken.

    Args:
        what: what takes it, in words.
        floats: how many numbers of eight bytes.

    Raises:
        InputError: where it is more than the machine, or this process, may have.
    """
    if floats * 8 > (most := _memory()):
        raise InputError(
            f"{what} would take {floats * 8 / 2**30:.3g} GiB, and there are {most / 2**30:.3g}: run it in parts, or "
            "keep less of the result by keep="
        )


@cache
def _memory() -> float:
    """Bytes that this process may have."""
    found = [np.inf]
    with suppress(OSError, ValueError, AttributeError):
        found.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(ImportError, OSError, ValueError):
        import resource  # not on every system

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        found += [limit] if limit != resource.RLIM_INFINITY else []
    with suppress(OSError, ValueError):
        found.append(float(Path("/sys/fs/cgroup/memory.max").read_text()))
    return float(min(found))


def symmetric_semidefinite(what: str, value: Any) -> None:
    """Refuse what is no covariance (..., n, n).

    Raises:
        InputError: with the asymmetry, the covariance beyond its variances or the negative eigenvalue that was found.
    """
    finite(what, value)
    if is_traced(value):
        return
    P = np.asarray(value, float)
    d = np.sqrt(np.abs(np.einsum("...ii->...i", P)))
    scale = np.maximum(d[..., :, None] * d[..., None, :], np.finfo(float).tiny)
    gap = np.abs(P - np.swapaxes(P, -1, -2)) / scale
    if gap.max(initial=0) > 1e-6:
        *_, i, j = np.unravel_index(gap.argmax(), gap.shape)
        raise InputError(
            f"{what} must be symmetric; entries [{i}, {j}] and [{j}, {i}] differ by {gap.max():.1g} of their scale: "
            "use (P + P.T) / 2 of this P if that is rounding"
        )
    known = (d[..., :, None] == 0) | (d[..., None, :] == 0)
    wrong = known & (P != 0)
    if wrong.any():
        *batch, i, j = (int(place) for place in np.argwhere(wrong)[0])
        zero = i if d[(*batch, i)] == 0 else j
        raise InputError(
            f"{what} must be positive semidefinite; entry [{i}, {j}] is {P[(*batch, i, j)]:.3g} although the variance "
            f"[{zero}, {zero}] is 0, and a component known exactly has no covariance with another: give it a variance, "
            "or set the entry to 0"
        )
    smallest = np.linalg.eigvalsh(np.where(known, 0, P / scale)).min(initial=0.0)
    if smallest < -1e-6:
        raise InputError(
            f"{what} must be positive semidefinite; scaled to unit diagonal it has the eigenvalue {smallest:.3g}: "
            "check the signs of its covariances (variances are squares of standard deviations)"
        )
