"""A filter is three parts; any combination works."""

from dataclasses import dataclass

from sigmax.forms.form import Form
from sigmax.rules.linearization import Rule


@dataclass(frozen=True)
class Filter:
    """A member of the Kalman family.

    Attributes:
        predict: the rule that linearises the motion.
        correct: the rule that linearises the sensor.
        form: how the covariance is carried.
        name: as it stands in tables.
        linear: refuse models that are not linear.
    """

    predict: Rule
    correct: Rule
    form: Form
    name: str = "unnamed"
    linear: bool = False

    def __str__(self) -> str:
        return self.name
