"""Ours, in the form we recommend, and those of `sigmax.filterpy`."""

from collections.abc import Iterator
from dataclasses import replace

from conforming import ANGLES, MISSING, PARTLY
from conforming.filterpy import of_module
from sigmax.conformance import Adapter, own


def adapters(name: str, version: str) -> Iterator[Adapter]:
    for filter, degree in (("SREKFB", 1), ("SRUKFB", 3), ("SRCKFB", 3), ("SRECKFB", 1), ("SRHCKFB", 5)):
        yield own(filter, degree)
    offers = frozenset({ANGLES, MISSING, PARTLY})
    for made in of_module("sigmax.filterpy", "sigmax.filterpy", version):
        yield replace(made, offers=offers)
