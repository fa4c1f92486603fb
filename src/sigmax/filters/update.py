"""How a measurement corrects, the fourth part of a filter: once, iterated, with weights, or with an R that adapts."""

import inspect
import re
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.filters.adaptive_noise import check_memory
from sigmax.filters.parameters import fitted
from sigmax.filters.weights import WEIGHTS, Weight

_MOST = 100


@dataclass(frozen=True)
class Update:
    """What happens between a linearised sensor and the one correction of the form.

    Attributes:
        iterations: how often the sensor is linearised again, about the posterior of the line before.
        guarded: whether an iterate is kept only where |t|² + |L_r⁻¹ (z − ŷ)|² falls, and the step halved elsewhere.
        weight: the weights of a measurement by its first innovation, None for none.
        memory: how many measurements the estimate of R remembers, None where R is the model's.
        reset: whether the corrected covariance is seen from the corrected mean; only curved spaces tell, where
            multiplicative and invariant filters of the textbooks leave it out.
    """

    iterations: int = 0
    guarded: bool = True
    weight: Weight | None = None
    reset: bool = True
    memory: float | None = None

    def __post_init__(self) -> None:
        count = self.iterations
        if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= _MOST:
            raise InputError(f"iterations of an update must be a whole number from 0 to {_MOST}; it is {count!r}")
        for what in ("guarded", "reset"):
            if not isinstance(getattr(self, what), bool):
                raise InputError(f"{what} must be True or False; it is {getattr(self, what)!r}")
        weight = self.weight
        if weight is not None and (
            isinstance(weight, type) or not callable(weight) or not isinstance(weight, Hashable)
        ):
            raise InputError(f"the weight of an update must be one such as Student(4), hashable; it is {weight!r}")
        if self.memory is not None:
            check_memory(self.memory)

    def __str__(self) -> str:
        guard = "" if self.guarded else ", guarded=False"
        parts = [] if self.memory is None else [f"adaptive({self.memory:g})"]
        parts += [f"iterated({self.iterations}{guard})"] if self.iterations else []
        parts += [] if self.weight is None else [_written(self.weight)]
        return " ".join(parts or ["once"]) + ("" if self.reset else ", without reset")


once = Update()


@dataclass(frozen=True)
class BySensor:
    """An update for each sensor: a gate for one that sees reflections, once for an odometer.

    Attributes:
        updates: by the name of the sensor.
        others: of sensors that are not named; None for once, and on curved spaces for one iteration.
    """

    updates: tuple[tuple[str, Update], ...]
    others: Update | None = None

    def of(self, sensor: str) -> Update | None:
        """The update of a sensor."""
        return dict(self.updates).get(sensor, self.others)

    def __str__(self) -> str:
        others = [] if self.others is None else [f"others: {self.others}"]
        return ", ".join([*(f"{sensor}: {update}" for sensor, update in self.updates), *others])


def iterated(iterations: int = 3, guarded: bool = True) -> Update:
    """The sensor linearised again so many times about the posterior: IEKF for Taylor rules, IPLF for sigma rules.

    It costs as many evaluations of the sensor more as it has iterations. Bell and Cathey (1993) for derivatives,
    García-Fernández et al. (2015) for sigma points; a step that does not lower the cost is halved.

    Raises:
        InputError: for a count that is not a whole number from 1 to 100.
    """
    if iterations == 0:
        raise InputError("iterated needs at least one iteration; sigmax.once corrects without any")
    return Update(iterations, guarded)


def robust(kind: str | Weight = "student", update: Update = once, **parameters: Any) -> Update:
    """An update that takes measurements by their weight, so that outliers do not carry the estimate away.

    Args:
        kind: "student" (dof), "huber" (threshold), "gate" (probability, growth), or a weight of your own.
        update: the update that is weighted: `robust("student", iterated(2))`.
        parameters: of the kind.

    Raises:
        InputError: for a kind or a parameter that is not known.
    """
    if not isinstance(update, Update):
        raise InputError(f"update must be one such as sigmax.once or sigmax.iterated(2); it is {update!r}")
    if not isinstance(kind, str):
        if parameters:
            raise InputError(f"a weight of your own has its parameters in it; {', '.join(parameters)} cannot be given")
        return replace(update, weight=kind)
    if kind not in WEIGHTS:
        raise unknown("kind of robust update", kind, WEIGHTS)
    takes = inspect.signature(WEIGHTS[kind]).parameters
    for name in parameters:
        if name not in takes:
            raise InputError(f"the {kind} update has no parameter {name!r}; it takes {', '.join(takes)}")
    return replace(update, weight=WEIGHTS[kind](**parameters))


def adaptive(memory: float = 50.0, update: Update = once) -> Update:
    """An update that finds R as it goes: each variance of it times a number that the last measurements say.

    Variational Bayes (Särkkä and Nummenmaa 2009): the number has an inverse gamma distribution, forgets a share of
    1 / memory with each measurement, and is estimated together with the state. Off unless asked for.

    Args:
        memory: how many measurements are remembered, at least 2. R is then known to about √(2 / memory) of itself.
        update: the update besides, iterated or robust: `adaptive(50, robust("student"))`.

    Raises:
        InputError: for a memory that is no number of at least 2, or an update that is none.
    """
    if not isinstance(update, Update):
        raise InputError(f"update must be one such as sigmax.once or sigmax.iterated(2); it is {update!r}")
    check_memory(memory)
    return replace(update, memory=float(memory))


def by_sensor(updates: Mapping[str, Update | str], others: Update | str | None = None) -> BySensor:
    """An update for each sensor by its name, such as `{"gps": "student", "odometer": "once"}`.

    Raises:
        InputError: for what is not such a dict, or an update that is none.
    """
    if not isinstance(updates, Mapping) or not updates or not all(isinstance(sensor, str) for sensor in updates):
        raise InputError(f"updates by sensor are a dict such as {{'gps': 'student'}}; it is {updates!r}")
    return BySensor(
        tuple((sensor, _alone(named(update))) for sensor, update in updates.items()),
        None if others is None else _alone(named(others)),
    )


def _alone(update: Update | BySensor) -> Update:
    if isinstance(update, BySensor):
        raise InputError(f"the update of one sensor is one such as sigmax.robust('student'); it is {update}")
    return update


def named(update: Update | BySensor | str | Mapping[str, Any]) -> Update | BySensor:
    """An update by its name, each part with its first parameter: "once", "iterated(5)", "iterated(2) student(4)".

    A dict is one for each sensor, see `by_sensor`.

    Raises:
        InputError: for what is neither an update nor the name of one.
    """
    if isinstance(update, Update | BySensor):
        return update
    if isinstance(update, Mapping):
        return by_sensor(update)
    if not isinstance(update, str):
        raise InputError(
            f"update must be one such as sigmax.once, sigmax.iterated(3) or sigmax.robust('student'), or its name; "
            f"it is {type(update).__name__}"
        )
    found: dict[str, Update] = {}
    for kind, value in _PART.findall(update) if _PARTS.fullmatch(update) else [(update, "")]:
        if kind not in _KINDS:
            raise unknown("update", kind, _KINDS)
        made = _part(kind, value.strip())
        what = "weight" if made.weight is not None else "memory" if made.memory else "iterations"
        what = what if made != once else "once"
        if what in found:
            raise InputError(f"{update!r} says twice how a measurement corrects; give one of {', '.join(WEIGHTS)}")
        found[what] = made
    weight = found["weight"].weight if "weight" in found else None
    memory = found["memory"].memory if "memory" in found else None
    return replace(found.get("iterations", once), weight=weight, memory=memory)


_PART = re.compile(r"(\w+)\s*(?:\(([^()]*)\))?")
_PARTS = re.compile(rf"\s*(?:{_PART.pattern}\s*)+")
_KINDS: Mapping[str, Callable[..., Any]] = {"once": lambda: once, "iterated": iterated, "adaptive": adaptive, **WEIGHTS}


def _part(kind: str, value: str) -> Update:
    takes = list(inspect.signature(_KINDS[kind]).parameters.items())
    if value and not takes:
        raise InputError(f"the update {kind} takes no parameter; it was given ({value})")
    found = _KINDS[kind](*([_read(kind, *takes[0], value)] if value else []))
    return found if isinstance(found, Update) else robust(found)


def _read(kind: str, name: str, parameter: inspect.Parameter, value: str) -> Any:
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{name} of the update {kind} must be a number; it is {value!r}") from None
    whole = parameter.annotation is int
    return (int if whole else float)(fitted(f"the update {kind}", name, int if whole else float | None, number))


def _written(weight: Weight) -> str:
    """A weight as `named` reads it, where it can."""
    for kind, make in WEIGHTS.items():
        if type(weight) is make:
            first = next(iter(inspect.signature(make).parameters))
            value = getattr(weight, first)
            if make(**{first: value}) == weight:
                return f"{kind}({value:g})"
    return str(weight)
