"""Numbers of a record that are to be fitted, by their names, and the model and prior that they make."""

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError, unknown
from sigmax.fitting import Build
from sigmax.models import Gaussian, Model
from sigmax.models.noise import OF_MOTION, OF_SENSOR, arguments_of, arrays_of, takes
from sigmax.models.switching import SwitchingModel
from sigmax.records.description import Description, read_toml
from sigmax.records.landmarks import with_landmark_inputs
from sigmax.records.model import build
from sigmax.records.record import Record
from sigmax.records.units import Freed, parts_of_quantity

Place = tuple[str | int, ...]
# Where numbers of a description may be freed, "*" for any name; the last is that of the number.
_FREE = (
    "motion.noise.*", "motion.*.noise.*", "motion.tau", "motion.*.tau", "modes.*.motion.noise.*",
    "modes.*.motion.*.noise.*", "modes.*.motion.tau", "sensors.*.noise.*", "sensors.*.origin.*",
    "sensors.*.reference.*", "sensors.*.speed", "prior.*.mean", "prior.*.std", "bias.*.mean", "bias.*.std",
    "bias.*.noise",
)  # fmt: skip
_ASKED = re.compile(r"\s*([^=]+?)\s*(?:=\s*(\S+?)\s*\.\.\s*(\S+)\s*)?")


class Number(NamedTuple):
    """One number that is freed.

    Attributes:
        name: as it was asked for.
        kind: "factor" of Q or R, "value" of a component of state or bias, "place" in a description.
        start: where it stands now, in its unit.
        unit: of the description, or SI.
        positive: whether it has to be.
        bounds: or None.
        at: the place in the description, or the names behind Q and R.
    """

    name: str
    kind: str
    start: float
    unit: str
    positive: bool
    bounds: tuple[float, float] | None
    at: Place = ()


def asked(text: Sequence[str]) -> dict[str, tuple[float, float] | None]:
    """Names and bounds from "Q,range_scale", "tau=1..30".

    Raises:
        InputError: for other syntax, and a name that comes twice.
    """
    found: dict[str, tuple[float, float] | None] = {}
    for piece in filter(None, (p.strip() for one in text for p in one.split(","))):
        match = _ASKED.fullmatch(piece)
        if match is None or ("=" in piece and match[2] is None):
            raise InputError(f"--free {piece!r} should be NAME or NAME=LOW..HIGH, as in Q,tau=1..30")
        if match[1] in found:
            raise InputError(f"--free names {match[1]} twice")
        try:
            found[match[1]] = None if match[2] is None else (float(match[2]), float(match[3]))
        except ValueError:
            raise InputError(f"--free {piece!r}: the bounds are numbers, in the unit of the number") from None
    if not found:
        raise InputError("--free names no number, such as --free Q,R")
    return found


def find(record: Record, path: Path | None, names: Mapping[str, tuple[float, float] | None]) -> list[Number]:
    """The numbers of these names.

    Args:
        record: the record.
        path: of its description, None for one that is built in.
        names: and bounds.

    Raises:
        InputError: for a name that is none, or stands for several numbers.
    """
    places = {} if path is None else dict(_places(tomllib.loads(path.read_text(encoding="utf-8"))))
    return [_number(record, places, name, bounds) for name, bounds in names.items()]


def _number(record: Record, places: dict[Place, Any], name: str, bounds: tuple[float, float] | None) -> Number:
    head, _, rest = name.partition(".")
    if head in ("Q", "R"):
        at = _of_noise(record, head, rest, name)
        return Number(name, "factor", 1.0, "", True, bounds, at)
    if name in record.components:
        bias = record.model.bias
        mean = np.atleast_2d(record.prior.mean).mean(0)
        mean = mean if bias is None else np.concatenate([mean, np.atleast_2d(bias.prior.mean).mean(0)])
        if record.model.curved:
            raise InputError(f"--free {name}: the state has parts that turn or point; free numbers of the description")
        at_start = float(mean[list(record.components).index(name)])
        return Number(name, "value", at_start, record.components[name].symbol, False, bounds, (name,))
    parts = tuple(re.sub(r"\[(\d+)\]", r".\1", name).split("."))
    fitting = [p for p in places if tuple(map(str, p))[-len(parts) :] == parts]
    fitting = [p for p in fitting if tuple(map(str, p)) == parts] or fitting
    if not fitting:
        known = ["Q", "R", *record.components, *(".".join(map(str, p)) for p in places)]
        raise InputError(f"--free: {unknown('number', name, known)}")
    if len(fitting) > 1:
        listed = ", ".join(".".join(map(str, p)) for p in fitting)
        raise InputError(f"--free: {name!r} may be {listed}: write one of them")
    value, unit = _parsed(places[fitting[0]])
    positive = str(fitting[0][-1]) not in ("mean",) and fitting[0][-2] not in ("origin", "reference")
    if positive and bounds is None and not value > 0:
        raise InputError(f"--free {name}: it is {places[fitting[0]]!r}; start it above 0, or give it bounds")
    return Number(name, "place", value, unit, positive, bounds, fitting[0])


def _of_noise(record: Record, head: str, rest: str, name: str) -> Place:
    """The components of a factor of Q, sensor and component of one of R."""
    if not rest:
        return (head,)
    if head == "Q":
        if rest not in record.model.deviations:
            raise InputError(f"--free {name}: {unknown('component', rest, record.model.deviations)}")
        return head, rest
    sensor, _, component = rest.partition(".")
    if sensor not in record.model.sensors and "" in record.model.sensors:
        sensor, component = "", rest
    if sensor not in record.model.sensors:
        raise InputError(f"--free {name}: {unknown('sensor', sensor, record.model.sensors)}")
    known = record.model.measured_deviations(sensor) or ()
    if component and component not in known:
        raise InputError(f"--free {name}: {unknown('component', component, known)}")
    return (head, sensor, component) if component else (head, sensor)


def _places(given: Any, above: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Numbers of a TOML that may be freed, with their places."""
    items = given.items() if isinstance(given, dict) else enumerate(given) if isinstance(given, list) else ()
    for key, value in items:
        at = (*above, key)
        if isinstance(value, dict | list):
            yield from _places(value, at)
        elif any(_fits(at, pattern.split(".")) for pattern in _FREE) and _parsed(value) is not None:
            yield at, value


def _fits(at: Place, pattern: list[str]) -> bool:
    return len(at) == len(pattern) and all(p in ("*", str(a)) for a, p in zip(at, pattern, strict=True))


def _parsed(value: Any) -> Any:
    """Number and unit of a quantity, None for what is none."""
    if isinstance(value, str):
        try:
            return parts_of_quantity(value)
        except InputError:
            return None
    return (float(value), "") if isinstance(value, int | float) and not isinstance(value, bool) else None


def build_of(
    record: Record, path: Path | None, numbers: Sequence[Number], told: Callable[[Model], tuple[Model, Gaussian]]
) -> Build:
    """Model and prior of the record as a function of the numbers by name.

    A prior that stands at the first measurements stays what it is; of the others the numbers in it are fitted.

    Args:
        record: the record.
        path: of its description.
        numbers: that are freed.
        told: what a trial makes of a model: model and prior with what it fixes.
    """
    description = None
    if path is not None and any(n.kind == "place" for n in numbers):
        description = with_landmark_inputs(read_toml(path, Description))

    def made(parameters: Any) -> tuple[Model, Gaussian]:
        model = record.model
        if description is not None and path is not None:
            says = description
            for n in numbers:
                if n.kind == "place" and n.at[0] != "prior":
                    says = _put(says, n.at, Freed(parameters[n.name], n.unit))
            model = build(says, path.parent).model
        model, prior = told(model)
        for n in numbers:
            if n.kind == "factor":
                model = _with_factor(model, n.at, parameters[n.name])
            elif n.kind == "value":
                model, prior = _with_value(model, prior, str(n.at[0]), parameters[n.name])
            elif n.at[0] == "prior":
                prior = _with_prior(record, prior, n, parameters[n.name])
        return model, prior

    return made


def _put(within: Any, at: Place, value: Any) -> Any:
    """A copy of a description with another value at a place; one table of a motion counts as the first of a list."""
    if not at:
        return value
    key, *rest = at
    if isinstance(within, BaseModel):
        return within.model_copy(update={str(key): _put(getattr(within, str(key)), tuple(rest), value)})
    if isinstance(within, list):
        index, rest = (key, rest) if isinstance(key, int) else (0, [key, *rest])
        return [_put(v, tuple(rest), value) if i == index else v for i, v in enumerate(within)]
    return {**within, key: _put(within[key], tuple(rest), value)}


def _with_factor(model: Model, at: Place, factor: Any) -> Model:
    """Q or R times a factor, all of it or that of a component, whose correlations stay."""
    if isinstance(model, SwitchingModel):
        return model.with_models([_with_factor(m, at, factor) for m in model.models])
    if at[0] == "Q":
        return model.with_parts(Q=_scaled(model.Q, OF_MOTION, factor, model.deviations, at[1:]))
    some = model.sensors if len(at) == 1 else (at[1],)
    changed = {
        s: _scaled(model.R[s], OF_SENSOR, factor, model.measured_deviations(s) or (), at[2:]) for s in map(str, some)
    }
    return model.with_parts(R={**model.R, **changed})


def _scaled(noise: Any, allowed: tuple[int, ...], factor: Any, names: Sequence[str], only: Place) -> Any:
    where = np.array([not only or name in only for name in names])

    def times(value: Any) -> Any:
        array = arrays_of((value, factor))
        if not only:
            return array.asarray(value) * factor
        root = array.where(where, array.sqrt(factor), 1.0)
        value = array.asarray(value)
        return value * root * root if value.ndim == 1 else value * root[:, None] * root[None, :]

    if isinstance(noise, Diagonal):
        return Diagonal(times(noise.entries))
    if not callable(noise):
        return times(noise)
    count = takes(noise, "the noise", allowed)
    if allowed == OF_SENSOR:
        return (lambda x, u: times(noise(x, u))) if count == 2 else (lambda x: times(noise(x)))
    if count == 1:
        return lambda dt: times(noise(dt))
    if count == 2:
        return lambda x, dt: times(noise(x, dt))
    return lambda x, dt, u: times(noise(*arguments_of(noise, "Q", OF_MOTION, x, dt, (u,))))


def _with_value(model: Model, prior: Gaussian, name: str, value: Any) -> tuple[Model, Gaussian]:
    """A component of state or bias that has this value at the start, known exactly."""
    if name in model.deviations:
        return model, _known(prior, model.deviations.index(name), value)
    assert model.bias is not None
    return model.with_bias_prior(_known(model.bias.prior, model.bias.names.index(name), value)), prior


def _known(prior: Gaussian, i: int, mean: Any) -> Gaussian:
    kept = np.arange(prior.dim) != i
    return _gaussian(prior, i, mean, prior.cov * np.outer(kept, kept))


def _gaussian(prior: Gaussian, i: int, mean: Any, cov: Any) -> Gaussian:
    array = arrays_of((prior.mean, mean, cov))
    made = object.__new__(Gaussian)
    made.mean, made.cov = array.where(np.arange(prior.size) == i, mean, prior.mean), cov
    return made


def _with_prior(record: Record, prior: Gaussian, n: Number, value: Any) -> Gaussian:
    """The prior with another mean or deviation of a component, which is independent of the others."""
    from sigmax.records.units import quantity

    i = record.model.deviations.index(n.at[1])
    si = quantity(Freed(value, n.unit), record.dimensions[i], n.name)
    if n.at[2] == "mean":
        return _gaussian(prior, i, si, prior.cov)
    array = arrays_of((prior.cov, si))
    at = np.zeros((prior.dim, prior.dim), bool)
    at[i, i] = True
    made = object.__new__(Gaussian)
    made.mean, made.cov = prior.mean, array.where(at, array.square(si), prior.cov)
    return made
