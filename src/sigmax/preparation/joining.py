"""Filter, model and prior together, as the engines take them."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.filters import Bank, BySensor, Filter, ModeFilters
from sigmax.functions.current import check_model, found_once
from sigmax.modelling.bias import joint
from sigmax.modelling.checks import enough_memory, is_traced
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.information import Information
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.preparation.from_information import from_information, information_of_bias
from sigmax.rewriting.augment import augment
from sigmax.steps.adaptive_noises import check_adapted

augmented = found_once(augment)


def joined(filter: Filter, model: Model, prior: Gaussian) -> tuple[Filter, Model, Gaussian]:
    """Filter, model and prior as the engines take them: the bias in the state, where the form wants it.

    Raises:
        InputError: where one of them is something else, or the prior does not fit the model.
    """
    check_model(model)
    if not isinstance(prior, Gaussian):
        raise InputError(f"prior must be a sigmax.Gaussian, it is {type(prior).__name__}")
    if prior.size != model.size:
        raise InputError(f"the prior has {prior.size} components, the model {model.size}: {list(model.state)}")
    if prior.dim != model.dim:
        raise InputError(
            f"the covariance of the prior is of {prior.dim} deviations, the model has {model.dim}: "
            f"{list(model.deviations)}"
        )
    singular = isinstance(prior, Information)
    if isinstance(prior, Information):
        filter, prior = from_information(filter, model, prior)
    elif not model.space.flat:
        prior = _on_space(model, prior)
    check_adapted(filter, model)
    for own, part in modes_of(filter, model):
        check_named(own, part)
        if part.constraints and part is not model:
            raise InputError("modes would have to be weighed by the constraint: constrain one mode alone")
    tracks, n = len(prior.mean) if prior.mean.ndim == 2 else 1, model.size + model.biases
    enough_memory(f"a filter of {tracks} tracks", (2.0 * n + n * n) * tracks)
    filter = filter.on(model.biases)
    if model.bias is None:
        return filter, model, prior
    first = filter.form.bias_first
    bias = information_of_bias(model.bias.prior) if singular else model.bias.prior
    return filter, augmented(model, first), joint(prior, bias, first)


def modes_of(filter: Filter, model: Model) -> list[tuple[Filter, Model]]:
    """The filter and model of each mode; of an ordinary model these two themselves."""
    if isinstance(filter, ModeFilters) and isinstance(model, SwitchingModel):
        return list(zip(filter.modes, model.models, strict=True))
    return [(filter, model)]


def check_named(filter: Filter, model: Model) -> None:
    """Refuse updates of sensors that the model does not have, or has only as one, and components that it has not.

    Raises:
        InputError: for them.
    """
    components = [*map(str, model.deviations), *(() if model.bias is None else map(str, model.bias.names))]
    for name in filter.consider:
        if name not in components:
            raise InputError(f"consider: {unknown('component', name, components)}")
    if filter.consider and len(filter.consider) == len(components):
        raise InputError(f"{filter.name} considers every component of {model}: it would estimate nothing")
    if model.constraints and isinstance(filter, Bank):
        raise InputError(
            "members of a bank would have to be weighed by the constraint; run its members' filter, or constrain what "
            "the bank found: sigmax.constrained"
        )
    if not isinstance(filter.update, BySensor):
        return
    for sensor, _ in filter.update.updates:
        if sensor not in model.sensors:
            raise unknown("sensor", sensor, model.sensors)
    if model.fusion is not None:
        raise InputError(f"fused sensors are corrected as one; give one update for all, not {filter.update}")


def _on_space(model: Model, prior: Gaussian) -> Gaussian:
    """The prior with its mean on the model's space, to the last digit.

    Raises:
        InputError: where it is not near it.
    """
    array: Any = jnp if is_traced(prior.mean) else np
    near = array.moveaxis(model.space.nearest(array.moveaxis(prior.mean, -1, 0)), 0, -1)
    if array is np:
        gap = np.abs(near - prior.mean).reshape(-1, prior.size).max(0)
        off = [name for name, far in zip(model.state, gap, strict=True) if not far < 1e-3]
        if off:
            raise InputError(f"the mean of the prior must have unit length where it turns or points, in {off}")
    return Gaussian.unchecked(near, prior.cov)
