"""How long the half-steps of a filter take."""

import time

import numpy as np

from sigmax.engine import native_engine, xla_engine
from sigmax.engine.backend import attempt
from sigmax.preparation.prepare import Prepared


def seconds(ready: Prepared, backend: str | None = None) -> tuple[float, float]:
    """How long the predictions alone and the whole of a record took; call it once before to compile."""
    alone = ready._replace(z={})
    return _seconds(alone, backend), _seconds(ready, backend)


def _seconds(ready: Prepared, backend: str | None) -> float:
    def native() -> None:
        native_engine.filtered(frozenset(), ready)

    def xla() -> None:
        # What nobody asks for is not computed there.
        _, parts = xla_engine.filtered(frozenset({"mean", "factor"}), ready, False)
        np.asarray(parts["mean"])

    begun = time.perf_counter()
    attempt(backend, False, native, xla)
    return time.perf_counter() - begun
