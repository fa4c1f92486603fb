"""A filter is three parts; any combination works."""

from dataclasses import dataclass, replace

from sigmax.errors import InputError
from sigmax.forms.form import Form
from sigmax.rules.linearization import Rule
from sigmax.rules.marginal import Marginal


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

    def on(self, biases: int) -> "Filter":
        """The filter as it runs on a model with so many biases: parts that treat them apart are told how many.

        Raises:
            InputError: where a rule and the form want the bias at different places.
        """
        rules = [rule.on(biases) if isinstance(rule, Marginal) else rule for rule in (self.predict, self.correct)]
        form = self.form.on(biases)
        if form.bias_first and any(isinstance(rule, Marginal) for rule in rules):
            raise InputError(f"{self.name}: a marginal rule takes the bias behind the state, {form.name} before it")
        return replace(self, predict=rules[0], correct=rules[1], form=form)

    def __str__(self) -> str:
        return self.name
