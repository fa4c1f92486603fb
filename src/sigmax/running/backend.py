"""Which engine computes: steps compiled by a C compiler, or XLA."""

import logging
import os
from collections.abc import Callable
from typing import Any

import jax

from sigmax.errors import InputError, unknown
from sigmax.models.opaque import failures_raised
from sigmax.native import Refused, Unavailable, compiler

BACKENDS = ("native", "xla")
_told: set[str] = set()


def attempt(backend: str | None, traced: bool, native: Callable[[], Any], xla: Callable[[], Any]) -> Any:
    """What one of two engines computes.

    Args:
        backend: "native", "xla", or None: what the environment variable SIGMAX_BACKEND says, else
            native on a CPU with a compiler, else XLA.
        traced: whether the numbers are being traced, which only XLA can do.
        native: the computation on the native engine.
        xla: the same on XLA; it takes over, with one line of warning, where the native engine cannot.

    Raises:
        InputError: for an unknown backend, or where `backend` is "native" and cannot be had.
    """
    asked = backend or os.environ.get("SIGMAX_BACKEND") or None
    if asked is not None and asked not in BACKENDS:
        raise unknown("backend", asked, BACKENDS)
    if traced and backend == "native":
        raise InputError(
            "the native engine computes numbers only; inside a trace (jax.grad, jax.jit) leave backend= out"
        )
    if traced:
        return xla()
    if asked == "native" or (asked is None and jax.default_backend() == "cpu" and compiler() is not None):
        try:
            return native()
        except (Refused, Unavailable) as error:
            native_failed(asked, error)
    with failures_raised():
        return xla()


def native_failed(backend: str | None, error: Exception) -> None:
    """Say once that XLA takes over.

    Raises:
        InputError: where the native engine was asked for.
    """
    if (backend or os.environ.get("SIGMAX_BACKEND")) == "native":
        raise InputError(f"the native engine cannot run this: {error}") from error
    if str(error) not in _told:
        _told.add(str(error))
        logging.getLogger("sigmax").warning("sigmax uses XLA, which is slower: %s", error)
