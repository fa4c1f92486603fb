"""Times of measurements, as people give them: seconds, instants, columns of tables."""

from datetime import UTC, datetime
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, is_traced, numbers

NANO = 1_000_000_000


class Times(NamedTuple):
    """Times of measurements, or that of a prior.

    Attributes:
        value: seconds, or nanoseconds since 1970 in UTC as int64: (), (T,) or (B, T).
        dated: whether they are instants rather than seconds.
        start: the time of the prior, () or (B,); None where it stands at the first measurement.
    """

    value: Any
    dated: bool
    start: Any = None

    def intervals(self, T: int, update_first: bool) -> Any:
        """Seconds since the time before, (T,) or (B, T); the first since the prior.

        Raises:
            InputError: for another number of times, or where nobody says when the prior stands.
        """
        if self.value.ndim not in (1, 2) or self.value.shape[-1] != T:
            raise InputError(f"t must be one time for each of the {T} steps; its shape is {self.value.shape}")
        if not update_first and self.start is None:
            raise InputError(
                "t tells the times of the measurements; say when the prior stands: t0=…, or update_first=True where it "
                "stands at the first measurement"
            )
        if update_first and self.start is not None:
            raise InputError("with update_first=True the prior stands at the first of t: leave t0 out")
        array: Any = jnp if is_traced((self.value, self.start)) else np
        first = self.value[..., 0] if self.start is None else self.start
        lead = np.broadcast_shapes(np.shape(first), self.value.shape[:-1])
        value = array.broadcast_to(self.value, (*lead, T))
        steps = array.diff(value, prepend=array.broadcast_to(first, lead)[..., None])
        return steps / NANO if self.dated else steps


def times_of(t: Any, t0: Any) -> Times | None:
    """Times of measurements t (T,) or (B, T), and t0 of the prior; None where neither is given.

    Raises:
        InputError: for what is no time, and where one is an instant and the other seconds.
    """
    start = None if t0 is None else read_times("t0", t0)
    if t is None:
        return start
    times = read_times("t", t)
    if start is None:
        return times
    if start.dated != times.dated:
        kinds = [("seconds", "an instant")[one.dated] for one in (times, start)]
        raise InputError(f"t and t0 must be of one kind; t is {kinds[0]} and t0 {kinds[1]}")
    return times._replace(start=start.value)


def later(start: Times, dt: Any) -> Any:
    """Times (..., T), laid out as `Times.value`, so many seconds dt (..., T) after each other and a start."""
    array: Any = jnp if is_traced((start.value, dt)) else np
    since = array.cumsum(array.asarray(dt, float), -1)
    if start.value.ndim > 1 or (start.value.ndim == 1 and start.value.shape != since.shape[:-1]):
        raise InputError(f"t0 must be one time, or one for each track; its shape is {start.value.shape}")
    if start.dated:
        since = array.round(since * NANO).astype(array.int64)
    return start.value[..., None] + since


def shown(value: Any, dated: bool) -> Any:
    """Times as people read them: seconds, or datetime64[ns] in UTC."""
    return np.asarray(value).view("datetime64[ns]")[()] if dated else value


def read_times(what: str, given: Any) -> Times:
    """Times, or one of them, without a start.

    Raises:
        InputError: for what is no time, or not finite.
    """
    if is_traced(given):
        return Times(numbers(what, given), False)
    if isinstance(given, str):
        raise _no_times(what, given)
    value = _array(given)
    if value.dtype.kind == "O":
        value = np.array([_instant(what, one) for one in value.ravel().tolist()]).reshape(value.shape)
    if value.dtype.kind == "M":
        return Times(_nanoseconds(what, value), True)
    if value.dtype.kind == "m":
        value = value / np.timedelta64(1, "s")
    if value.dtype.kind not in "fiu":
        raise _no_times(what, given)
    seconds = np.asarray(numbers(what, value), float)
    finite(what, seconds)
    return Times(seconds, False)


def _array(given: Any) -> np.ndarray:
    """What was given as an array: scalars, lists, series and columns of any library."""
    if isinstance(given, datetime) or (isinstance(given, list | tuple) and any(_is_date(one) for one in given)):
        array = np.empty(np.shape(given) if isinstance(given, list | tuple) else (), object)
        array[...] = given
        return array
    return np.asarray(given)


def _is_date(one: Any) -> bool:
    return isinstance(one, datetime) or (isinstance(one, list | tuple) and any(map(_is_date, one)))


def _instant(what: str, one: Any) -> Any:
    """An instant in UTC from a datetime of Python or of pandas: without a time zone it is taken to be in UTC."""
    if isinstance(one, np.datetime64 | np.timedelta64 | int | float) and not isinstance(one, bool):
        return one
    if hasattr(one, "to_datetime64"):
        return one.to_datetime64()
    if hasattr(one, "to_timedelta64"):
        return one.to_timedelta64()
    if isinstance(one, datetime):
        return np.datetime64(one if one.tzinfo is None else one.astimezone(UTC).replace(tzinfo=None), "us")
    if hasattr(one, "total_seconds"):
        return np.timedelta64(one)
    raise _no_times(what, one)


def _nanoseconds(what: str, value: np.ndarray) -> np.ndarray:
    if np.isnat(value).any():
        place = np.argwhere(np.isnat(value))[0].tolist()
        raise InputError(f"{what} must be complete; at {place} it is missing: leave such rows out")
    fine = value.astype("datetime64[ns]")
    if (fine.astype(value.dtype) != value).any():
        raise InputError(f"{what} must lie between the years 1678 and 2262; it begins at {value.ravel()[0]}")
    return fine.astype(np.int64)


def _no_times(what: str, given: Any) -> InputError:
    kind = f"the text {given!r}" if isinstance(given, str) else type(given).__name__
    return InputError(
        f"{what} must be seconds or instants (datetime, datetime64, a column of them); it is {kind}: of text make them "
        "by numpy.array(…, 'datetime64[ns]') or pandas.to_datetime"
    )


def zero_of(time: Any) -> int | None:
    """The instant, in nanoseconds since 1970, from which a live filter counts; None where its time is in seconds."""
    given = None if type(time) is float else read_times("time", time)
    if given is None or not given.dated:
        return None
    if given.value.ndim:
        raise InputError(f"time must be one instant; its shape is {given.value.shape}")
    return int(given.value)


def seconds_since(zero: int, time: Any) -> float:
    """Seconds from an instant to another.

    Raises:
        InputError: for what is no instant.
    """
    given = read_times("time", time)
    if not given.dated or given.value.ndim:
        raise InputError(f"time must be one instant, as that of the prior, {shown(zero, True)}; it is {time!r}")
    return (int(given.value) - zero) / NANO


def since(zero: int | None, seconds: Any) -> Any:
    """The time so many seconds later than a zero: datetime64, or the seconds where there is none."""
    return seconds if zero is None else shown(np.int64(zero + round(float(seconds) * NANO)), True)[()]
