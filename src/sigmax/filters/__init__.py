"""Filters: a rule for the prediction, a rule for the correction, a form; and their catalogue."""

from sigmax.filters.catalogue import Entry, catalogue, get, names
from sigmax.filters.filter import Filter

__all__ = ["Entry", "Filter", "catalogue", "get", "names"]
