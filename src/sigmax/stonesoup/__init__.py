"""Filters of sigmax as components of Stone Soup, and models of Stone Soup in sigmax."""

from sigmax.stonesoup.components import SigmaxPredictor, SigmaxUpdater
from sigmax.stonesoup.translate import Moved, Seen, model_of, motion_of, sensor_of

__all__ = ["Moved", "Seen", "SigmaxPredictor", "SigmaxUpdater", "model_of", "motion_of", "sensor_of"]
