"""Filters of sigmax as components of Stone Soup, and models of Stone Soup in sigmax."""

from sigmax.stonesoup import sensors as _sensors  # noqa: F401 — it registers translations
from sigmax.stonesoup.components import SigmaxPredictor, SigmaxUpdater
from sigmax.stonesoup.translate import Moved, Seen, model_of, motion_of, sensor_of

__all__ = ["Moved", "Seen", "SigmaxPredictor", "SigmaxUpdater", "model_of", "motion_of", "sensor_of"]
