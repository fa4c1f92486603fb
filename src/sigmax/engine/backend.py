"""Which engine computes: steps compiled by a C compiler, or XLA."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.modelling.opaque import failures_raised
from sigmax.native import Defect, Refused, Unavailable, compiler
from sigmax.native.refusal import defects_raised, say_once, user_line

BACKENDS = ("native", "xla")


def attempt(backend: str | None, traced: bool, native: Callable[[], Any], xla: Callable[[], Any]) -> Any:
    """What one of two engines computes.

    Args:
        backend: "native", "xla", or None: what the environment variable SIGMAX_BACKEND says, else
            native with a compiler, else XLA. Beside a GPU too: one is slower for all but the largest batches.
        traced: whether the numbers are being traced, which only XLA can do.
        native: the computation on the native engine.
        xla: the same on XLA; it takes over, with one line of warning, where the native engine cannot.

    Raises:
        InputError: for an unknown backend, or where `backend` is "native" and cannot be had.
    """
    asked = backend if backend is not None else os.environ.get("SIGMAX_BACKEND") or None
    if asked is not None and (not isinstance(asked, str) or asked not in BACKENDS):
        raise unknown("backend", asked, BACKENDS)
    if traced and backend == "native":
        raise InputError(
            "the native engine computes numbers only; inside a trace (jax.grad, jax.jit) leave backend= out"
        )
    if traced:
        return xla()
    if asked is None and compiler() is None:
        say_once(
            "sigmax uses XLA, which is slower: no C compiler was found (cc, gcc, clang), and live steps take some "
            "sixty times as long; install one"
        )
    if asked == "native" or (asked is None and compiler() is not None):
        try:
            with natively():
                return native()
        except (Refused, Unavailable) as error:
            native_failed(asked, error)
    with failures_raised():
        return xla()


@contextmanager
def natively() -> Iterator[None]:
    """What nobody foresaw is a refusal of the native engine, so that another takes over.

    Raises:
        Defect: for it, unless defects are to be raised as they are. What comes out of the model's own functions is no
            defect.
    """
    try:
        yield
    except (Refused, Unavailable, InputError):
        raise
    except Exception as error:
        if defects_raised() or user_line(error):
            raise
        raise Defect.of("the native engine", error) from error


def native_failed(backend: str | None, error: Exception) -> None:
    """Say once that XLA takes over.

    Raises:
        InputError: where the native engine was asked for.
    """
    if (backend or os.environ.get("SIGMAX_BACKEND")) == "native":
        raise InputError(f"the native engine cannot run this: {error}") from error
    say_once(f"sigmax uses XLA, which is slower: {error}")
