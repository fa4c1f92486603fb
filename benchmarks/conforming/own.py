"""Ours: of the catalogue each rule and each form at least once, and those of `sigmax.filterpy`.

`tests/test_conformance.py` takes the whole catalogue, in the slow tests.
"""

from collections.abc import Iterator
from dataclasses import replace

from conforming import ANGLES, MISSING, PARTLY
from conforming.filterpy import of_module
from sigmax.conformance import Adapter, own

# With a row of their own, and in one row together; to which degree the prediction's means are exact.
SHOWN = {"SREKFB": 1, "SRUKFB": 3, "SRCKFB": 3, "SRECKFB": 1, "SRHCKFB": 5}
OTHERS = {"EKF": 1, "UKF": 3, "SRCKF": 3, "SRSKFB": 2, "SRGHKFB": 5, "SRPFB": 2, "HCIF": 5}


def adapters(name: str, version: str) -> Iterator[Adapter]:
    offers = frozenset({ANGLES, MISSING, PARTLY})
    for each, degree in SHOWN.items():
        yield own(each, degree)
    for made in of_module("sigmax.filterpy", "sigmax.filterpy", version):
        yield replace(made, offers=offers)
    for each, degree in OTHERS.items():
        yield own(each, degree)
