"""Filters: a rule for the prediction, a rule for the correction, a form, an update; and their catalogue."""

from sigmax.filters.adaptive_noise import AdaptiveQ, adaptive_Q
from sigmax.filters.bank import Bank, of_one_belief
from sigmax.filters.catalogue import Entry, bank, catalogue, get, names
from sigmax.filters.filter import Filter, FromInformation, ModeFilters
from sigmax.filters.update import BySensor, Update, adaptive, by_sensor, iterated, named, once, robust
from sigmax.filters.weights import WEIGHTS, Gate, Huber, Student, Weighed, Weight

__all__ = [
    "WEIGHTS",
    "AdaptiveQ",
    "Bank",
    "BySensor",
    "Entry",
    "Filter",
    "FromInformation",
    "Gate",
    "Huber",
    "ModeFilters",
    "Student",
    "Update",
    "Weighed",
    "Weight",
    "adaptive",
    "adaptive_Q",
    "bank",
    "by_sensor",
    "catalogue",
    "get",
    "iterated",
    "named",
    "names",
    "of_one_belief",
    "once",
    "robust",
]
