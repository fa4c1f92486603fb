"""Functions that people write with NumPy, traced by JAX: no filter and no model is known here."""

from sigmax.tracing.traceable import Traceable, check_alike, traceable

__all__ = ["Traceable", "check_alike", "traceable"]
