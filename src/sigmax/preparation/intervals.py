"""The time between steps, as people give it."""

import re
from contextlib import suppress
from datetime import timedelta
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, is_traced, numbers
from sigmax.preparation.times import Times

# Units of time, in seconds.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}


def instant(what: str, given: Any) -> float:
    """A time in seconds.

    Raises:
        InputError: for what is not one finite number.
    """
    if type(given) is float and abs(given) < np.inf:
        return given
    value = numbers(what, given)
    if np.ndim(value) or not abs(value) < np.inf:
        raise InputError(f"{what} must be one finite number of seconds, from whatever zero; it is {given!r}")
    return float(value)


def duration(what: str, given: Any) -> float:
    """The seconds of a span of time: a number, a timedelta, or text such as "200 ms".

    Raises:
        InputError: for anything else, and below 0.
    """
    value = given
    if isinstance(given, str):
        written = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(\w+)\s*", given, re.ASCII)
        if not written or written[2] not in SECONDS:
            raise InputError(f'{what} is a span of time such as "2 s" or "200 ms"; it is {given!r}')
        value = float(written[1]) * SECONDS[written[2]]
    value = _in_seconds(value)
    if np.ndim(value) or not 0 <= value < np.inf:
        raise InputError(f"{what} must be one number of seconds, finite and not negative; it is {given}")
    return float(value)


def seconds_of(dt: Any) -> float:
    """The seconds of a step, from a number, a timedelta or text.

    Raises:
        InputError: for anything else, and where time runs backwards.
    """
    if type(dt) is float and 0 <= dt < np.inf:
        return dt
    return duration("dt", dt)


def _in_seconds(dt: Any) -> Any:
    """Seconds as numbers: what is given as a timedelta, of Python, NumPy or pandas, is turned into them."""
    if isinstance(dt, timedelta):
        return dt.total_seconds()
    first = dt
    while isinstance(first, list | tuple) and first:
        first = first[0]
    if isinstance(first, timedelta | np.timedelta64) and first is not dt:
        with suppress(ValueError):  # ragged: refused below
            return np.array(dt, "timedelta64[ns]") / np.timedelta64(1, "s")
    kind = getattr(dt, "dtype", None)
    if isinstance(kind, np.dtype) and kind.kind == "m":
        return np.asarray(dt) / np.timedelta64(1, "s")
    return numbers("dt", dt)


def _not_times(value: Any) -> None:
    """Refuse the times of measurements in the place of the intervals between them."""
    if is_traced(value) or value.shape[-1] < 3:
        return
    later = np.asarray(value)[..., 1:]
    if not (later[..., 0] > 1e5).all():
        return
    steps = np.diff(later)
    # Intervals of more than a day, each of them longer than the last, and by less than a thousandth.
    if (steps > 0).all() and (steps.mean(-1) < 1e-3 * later[..., 0]).all():
        raise InputError(
            f"dt are the intervals between the measurements, in seconds; these look like their times, {later.min()} "
            f"to {later.max()}: give them as t=, and the time of the prior as t0= or by update_first=True"
        )


def intervals(dt: Any, T: int, update_first: bool) -> Any:
    """Seconds of T steps, (T,) or (B, T), from dt or the times of the measurements.

    The first, which may be missing, is 0 where the record begins with an update.

    Raises:
        InputError: for what is not finite, negative or of another length.
    """
    if type(dt) in (float, int) and 0 <= dt < 1e300 and not update_first:
        return np.full(T, float(dt))
    by_time = isinstance(dt, Times)
    if by_time:
        value = dt.intervals(T, update_first)
    else:
        value = np.asarray(_in_seconds(dt)) if not is_traced(dt) else numbers("dt", dt)
    if value.ndim == 0:
        value = jnp.full((T,), value) if is_traced(value) else np.full(T, value)
    array: Any = jnp if is_traced(value) else np
    if update_first and value.shape[-1] in (T - 1, T):
        later = value[..., value.shape[-1] - T + 1 :]
        value = array.concatenate([array.zeros_like(later, shape=(*later.shape[:-1], 1)), later], -1)
    if value.ndim > 2 or value.shape[-1] != T or value.shape[0] == 0:
        hint = "; with update_first=True, where the prior stands at the first measurement, that would do"
        raise InputError(
            f"dt must be a number of seconds, or one for each of the {T} steps; its shape is {value.shape}"
            f"{hint if value.shape[-1] == T - 1 else ''}"
        )
    finite("dt", value)
    if not by_time:
        _not_times(value)
    if not is_traced(value) and (np.asarray(value) < 0).any():
        place = np.argwhere(np.asarray(value) < 0)[0]
        raise InputError(
            f"time runs backwards at step {int(place[-1])}: dt = {np.asarray(value)[tuple(place)]}; "
            "sort the measurements by time"
        )
    return value
