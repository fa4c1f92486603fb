"""The named filters, a line each."""

import inspect
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

from sigmax.errors import InputError, unknown
from sigmax.filters import makers as make
from sigmax.filters.adaptive_noise import AdaptiveQ, named_Q
from sigmax.filters.bank import bank_of
from sigmax.filters.filter import Filter
from sigmax.filters.parameters import fitted
from sigmax.filters.update import BySensor, Update, iterated, named
from sigmax.forms import Form, block, covariance, root_information, square_root, two_stage
from sigmax.rules import Rule

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


_T, _T1, _T2, _T2H, _SO = make.taylor, make.taylor1, make.taylor2_motion, make.taylor2_sensor, make.second_order_motion
_U, _C3, _C5, _SX, _GH = make.unscented, make.cubature3, make.cubature5, make.simplex, make.gauss_hermite
_M3, _M5 = make.marginal3, make.marginal5
_P, _S, _B, _R, _TP = map(make.always, (covariance, square_root, block, root_information, two_stage(covariance)))
_Y, _TY = make.information, make.two_stage_information

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
    name: str,
    *,
    update: Update | BySensor | str | Mapping[str, Update | str] | None = None,
    members: int | None = None,
    consider: str | Sequence[str] = (),
    Q: AdaptiveQ | str | None = None,
    **parameters: Any,
) -> Filter:
    """The filter of a name, such as `get("SRUKFB", alpha=0.45, beta=2, kappa=-2)` or `get("EKF", update="student")`.

    An update is one such as `iterated(5)`, or its name, or a dict of them by sensor; without one it is that of the
    catalogue. With members it is a bank of such filters, see `bank`. Components of state or bias that it is to
    `consider` are those that no measurement changes, while what is not known of them counts (Schmidt 1966).
    With Q="adaptive", or `adaptive_Q(…)`, the noise of the motion is found as the filter goes; R is with the update
    "adaptive".

    Raises:
        InputError: for a name or a parameter that is not known, with the nearest ones that are.
    """
    for parameter, value in parameters.items():
        if not isinstance(value, Hashable):
            raise InputError(f"{parameter} must be one value; it is {type(value).__name__}")
    held = (consider,) if isinstance(consider, str) else tuple(map(str, consider))
    about = None if update is None else named(update), held, named_Q(Q)
    member = _composed(str(name), *about, tuple(parameters.items()))
    return member if members is None else bank_of(member, members)


def bank(filter: Filter | str, members: int = 9, bend: float = 0.5) -> Filter:
    """A bank of filters as one filter, where the posterior of one is no Gaussian: ranges to a beacon, bearings.

    Before a measurement the members whose sensor bends most within them, by weight, are split in three along the
    direction in which it bends (nodes of Gauss and Hermite, mean and covariance kept); afterwards the lightest are
    merged again with those with which they lose least (Runnalls 2007). A Gaussian sum filter (Alspach and Sorenson
    1972). Two fifths of the members predict and all correct; splits and merges cost as much again, and more where the
    member is a small one.

    Args:
        filter: that of the members, a name or a filter.
        members: while a measurement is taken, an odd number from 5 to 31; two fifths of them stay between
            measurements, at least three.
        bend: what the sensor may depart from its line at one deviation of a member, in deviations of the noise,
            before the member is split; above 0.

    Raises:
        InputError: for a filter that cannot be a member, or numbers out of their range.
    """
    return bank_of(get(filter) if isinstance(filter, str) else filter, members, bend)


@lru_cache(maxsize=256)
def _composed(
    name: str,
    update: Update | BySensor | None,
    consider: tuple[str, ...],
    Q: AdaptiveQ | None,
    given: tuple[tuple[str, Any], ...],
) -> Filter:
    parameters = dict(given)
    folded = {known.casefold(): known for known in _ENTRIES}
    if str(name).casefold() not in folded:
        head, colon, options = str(name).partition(":")
        if colon and head.casefold() in folded:
            raise InputError(
                f"{name!r} is for the command line; here write get({head!r}, {options.replace(',', ', ')})"
            )
        raise unknown("filter", name, _ENTRIES)
    found = folded[str(name).casefold()]
    entry = _ENTRIES[found]
    for parameter in parameters:
        if parameter not in entry.parameters:
            takes = ", ".join([*entry.parameters, "update", "members", "consider", "Q"])
            raise InputError(f"{found} has no parameter {parameter!r}; it takes {takes}")
    makers = (entry.predict, entry.correct, entry.form)
    kinds = {k: p.annotation for make in makers for k, p in inspect.signature(make).parameters.items()}
    parameters = {k: fitted(found, k, kinds[k], v) for k, v in parameters.items()}

    def part(maker: Callable[..., Any]) -> Any:
        wanted = inspect.signature(maker).parameters
        return maker(**{k: v for k, v in parameters.items() if k in wanted})

    chosen = entry.update if update is None else update
    shown = parameters if chosen == entry.update else parameters | {"update": chosen}
    shown |= {"consider": "+".join(consider)} if consider else {}
    shown |= {} if Q is None else {"Q": Q}
    said = ", ".join(f"{k}={v}" for k, v in shown.items())
    label = f"{found}({said})" if said else found
    parts = part(entry.predict), part(entry.correct), part(entry.form)
    return Filter(*parts, label, linear=found == "KF", update=chosen, consider=consider, Q=Q)
