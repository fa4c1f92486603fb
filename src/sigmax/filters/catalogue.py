"""The named filters, a line each."""

import inspect
from collections.abc import Callable, Hashable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

from sigmax.errors import InputError, unknown
from sigmax.filters.filter import Filter
from sigmax.filters.parameters import fitted
from sigmax.filters.update import BySensor, Update, iterated, named
from sigmax.forms import Form, block, covariance, root_information, square_root, two_stage, without_omega
from sigmax.forms import information as of_information
from sigmax.rules import (
    Marginal,
    Rule,
    SigmaPoints,
    Taylor,
    Taylor1,
    Taylor2,
    cubature,
    gauss_hermite,
    scaled,
    simplex,
    unscented,
)

RuleMaker = Callable[..., Rule]
FormMaker = Callable[..., Form]


class Entry(NamedTuple):
    """One line of the catalogue: two makers of rules, one of a form, what the filter is, and its update."""

    predict: RuleMaker
    correct: RuleMaker
    form: FormMaker
    about: str
    update: Update | None = None

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters of rules and form with their defaults; `update` is one of every filter."""
        makers = (self.predict, self.correct, self.form)
        return {name: p.default for make in makers for name, p in inspect.signature(make).parameters.items()}


def _taylor1() -> Rule:
    return Taylor1()


def _taylor2_motion(d_motion: bool = True, D_motion: bool = True) -> Rule:
    return Taylor2(mean=bool(d_motion), covariance=bool(D_motion))


def _taylor2_sensor(d_sensor: bool = True, D_sensor: bool = True) -> Rule:
    return Taylor2(mean=bool(d_sensor), covariance=bool(D_sensor))


def _second_order_motion(d_motion: bool = True) -> Rule:
    return Taylor2(mean=bool(d_motion), covariance=False)


def _taylor(order: int = 3) -> Rule:
    return Taylor(int(order))


def _unscented(
    alpha: float | None = None,
    beta: float | None = None,
    kappa: float | None = None,
    w0: float | None = None,
    permute: bool = False,
) -> Rule:
    given: dict[str, Any] = {
        k: float(v) for k, v in (("alpha", alpha), ("beta", beta), ("kappa", kappa)) if v is not None
    }
    if w0 is None:
        return SigmaPoints(scaled, permute=bool(permute), **given)
    if given:
        raise InputError(f"w0 belongs to the general transform, {', '.join(given)} to the scaled one: give one kind")
    return SigmaPoints(unscented, permute=bool(permute), w0=float(w0))


def _cubature3(permute: bool = False) -> Rule:
    return SigmaPoints(cubature, permute=bool(permute), degree=3)


def _cubature5(permute: bool = False) -> Rule:
    return SigmaPoints(cubature, permute=bool(permute), degree=5)


def _simplex(moireau: bool = False, permute: bool = False) -> Rule:
    given: dict[str, Any] = {"moireau": True} if moireau else {}
    return SigmaPoints(simplex, permute=bool(permute), **given)


def _gauss_hermite(order: int = 3, permute: bool = False) -> Rule:
    return SigmaPoints(gauss_hermite, permute=bool(permute), order=int(order))


def _always(form: Form) -> FormMaker:
    return lambda: form


def _information(information: str = "exact") -> Form:
    if information not in _INFORMATION:
        raise unknown("kind of information form", information, _INFORMATION)
    return _INFORMATION[information]


def _two_stage_information(information: str = "exact") -> Form:
    return two_stage(_information(information))


def _marginal3(points: str = "state", permute: bool = False) -> Rule:
    return Marginal(_cubature3(permute), exact=_projected(points))


def _marginal5(points: str = "state", permute: bool = False) -> Rule:
    return Marginal(_cubature5(permute), exact=_projected(points))


def _projected(points: str) -> bool:
    if points not in _POINTS:
        raise unknown("kind of points", points, _POINTS)
    return points == "projected"


_POINTS = ("state", "projected")
_INFORMATION = {"exact": of_information, "paper": without_omega(of_information)}
_T, _T1, _T2, _T2H, _SO = _taylor, _taylor1, _taylor2_motion, _taylor2_sensor, _second_order_motion
_U, _C3, _C5, _SX, _GH = _unscented, _cubature3, _cubature5, _simplex, _gauss_hermite
_M3, _M5 = _marginal3, _marginal5
_P, _S, _B, _R, _TP = map(_always, (covariance, square_root, block, root_information, two_stage(covariance)))
_Y, _TY = _information, _two_stage_information

_ENTRIES: dict[str, Entry] = {
    "KF": Entry(_T1, _T1, _P, "linear Kalman filter; refuses a model that is not linear"),
    "EKF": Entry(_T1, _T1, _P, "extended"),
    "UKF": Entry(_U, _U, _P, "unscented, scaled (alpha, beta, kappa) or general (w0)"),
    "CKF": Entry(_C3, _C3, _P, "cubature of degree 3, the basic unscented transform"),
    "SREKF": Entry(_T1, _T1, _S, "extended, square root"),
    "SRUKF": Entry(_U, _U, _S, "unscented, square root"),
    "SRUKFB": Entry(_U, _U, _B, "unscented, square root with block correction"),
    "SRCKF": Entry(_C3, _C3, _S, "cubature, square root"),
    "SRCKFB": Entry(_C3, _C3, _B, "cubature, square root with block correction"),
    "EUKF": Entry(_T1, _U, _P, "hybrid: extended prediction, unscented correction"),
    "ECKF": Entry(_T1, _C3, _P, "hybrid: extended prediction, cubature correction"),
    "SREUKF": Entry(_T1, _U, _S, "hybrid unscented, square root"),
    "SREUKFB": Entry(_T1, _U, _B, "hybrid unscented, square root with block correction"),
    "SRECKF": Entry(_T1, _C3, _S, "hybrid cubature, square root"),
    "SRECKFB": Entry(_T1, _C3, _B, "hybrid cubature, square root with block correction"),
    "SREKFB": Entry(_T1, _T1, _B, "extended, square root with block correction"),
    "HCKF": Entry(_C5, _C5, _P, "cubature of degree 5"),
    "SRHCKF": Entry(_C5, _C5, _S, "cubature of degree 5, square root"),
    "SRHCKFB": Entry(_C5, _C5, _B, "cubature of degree 5, square root with block correction"),
    "SREHCKFB": Entry(_T1, _C5, _B, "hybrid of degree 5, square root with block correction"),
    "SKF": Entry(_SX, _SX, _P, "simplex of n + 1 points"),
    "SRSKF": Entry(_SX, _SX, _S, "simplex, square root"),
    "SRSKFB": Entry(_SX, _SX, _B, "simplex, square root with block correction"),
    "GHKF": Entry(_GH, _GH, _P, "Gauss–Hermite of `order` points an axis"),
    "SRGHKF": Entry(_GH, _GH, _S, "Gauss–Hermite, square root"),
    "SRGHKFB": Entry(_GH, _GH, _B, "Gauss–Hermite, square root with block correction"),
    "PF": Entry(_T2, _T2H, _P, "polynomial: order 2 in motion and sensor, each of the four terms d, D a switch"),
    "SRPF": Entry(_T2, _T2H, _S, "polynomial, square root"),
    "SRPFB": Entry(_T2, _T2H, _B, "polynomial, square root with block correction"),
    "SOKF": Entry(_SO, _T2H, _P, "second order: polynomial without D of the motion"),
    "SRSOKF": Entry(_SO, _T2H, _S, "second order, square root"),
    "SRSOKFB": Entry(_SO, _T2H, _B, "second order, square root with block correction"),
    "TKF": Entry(_T, _T, _P, "Taylor of any `order`, 3 unless said: exact moments of polynomials of that degree"),
    "SRTKF": Entry(_T, _T, _S, "Taylor of any order, square root"),
    "SRTKFB": Entry(_T, _T, _B, "Taylor of any order, square root with block correction"),
    "EIF": Entry(_T1, _T1, _Y, "extended, information"),
    "UIF": Entry(_U, _U, _Y, "unscented, information"),
    "CIF": Entry(_C3, _C3, _Y, "cubature, information"),
    "HCIF": Entry(_C5, _C5, _Y, "cubature of degree 5, information"),
    "PIF": Entry(_T2, _T2H, _Y, "polynomial, information"),
    "SOIF": Entry(_SO, _T2H, _Y, "second order, information"),
    "SREIF": Entry(_T1, _T1, _R, "extended, square-root information"),
    "SRUIF": Entry(_U, _U, _R, "unscented, square-root information"),
    "SRCIF": Entry(_C3, _C3, _R, "cubature, square-root information"),
    "SRHCIF": Entry(_C5, _C5, _R, "cubature of degree 5, square-root information"),
    "TSEKF": Entry(_T1, _T1, _TP, "extended in two stages, bias and state (Hsieh)"),
    "TSCKF": Entry(_C3, _C3, _TP, "cubature in two stages"),
    "TSHCKF": Entry(_C5, _C5, _TP, "cubature of degree 5 in two stages"),
    "TSCIF": Entry(_C3, _C3, _TY, "cubature information in two stages"),
    "TSHCIF": Entry(_C5, _C5, _TY, "cubature information of degree 5 in two stages (Zhang et al., corrected)"),
    "MTSCKF": Entry(_M3, _M3, _P, "cubature on the state alone, the bias integrated exactly"),
    "MTSHCKF": Entry(_M5, _M5, _P, "cubature of degree 5 on the state alone, the bias integrated exactly"),
    "MTSCIF": Entry(_M3, _M3, _Y, "cubature information on the state alone"),
    "MTSHCIF": Entry(_M5, _M5, _Y, "cubature information of degree 5 on the state alone"),
    "IEKF": Entry(_T1, _T1, _P, "iterated extended: the sensor linearised again about the posterior", iterated()),
    "IPLF": Entry(_U, _U, _P, "iterated posterior linearisation: unscented about the posterior", iterated()),
}


def catalogue() -> Mapping[str, Entry]:
    """Every named filter with its parts."""
    return MappingProxyType(_ENTRIES)


def names() -> tuple[str, ...]:
    """The names of the catalogue."""
    return tuple(_ENTRIES)


def get(
    name: str, *, update: Update | BySensor | str | Mapping[str, Update | str] | None = None, **parameters: Any
) -> Filter:
    """The filter of a name, such as `get("SRUKFB", alpha=0.45, beta=2, kappa=-2)` or `get("EKF", update="student")`.

    An update is one such as `iterated(5)`, or its name, or a dict of them by sensor; without one it is that of the
    catalogue.

    Raises:
        InputError: for a name or a parameter that is not known, with the nearest ones that are.
    """
    for parameter, value in parameters.items():
        if not isinstance(value, Hashable):
            raise InputError(f"{parameter} must be one value; it is {type(value).__name__}")
    return _made(str(name), None if update is None else named(update), tuple(parameters.items()))


@lru_cache(maxsize=256)
def _made(name: str, update: Update | BySensor | None, given: tuple[tuple[str, Any], ...]) -> Filter:
    parameters = dict(given)
    folded = {known.casefold(): known for known in _ENTRIES}
    if str(name).casefold() not in folded:
        raise unknown("filter", name, _ENTRIES)
    found = folded[str(name).casefold()]
    entry = _ENTRIES[found]
    for parameter in parameters:
        if parameter not in entry.parameters:
            takes = ", ".join([*entry.parameters, "update"])
            raise InputError(f"{found} has no parameter {parameter!r}; it takes {takes}")
    makers = (entry.predict, entry.correct, entry.form)
    kinds = {k: p.annotation for make in makers for k, p in inspect.signature(make).parameters.items()}
    parameters = {k: fitted(found, k, kinds[k], v) for k, v in parameters.items()}

    def make(maker: Callable[..., Any]) -> Any:
        wanted = inspect.signature(maker).parameters
        return maker(**{k: v for k, v in parameters.items() if k in wanted})

    chosen = entry.update if update is None else update
    shown = parameters if chosen == entry.update else parameters | {"update": chosen}
    said = ", ".join(f"{k}={v}" for k, v in shown.items())
    label = f"{found}({said})" if said else found
    parts = make(entry.predict), make(entry.correct), make(entry.form)
    return Filter(*parts, label, linear=found == "KF", update=chosen)
