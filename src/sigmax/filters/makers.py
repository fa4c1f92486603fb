"""Rules and forms of the catalogue from the parameters that its filters take."""

from collections.abc import Callable
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.forms import Form, without_omega
from sigmax.forms import information as exact_information
from sigmax.forms import two_stage as in_two_stages
from sigmax.rules import Marginal, Rule, SigmaPoints, Taylor, Taylor1, Taylor2, sets


def taylor1() -> Rule:
    """Derivatives of first order."""
    return Taylor1()


def taylor2_motion(d_motion: bool = True, D_motion: bool = True) -> Rule:
    """Second order for a motion, mean and covariance each a switch."""
    return Taylor2(mean=bool(d_motion), covariance=bool(D_motion))


def taylor2_sensor(d_sensor: bool = True, D_sensor: bool = True) -> Rule:
    """Second order for a sensor, mean and covariance each a switch."""
    return Taylor2(mean=bool(d_sensor), covariance=bool(D_sensor))


def second_order_motion(d_motion: bool = True) -> Rule:
    """Second order for a motion, in the mean alone."""
    return Taylor2(mean=bool(d_motion), covariance=False)


def taylor(order: int = 3) -> Rule:
    """Derivatives of any order."""
    return Taylor(int(order))


def unscented(
    alpha: float | None = None,
    beta: float | None = None,
    kappa: float | None = None,
    w0: float | None = None,
    permute: bool = False,
) -> Rule:
    """The unscented transform, scaled by alpha, beta and kappa, or general by the weight of its centre."""
    given: dict[str, Any] = {
        k: float(v) for k, v in (("alpha", alpha), ("beta", beta), ("kappa", kappa)) if v is not None
    }
    if w0 is None:
        return SigmaPoints(sets.scaled, permute=bool(permute), **given)
    if given:
        raise InputError(f"w0 belongs to the general transform, {', '.join(given)} to the scaled one: give one kind")
    return SigmaPoints(sets.unscented, permute=bool(permute), w0=float(w0))


def cubature3(permute: bool = False) -> Rule:
    """Cubature of degree 3."""
    return SigmaPoints(sets.cubature, permute=bool(permute), degree=3)


def cubature5(permute: bool = False) -> Rule:
    """Cubature of degree 5."""
    return SigmaPoints(sets.cubature, permute=bool(permute), degree=5)


def simplex(moireau: bool = False, permute: bool = False) -> Rule:
    """The simplex of n + 1 points."""
    given: dict[str, Any] = {"moireau": True} if moireau else {}
    return SigmaPoints(sets.simplex, permute=bool(permute), **given)


def gauss_hermite(order: int = 3, permute: bool = False) -> Rule:
    """The product of Gauss and Hermite, of so many points an axis."""
    return SigmaPoints(sets.gauss_hermite, permute=bool(permute), order=int(order))


def always(form: Form) -> Callable[..., Form]:
    """A form without parameters."""
    return lambda: form


def information(information: str = "exact") -> Form:
    """The information form, exact or as the paper prints it."""
    return _exact_or_printed(information)


def two_stage_information(information: str = "exact") -> Form:
    """The same in two stages."""
    return in_two_stages(_exact_or_printed(information))


def marginal3(points: str = "state", permute: bool = False) -> Rule:
    """Cubature of degree 3 on the state, the bias integrated exactly."""
    return Marginal(cubature3(permute), exact=_projected(points))


def marginal5(points: str = "state", permute: bool = False) -> Rule:
    """Cubature of degree 5 on the state, the bias integrated exactly."""
    return Marginal(cubature5(permute), exact=_projected(points))


def _exact_or_printed(kind: str) -> Form:
    if kind not in _INFORMATION:
        raise unknown("kind of information form", kind, _INFORMATION)
    return _INFORMATION[kind]


def _projected(points: str) -> bool:
    if points not in _POINTS:
        raise unknown("kind of points", points, _POINTS)
    return points == "projected"


_POINTS = ("state", "projected")
_INFORMATION = {"exact": exact_information, "paper": without_omega(exact_information)}
