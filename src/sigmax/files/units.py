"""Units at the edges: inside everything is in metres, seconds and radians."""

import math
import re
from typing import Any, NamedTuple

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import is_traced
from sigmax.preparation.intervals import SECONDS


class Dimension(NamedTuple):
    """Powers of length, time and angle. An angle counts as a dimension, so that metres never pass for radians."""

    length: int = 0
    time: int = 0
    angle: int = 0

    @property
    def symbol(self) -> str:
        """The SI unit, such as m/s; empty for a plain number."""
        powers = list(zip(("m", "s", "rad"), self, strict=True))
        above = [unit + _raised(p) for unit, p in powers if p > 0]
        below = [unit + _raised(-p) for unit, p in powers if p < 0]
        if not above and not below:
            return ""
        return "/".join(["·".join(above) or "1", *below])

    @property
    def what(self) -> str:
        """In words, with units that fit."""
        return _WORDS.get(self) or f"a quantity in {self.symbol}"


def _raised(power: int) -> str:
    return "" if power == 1 else "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(d)] for d in str(power))


NUMBER = Dimension()
LENGTH = Dimension(1)
TIME = Dimension(0, 1)
ANGLE = Dimension(0, 0, 1)
SPEED = Dimension(1, -1)
ACCELERATION = Dimension(1, -2)
TURN_RATE = Dimension(0, -1, 1)

_WORDS = {
    NUMBER: "a plain number",
    LENGTH: "a length (m, km, ft, nmi)",
    TIME: "a time (s, ms, min, h)",
    ANGLE: "an angle (rad, deg)",
    SPEED: "a speed (m/s, km/h, kn)",
    ACCELERATION: "an acceleration (m/s^2)",
    TURN_RATE: "an angular rate (rad/s, deg/s)",
}

_DEGREE = math.pi / 180
_NAUTICAL_MILE = 1852.0
_UNITS: dict[str, tuple[float, Dimension]] = {
    "1": (1.0, NUMBER),
    "%": (0.01, NUMBER),
    "m": (1.0, LENGTH),
    "mm": (1e-3, LENGTH),
    "cm": (1e-2, LENGTH),
    "km": (1e3, LENGTH),
    "ft": (0.3048, LENGTH),
    "yd": (0.9144, LENGTH),
    "mi": (1609.344, LENGTH),
    "nmi": (_NAUTICAL_MILE, LENGTH),
    "NM": (_NAUTICAL_MILE, LENGTH),
    **{unit: (seconds, TIME) for unit, seconds in SECONDS.items()},
    "rad": (1.0, ANGLE),
    "mrad": (1e-3, ANGLE),
    "deg": (_DEGREE, ANGLE),
    "°": (_DEGREE, ANGLE),
    "arcmin": (_DEGREE / 60, ANGLE),
    "arcsec": (_DEGREE / 3600, ANGLE),
    "kn": (_NAUTICAL_MILE / 3600, SPEED),
    "kt": (_NAUTICAL_MILE / 3600, SPEED),
    "mph": (1609.344 / 3600, SPEED),
    "g": (9.80665, ACCELERATION),
}
# Squares of what is larger or smaller, and their inverses, are no numbers any more.
_LEAST, _MOST = 1e-150, 1e150
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
_FACTOR = re.compile(r"([^\d\s^]+|1)\s*\^?\s*(\d+)?")
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def parse_unit(text: str, where: str) -> tuple[float, Dimension]:
    """The factor to SI and the dimension of a unit such as "km/h" or "m^2/s^3".

    Raises:
        InputError: for a unit that is not known, with the nearest ones that are.
    """
    factor, powers = 1.0, [0, 0, 0]
    for place, part in enumerate(text.translate(_SUPERSCRIPTS).split("/")):
        sign = -1 if place else 1
        for piece in re.split(r"[*·]", part):
            match = _FACTOR.fullmatch(piece.strip())
            if match is None or match[1] not in _UNITS:
                raise InputError(f"{where}: {unknown('unit', piece.strip() or text, _UNITS)}")
            scale, dimension = _UNITS[match[1]]
            power = sign * int(match[2] or 1)
            factor *= scale**power
            powers = [p + power * d for p, d in zip(powers, dimension, strict=True)]
    return factor, Dimension(*powers)


def is_unit_of(unit: str, dimension: Dimension) -> bool:
    """Whether a unit, if there is one, is of this dimension."""
    return bool(unit) and parse_unit(unit, "unit")[1] == dimension


def to_si(unit: str, dimension: Dimension, where: str) -> float:
    """The factor that brings numbers in `unit` to SI; no unit means SI already.

    Raises:
        InputError: where the unit is of something else.
    """
    if not unit.strip():
        return 1.0
    factor, given = parse_unit(unit, where)
    if given != dimension:
        raise InputError(f"{where}: the unit {unit!r} does not fit; this is {dimension.what}")
    return factor


def unit_of(factor: float, dimension: Dimension) -> str | None:
    """The unit of a dimension whose factor to SI this is; None where there is none."""
    lengths, times = ([u for u, (_, d) in _UNITS.items() if d == one] for one in (LENGTH, TIME))
    speeds = [f"{a}/{b}" for a in lengths for b in times] if dimension == SPEED else []
    rates = [f"{a}/{b}" for a in ("rad", "deg") for b in times] if dimension == TURN_RATE else []
    for unit in [*(u for u, (_, d) in _UNITS.items() if d == dimension), *speeds, *rates]:
        if math.isclose(parse_unit(unit, unit)[0], factor, rel_tol=1e-6):
            return unit
    return None


def parts_of_quantity(given: str) -> tuple[float, str]:
    """Number and unit of a text such as "50 m".

    Raises:
        InputError: where it is something else.
    """
    match = _QUANTITY.fullmatch(given)
    if match is None:
        raise InputError(f"{given!r} is not a number with a unit")
    return float(match[1]), match[2]


class Freed(NamedTuple):
    """A number of a description that is fitted: it stands in the place of "30 m", and may be traced."""

    value: Any
    unit: str


def quantity(given: Any, dimension: Dimension, where: str) -> Any:
    """A number in SI from 50, "50", "50 m" or "0.05 km"; a traced one from one that is fitted.

    Raises:
        InputError: where it is no number, is not finite, or has a unit of something else.
    """
    if isinstance(given, Freed):
        return given.value * to_si(given.unit, dimension, where)
    unit = ""
    if isinstance(given, str):
        match = _QUANTITY.fullmatch(given)
        if match is None:
            raise InputError(
                f"{where}: {given!r} is not a number with a unit; write {dimension.what} such as {_example(dimension)}"
            )
        value, unit = float(match[1]), match[2]
    elif isinstance(given, int | float) and not isinstance(given, bool):
        value = float(given)
    else:
        raise InputError(f"{where}: {given!r} is not a number; write {dimension.what} such as {_example(dimension)}")
    if not math.isfinite(value):
        raise InputError(f"{where}: {given!r} is not finite; write {dimension.what} such as {_example(dimension)}")
    value *= to_si(unit, dimension, where)
    if value and not _LEAST < abs(value) < _MOST:
        raise InputError(f"{where}: {given!r} is beyond all measure; its square must still be a number")
    return value


def is_below(value: Any, bound: float, or_at: bool = False) -> bool:
    """Whether a quantity lies below a bound, or at it; one that is fitted does not: the fit keeps it in its bounds."""
    return not is_traced(value) and bool(value <= bound if or_at else value < bound)


def _example(dimension: Dimension) -> str:
    plain = re.sub("[⁰¹²³⁴⁵⁶⁷⁸⁹]", lambda m: f"^{m[0].translate(_SUPERSCRIPTS)}", dimension.symbol).replace("·", "*")
    return f'"0.5 {plain}"' if plain else "0.5"
