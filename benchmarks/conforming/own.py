"""Ours: every filter of the catalogue for a model without biases, and those of `sigmax.filterpy`."""

from collections.abc import Iterator
from dataclasses import replace

from conforming import ANGLES, MISSING, PARTLY
from conforming.filterpy import of_module
from sigmax.conformance import Adapter, own
from sigmax.filters import names

# To which degree the prediction's means are exact, by what is left of a name without its form.
_DEGREES = {
    "EKF": 1, "EUKF": 1, "ECKF": 1, "EHCKF": 1, "EIF": 1,
    "SKF": 2, "PF": 2, "SOKF": 2, "PIF": 2, "SOIF": 2,
    "UKF": 3, "CKF": 3, "UIF": 3, "CIF": 3,
    "HCKF": 5, "GHKF": 5, "HCIF": 5,
}  # fmt: skip
SHOWN = ("SREKFB", "SRUKFB", "SRCKFB", "SRECKFB", "SRHCKFB")


def adapters(name: str, version: str) -> Iterator[Adapter]:
    """Those of which the table has a row of their own come first."""
    offers = frozenset({ANGLES, MISSING, PARTLY})
    rest = [each for each in names() if each not in SHOWN and _stem(each) in _DEGREES]
    for each in SHOWN:
        yield own(each, _DEGREES[_stem(each)])
    for made in of_module("sigmax.filterpy", "sigmax.filterpy", version):
        yield replace(made, offers=offers)
    for each in rest:
        yield own(each, _DEGREES[_stem(each)])


def _stem(name: str) -> str:
    return name.removeprefix("SR").removesuffix("B")
