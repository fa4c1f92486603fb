"""The TOML of a record with what the doctor found put right, and the reason at each line that is changed."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.model import build
from sigmax.descriptions.prior import ALL_FROM, FROM
from sigmax.errors import InputError
from sigmax.examination import Finding
from sigmax.files.description import Description, read_toml
from sigmax.files.toml_edit import Document, scaled
from sigmax.files.units import ANGLE, NUMBER, TIME, Dimension, quantity, to_si, unit_of


class Correction(NamedTuple):
    """A new description.

    Attributes:
        text: the TOML.
        changed: what was put right, in words.
        left: what a description cannot say, and what is to be done instead.
    """

    text: str
    changed: tuple[str, ...]
    left: tuple[str, ...]


class _Of(NamedTuple):
    """What is corrected: the text, what it says, and the model it makes."""

    document: Document
    says: Description
    built: DescribedModel

    @property
    def state(self) -> list[str]:
        """The names of the components of the state."""
        return [str(name) for name in self.built.model.state]


def correct(path: Path, findings: Sequence[Finding]) -> Correction:
    """The description at `path` without what was found; its comments stay.

    Raises:
        InputError: where the description does not fit.
    """
    says = read_toml(path, Description)
    of = _Of(Document(path.read_text(encoding="utf-8")), says, build(says, path.parent))
    changed, left = [], []
    for f in findings:
        said, before = f"{f.cause}{f', {f.size}' if f.size else ''}", of.document.text
        try:
            if f.provisional:
                raise InputError("it is provisional: examine the new file")
            _EDITS.get(f.kind, _not_here)(of, f, said)
            changed.append(said)
        except InputError as error:
            of.document.text = before
            left.append(f"{said}: not written, {error}; to do: {f.change}")
    return Correction(of.document.text, tuple(changed), tuple(left))


def _not_here(of: _Of, f: Finding, said: str) -> None:
    raise InputError("a description has no words for it")


def _component(of: _Of, where: str) -> tuple[str, str]:
    """Sensor and component of "sensor.component"."""
    sensor = next((s for s in of.built.sensings if where.startswith(f"{s}.")), None)
    if sensor is None or where[len(sensor) + 1 :] not in of.built.sensings[sensor].dimensions:
        raise InputError(f"{where} is not one component of a sensor")
    return sensor, where[len(sensor) + 1 :]


def _in_si(value: float, digits: int, dimension: Dimension) -> str:
    """A quantity as a description has it, such as "0.35 m"."""
    return f"{value:.{digits}g} {dimension.symbol}".rstrip()


def _components(of: _Of, where: str) -> list[tuple[str, str]]:
    """All components that a finding is about."""
    every = [(s, c) for s, sensing in of.built.sensings.items() for c in sensing.dimensions]
    if where == "all components":
        return every
    if where == "all lengths":
        return [(s, c) for s, c in every if of.built.sensings[s].dimensions[c] != ANGLE]
    return [(s, c) for s, c in every if s == where] or [_component(of, where)]


def _noise_of_sensor(of: _Of, f: Finding, said: str) -> None:
    """R times a factor, or with the variance of steps."""
    for sensor, component in _components(of, f.where):
        given, at = of.says.sensors[sensor].noise, ("sensors", sensor, "noise")
        if not isinstance(given, dict):
            raise InputError(f"{'.'.join(at)} is {'a covariance' if isinstance(given, list) else 'a function'}")
        value = given[component]
        if isinstance(value, dict):
            raise InputError(f"{'.'.join(at)}.{component} is a column of the data")
        now = quantity(value, of.built.sensings[sensor].dimensions[component], ".".join(at))
        if now == 0:
            raise InputError(f"{'.'.join(at)}.{component} is 0")
        variance = now**2 * np.exp(f.value) if f.kind == "R" else now**2 + f.value**2 / 12
        of.document.put((*at, component), scaled(value, np.sqrt(variance) / now), said)


def _noise_of_motion(of: _Of, f: Finding, said: str) -> None:
    """Q times a factor, where a number of the description holds for just the components concerned."""
    motions, wanted = of.says.motion, None if f.where == "all components" else set(f.where.split(", "))
    if not motions:
        raise InputError("its modes have a noise each")
    done = False
    for i, part in enumerate(motions):
        at = ("motion", i, "noise") if len(motions) > 1 else ("motion", "noise")
        if not isinstance(part.noise, dict):
            raise InputError("the noise of the motion is a covariance or a function")
        for key, value in part.noise.items():
            held = _held_by(of, key, list(part.noise))
            if wanted is not None and held != wanted:
                if held & wanted:
                    raise InputError(f"{key} of motion.noise holds for {', '.join(sorted(held))} alike")
                continue
            # Densities are of variances, everything else is a deviation.
            of.document.put((*at, key), scaled(value, np.exp(f.value if key == "density" else f.value / 2)), said)
            done = True
    if not done:
        raise InputError("no number of motion.noise is that of these components")


def _held_by(of: _Of, key: str, keys: list[str]) -> set[str]:
    """The components whose noise a key of the motion says."""
    if key in of.state:
        return {key}
    if key == "position":
        return {of.state[i] for i in of.built.position}
    return set(of.state) - set(keys)


def _offset(of: _Of, f: Finding, said: str) -> None:
    """A bias that is estimated, with what was found as its prior."""
    places = _components(of, f.where)
    dimensions = {of.built.sensings[s].dimensions[c] for s, c in places}
    if len(dimensions) > 1:
        raise InputError("one offset cannot be of unlike quantities")
    _bias(of, f, said, f.kind if f.kind == "scale" else "offset", NUMBER if f.kind == "scale" else dimensions.pop())


def _bias(of: _Of, f: Finding, said: str, kind: str, dimension: Dimension) -> None:
    name = f"{f.where}_{kind}".replace(".", "_").replace(" ", "_")
    if name in of.says.bias or name in of.built.model.state:
        raise InputError(f"there is a bias {name} already")
    acts: Any = [f.where]
    if kind != "drift":
        places = _components(of, f.where)
        acts = {s: [c for other, c in places if other == s] for s in dict.fromkeys(s for s, _ in places)}
    table = {"mean": _in_si(f.value, 6, dimension), "std": _in_si(f.std, 2, dimension), kind: acts}
    of.document.add(("bias", name), table, said)


def _drift(of: _Of, f: Finding, said: str) -> None:
    dimension = of.built.dimensions[of.state.index(f.where)]
    _bias(of, f, said, "drift", dimension._replace(time=dimension.time - 1))


def _scale(of: _Of, f: Finding, said: str) -> None:
    """Another unit where the factor is one, else a factor that is estimated."""
    if f.factor:
        _unit(of, f, said)
    else:
        _offset(of, f, said)


def _unit(of: _Of, f: Finding, said: str) -> None:
    """The unit of a column, so that its numbers are `factor` times as large in SI."""
    if f.kind == "time units":
        _column(of, ("time",), of.says.time.unit, TIME, f.factor, said)
        return
    for item in of.built.inputs:
        # "motion.inputs.speed" or "motion[1].inputs.speed".
        at = tuple(
            int(part) if part.isdigit() else part for part in item.where.replace("[", ".").replace("]", "").split(".")
        )
        if f.where == item.name:
            if at[0] == "motion" and len(of.says.motion) > 1:  # `where` does not say of which part
                at = ("motion", next(i for i, part in enumerate(of.says.motion) if at[-1] in part.inputs), *at[-2:])
            _column(of, at, item.column.unit, item.dimension, f.factor, said)
            return
    for sensor, component in _components(of, f.where):
        sensing, at = of.built.sensings[sensor], ("sensors", sensor, "columns", component)
        given = of.says.sensors[sensor].columns[component].unit
        _column(of, at, given, sensing.dimensions[component], f.factor, said)


def _column(
    of: _Of, at: tuple[str | int, ...], unit: str, dimension: Dimension | None, factor: float, said: str
) -> None:
    if dimension is None:
        raise InputError("the unit of this input is not known")
    other = unit_of(to_si(unit, dimension, ".".join(map(str, at))) * factor, dimension)
    if other is None:
        raise InputError("there is no unit of this size")
    given = of.document.get(at)
    if isinstance(given, str):
        of.document.put(at, {"column": given, "unit": other}, said)
    else:
        of.document.put((*at, "unit"), other, said)


def _swap(of: _Of, f: Finding, said: str) -> None:
    """The columns of two components exchanged."""
    first, second = f.where.split(", ")
    (s, a), (_, b) = _component(of, first), _component(of, second)
    at = ("sensors", s, "columns")
    one, other = of.document.get((*at, a)), of.document.get((*at, b))
    of.document.put((*at, a), other, said)
    of.document.put((*at, b), one, said)


def _delay(of: _Of, f: Finding, said: str) -> None:
    now = quantity(of.says.sensors[f.where].delay, TIME, "delay")
    if now + f.value < 0:
        raise InputError("a delay must not be negative; another sensor may be late instead")
    of.document.put(("sensors", f.where, "delay"), f"{now + f.value:.4g} s", said)


def _prior(of: _Of, f: Finding, said: str) -> None:
    """Mean of one component, or all deviations."""
    if f.factor:
        names = [name for name in of.state if name in of.says.prior]
        if not names:
            raise InputError("the prior comes from the measurements")
        for name in names:
            of.document.put(("prior", name, "std"), scaled(of.says.prior[name]["std"], np.sqrt(f.factor)), said)
        return
    if f.where not in of.says.prior:
        taken = {FROM, ALL_FROM} & set(of.says.prior) and f.where in of.state
        raise InputError("its mean comes from the first measurements" if taken else "it is not of one component")
    given, dimension = of.says.prior[f.where], of.built.dimensions[of.state.index(f.where)]
    mean, std = (quantity(given[key], dimension, f"prior.{f.where}.{key}") for key in ("mean", "std"))
    of.document.put(("prior", f.where, "mean"), _in_si(mean + f.value * std, 6, dimension), said)


def _robust(of: _Of, f: Finding, said: str) -> None:
    """An update of the sensor that bears long tails."""
    sensor, _ = _component(of, f.where)
    if of.says.sensors[sensor].update is not None:
        raise InputError(f"sensors.{sensor}.update is there already")
    update = "student" if f.kind == "outliers" else f"student({max(f.value, 2.5):.2g})"
    of.document.put(("sensors", sensor, "update"), update, said)


_EDITS: dict[str, Callable[[_Of, Finding, str], None]] = {
    "R": _noise_of_sensor, "coarse": _noise_of_sensor, "Q": _noise_of_motion, "bias": _offset, "scale": _scale,
    "drift": _drift, "units": _unit, "degrees": _unit, "time units": _unit, "swap": _swap, "delay": _delay,
    "prior": _prior, "outliers": _robust, "tails": _robust,
}  # fmt: skip
