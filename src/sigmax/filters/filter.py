"""A filter is four parts; any combination works."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields, replace
from types import FunctionType

from sigmax.errors import InputError
from sigmax.filters.adaptive_noise import AdaptiveQ
from sigmax.filters.update import BySensor, Update
from sigmax.forms.form import Form
from sigmax.rules.linearization import Rule
from sigmax.rules.marginal import Marginal


@dataclass(frozen=True, repr=False)
class Filter:
    """A member of the Kalman family.

    Attributes:
        predict: the rule that linearises the motion.
        correct: the rule that linearises the sensor.
        form: how the covariance is carried.
        name: as it stands in tables.
        linear: refuse models that are not linear.
        update: how a measurement corrects: once, iterated, or by weights, or that for each sensor; None for once, and
            on curved spaces for one iteration.
        consider: names of components of state or bias that no measurement changes, while what is not known of them
            widens everything else.
        Q: how the noise of the motion is found as the filter goes; None where it is the model's.
    """

    predict: Rule
    correct: Rule
    form: Form
    name: str = "unnamed"
    linear: bool = False
    update: Update | BySensor | None = None
    consider: tuple[str, ...] = ()
    Q: AdaptiveQ | None = None

    def __post_init__(self) -> None:
        for what, rule in (("predict", self.predict), ("correct", self.correct)):
            if isinstance(rule, type) or not callable(rule) or not isinstance(rule, Hashable):
                raise InputError(f"{what} must be a rule such as sigmax.rules.Taylor1(), hashable; it is {_said(rule)}")
        if not isinstance(self.form, Form):
            raise InputError(f"form must be a sigmax.forms.Form such as sigmax.forms.block; it is {_said(self.form)}")
        if self.update is not None and not isinstance(self.update, Update | BySensor):
            raise InputError(
                f"update must be one such as sigmax.once, sigmax.iterated(3) or sigmax.robust('student'); "
                f"it is {_said(self.update)}"
            )
        if self.Q is not None and not isinstance(self.Q, AdaptiveQ):
            raise InputError(f"Q must be one such as sigmax.filters.adaptive_Q(100), or None; it is {_said(self.Q)}")
        names = self.consider
        if not isinstance(names, tuple) or not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
            raise InputError(f"consider must be a tuple of different names of components; it is {names!r}")

    def on(self, biases: int) -> "Filter":
        """The filter as it runs on a model with so many biases: parts that treat them apart are told how many.

        Raises:
            InputError: where a rule and the form want the bias at different places.
        """
        rules = [rule.on(biases) if isinstance(rule, Marginal) else rule for rule in (self.predict, self.correct)]
        form = self.form.on(biases)
        if form.bias_first and any(isinstance(rule, Marginal) for rule in rules):
            raise InputError(f"{self.name}: a marginal rule takes the bias behind the state, {form.name} before it")
        same = rules[0] is self.predict and rules[1] is self.correct and form is self.form
        return self if same else replace(self, predict=rules[0], correct=rules[1], form=form)

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        update = f", update {self.update}" if self.update is not None else ""
        held = f", considering {', '.join(self.consider)}" if self.consider else ""
        found = f", Q {self.Q}" if self.Q is not None else ""
        parts = f"prediction {self.predict}, correction {self.correct}, form {self.form.name}"
        return f"{self.name}: {parts}{update}{found}{held}"


@dataclass(frozen=True, repr=False)
class ModeFilters(Filter):
    """The filters of the modes of a switching model, in their order; its own parts are those of the first.

    Attributes:
        modes: a filter for each mode.
    """

    modes: tuple[Filter, ...] = ()

    @classmethod
    def of(cls, modes: Sequence[Filter]) -> "ModeFilters":
        """The filters as one."""
        first, names = modes[0], list(dict.fromkeys(f.name for f in modes))
        return cls(first.predict, first.correct, first.form, ", ".join(names), modes=tuple(modes))


@dataclass(frozen=True, repr=False)
class FromInformation(Filter):
    """A filter as it runs from an information pair that leaves directions open."""

    @classmethod
    def of(cls, filter: Filter) -> "FromInformation":
        """The filter so."""
        return cls(**{part.name: getattr(filter, part.name) for part in fields(Filter)})


def _said(given: object) -> str:
    if isinstance(given, type):
        return f"the class {given.__name__}, not one made of it: write {given.__name__}()"
    if isinstance(given, FunctionType):
        return f"the function {given.__name__}: write {given.__name__}(…)"
    return type(given).__name__
