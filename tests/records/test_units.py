"""Units at the edges."""

import math

import pytest

from sigmax.errors import InputError
from sigmax.files.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    TURN_RATE,
    Dimension,
    parse_unit,
    quantity,
)


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("50 m", LENGTH, 50),
        ("0.05 km", LENGTH, 50),
        ("10ft", LENGTH, 3.048),
        ("2 nmi", LENGTH, 3704),
        ("180 deg", ANGLE, math.pi),
        ("90 °/s", TURN_RATE, math.pi / 2),
        ("36 km/h", SPEED, 10),
        ("1 kn", SPEED, 1852 / 3600),
        ("1.5e3 ms", TIME, 1.5),
        ("2 g", ACCELERATION, 19.6133),
        ("3 km^2/h^3", Dimension(2, -3), 3e6 / 3600**3),
        ("5 m²/s³", Dimension(2, -3), 5),
        ("7 %", NUMBER, 0.07),
        (4, LENGTH, 4),
        ("-.5", LENGTH, -0.5),
    ],
)
def test_quantities_come_in_si(text: object, dimension: Dimension, value: float) -> None:
    assert quantity(text, dimension, "here") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension", "words"),
    [
        ("5 m", ANGLE, "the unit 'm' does not fit; this is an angle"),
        ("5 deg/s", ANGLE, "does not fit"),
        ("5 kmm", LENGTH, "unknown unit 'kmm'; did you mean .*km"),
        ("fast", SPEED, "not a number with a unit"),
        (True, SPEED, "not a number"),
        ([1.0], SPEED, "not a number"),
        (float("nan"), LENGTH, "not finite"),
    ],
)
def test_quantities_that_do_not_fit_are_refused(text: object, dimension: Dimension, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")) as refused:
        quantity(text, dimension, "prior.x.std")
    assert str(refused.value).startswith("prior.x.std: ")


def test_symbols_of_units_are_read_back() -> None:
    for dimension in (LENGTH, TIME, ANGLE, SPEED, ACCELERATION, TURN_RATE, Dimension(2, -3), Dimension(0, -2)):
        assert parse_unit(dimension.symbol, "here") == (1.0, dimension)
