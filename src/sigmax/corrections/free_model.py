"""Model and prior of a record as functions of the numbers that are freed."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from sigmax.corrections.free_numbers import Number, Place
from sigmax.descriptions.landmarks import with_landmark_inputs
from sigmax.descriptions.model import build
from sigmax.files.description import Description, read_toml
from sigmax.files.units import Freed, quantity
from sigmax.fitting import Build
from sigmax.fitting.noise_factors import with_factor
from sigmax.modelling.noise import arrays_of
from sigmax.models import Gaussian, Model
from sigmax.records.record import Record


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
                model = with_factor(model, n.at, parameters[n.name])
            elif n.kind == "value":
                model, prior = _with_value(model, prior, str(n.at[0]), parameters[n.name])
            elif n.kind == "place" and n.at[0] == "prior":
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


def _with_value(model: Model, prior: Gaussian, name: str, value: Any) -> tuple[Model, Gaussian]:
    """A component of state or bias that has this value at the start, known exactly."""
    if name in model.deviations:
        return model, _known(prior, model.deviations.index(name), value)
    assert model.bias is not None
    return model.with_bias_prior(_known(model.bias.prior, model.bias.names.index(name), value)), prior


def _known(prior: Gaussian, i: int, mean: Any) -> Gaussian:
    kept = np.arange(prior.dim) != i
    return Gaussian.unchecked(_with_mean(prior, i, mean), prior.cov * np.outer(kept, kept))


def _with_mean(prior: Gaussian, i: int, mean: Any) -> Any:
    return arrays_of((prior.mean, mean)).where(np.arange(prior.size) == i, mean, prior.mean)


def _with_prior(record: Record, prior: Gaussian, n: Number, value: Any) -> Gaussian:
    """The prior with another mean or deviation of a component, which is independent of the others."""
    i = record.model.deviations.index(n.at[1])
    si = quantity(Freed(value, n.unit), record.dimensions[i], n.name)
    if n.at[2] == "mean":
        return Gaussian.unchecked(_with_mean(prior, i, si), prior.cov)
    array = arrays_of((prior.cov, si))
    at = np.zeros((prior.dim, prior.dim), bool)
    at[i, i] = True
    return Gaussian.unchecked(prior.mean, array.where(at, array.square(si), prior.cov))
