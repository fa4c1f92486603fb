"""How long the half-steps of a filter take."""

import time

import numpy as np

from sigmax.running import lanes, scanned
from sigmax.running.backend import attempt
from sigmax.running.edge import Prepared


def seconds(ready: Prepared, backend: str | None = None) -> tuple[float, float]:
    """How long the predictions alone and the whole of a record took; call it once before to compile."""
    alone = ready._replace(z={})
    return _seconds(alone, backend), _seconds(ready, backend)


def _seconds(ready: Prepared, backend: str | None) -> float:
    def native() -> None:
        lanes.filtered(frozenset(), ready)

    def xla() -> None:
        # What nobody asks for is not computed there.
        _, parts = scanned.filtered(frozenset({"mean", "factor"}), ready, False)
        np.asarray(parts["mean"])

    begun = time.perf_counter()
    attempt(backend, False, native, xla)
    return time.perf_counter() - begun
