"""Noises that a filter finds as it goes: which, where they stand in its belief, and what may not be found so."""

from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Bank, Filter, ModeFilters
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.steps.updating import update_on


class AdaptiveBelief(NamedTuple):
    """Mean (n, ...), lower factor (n, n, ...), and what else is known (k, ...): of noises, or of an open start."""

    mean: Any
    factor: Any
    known: Any


class Noises(NamedTuple):
    """Where it stands what is known of noises: λ of sensors, then of each group of Q what `QScale` has.

    Attributes:
        sensors: by name, from where to where its λ stand.
        points: numbers of the mean.
        n: rows of the factor.
        groups: rows of the factor of Q that share a number; none where Q is the model's.
        names: of all λ, then of the numbers of Q, as columns of tables have them.
    """

    sensors: tuple[tuple[str, int, int], ...] = ()
    points: int = 0
    n: int = 0
    groups: tuple[tuple[int, ...], ...] = ()
    names: tuple[str, ...] = ()

    @property
    def each(self) -> int:
        """Numbers for each group: the logarithm, its information, and derivatives of mean and factor."""
        return 2 + self.points + self.n * (self.n + 1) // 2

    @property
    def first(self) -> int:
        """Where those of Q begin."""
        return max((b for _, _, b in self.sensors), default=0)

    @property
    def size(self) -> int:
        """Numbers of all together."""
        return self.first + len(self.groups) * self.each

    @property
    def logarithms(self) -> list[int]:
        """Where the logarithms of the numbers of Q stand."""
        return [self.first + k * self.each for k in range(len(self.groups))]

    def of(self, sensor: str) -> slice | None:
        """Where the λ of a sensor stand, None where its R is the model's."""
        return next((slice(a, b) for name, a, b in self.sensors if name == sensor), None)


def adapted_noises(filter: Filter, model: Model) -> Noises:
    """The noises that a filter adapts on a model of one mode, its bias written into its state."""
    if isinstance(filter, Bank | ModeFilters) or isinstance(model, SwitchingModel):
        return Noises()
    sensors, names, at = [], [], 0
    for sensor in model.sensors:
        if update_on(filter, model, sensor).memory is not None:
            measured = list(map(str, model.measurement[sensor] or ()))
            size = model.measured_space(sensor, len(measured)).dim
            each = measured if len(measured) == size else list(map(str, range(size)))
            names += [f"R_scale_{sensor}_{name}" if model.several else f"R_scale_{name}" for name in each]
            sensors.append((sensor, at, at + size))
            at += size
    return Noises(tuple(sensors), model.space.size, model.space.dim, *_groups(filter, model, names))


def _groups(filter: Filter, model: Model, names: list[str]) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
    """The rows of each group of Q, and names with theirs behind them."""
    if filter.Q is None:
        return (), tuple(names)
    components = list(map(str, model.deviations))
    if filter.Q.groups is None:
        return (tuple(range(len(components))),), (*names, "Q_scale")
    rows = tuple(tuple(map(components.index, group)) for group in filter.Q.groups)
    return rows, (*names, *(f"Q_scale_{'_'.join(group)}" for group in filter.Q.groups))


def adapts(filter: Filter, model: Model) -> bool:
    """Whether a filter, or one of a bank or of several modes, adapts a noise of the model."""
    models = model.models if isinstance(model, SwitchingModel) else (model,)
    filters = filter.modes if isinstance(filter, ModeFilters) else (filter,)
    found = (
        f.Q is not None or update_on(f, m, s).memory is not None for f in filters for m in models for s in m.sensors
    )
    return any(found)


def check_adapted(filter: Filter, model: Model) -> None:
    """Refuse to adapt what cannot be adapted.

    Raises:
        InputError: for modes, a bank, fused sensors, noise inside functions, names that the model does not have, and R
            without names of what is measured.
    """
    if not adapts(filter, model):
        return
    said = f"{filter.name} finds noises as it goes"
    if isinstance(filter, Bank | ModeFilters) or isinstance(model, SwitchingModel):
        raise InputError(
            f"{said}, and modes or members of a bank would each find another one; take a filter of one belief, or let "
            "modes differ in their noises"
        )
    if model.fusion is not None:
        raise InputError(f"{said}, which fused sensors share; give the model before it was fused")
    if filter.Q is not None:
        if model.noise_inside(None) is not None:
            raise InputError(f"{said}, and that of the motion is inside its function: give it as Q, or fit it")
        names = [*map(str, model.deviations), *(() if model.bias is None else map(str, model.bias.names))]
        for name in (name for group in filter.Q.groups or () for name in group if name not in names):
            raise InputError(f"groups of an adaptive Q: {unknown('component', name, names)}")
    for sensor in model.sensors:
        if update_on(filter, model, sensor).memory is None:
            continue
        where = f"of the sensor {sensor!r}" if sensor else "of the sensor"
        if model.noise_inside(sensor) is not None:
            raise InputError(f"{said}, and the noise {where} is inside its function: give it as R, or fit it")
        if model.measurement[sensor] is None:
            raise InputError(f"{said}, a number for each component {where}: name them with measurement= in the model")


def scales(noises: Noises, known: Any) -> dict[str, Any]:
    """All numbers (...) by which noises are multiplied, by the name of their column, of what is known (..., k)."""
    each = [known[..., i] for i in range(noises.first)]
    each += [np.exp(known[..., i]) for i in noises.logarithms]
    return dict(zip(noises.names, each, strict=True))
