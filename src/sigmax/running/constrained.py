"""Estimates conditioned on what is known of the state, after the run: nothing of it goes back into the filter."""

from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter, of_one_belief
from sigmax.functions.current import current_model
from sigmax.modelling.checks import is_traced
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.preparation.prepare import as_filter, cast
from sigmax.results.smoothed import Smoothed
from sigmax.rewriting.augment import augment
from sigmax.running.smooth import check_layout
from sigmax.steps.constraining import conditioned
from sigmax.steps.step import Fault

Estimates = TypeVar("Estimates", bound=Smoothed)


def constrained(filter: Filter | str, model: Model, estimates: Estimates) -> Estimates:
    """Each estimate given the constraints of a model, on its own: cut off between bounds, projected onto values.

    For what `run`, `smooth` and `Live.at` give, of a run with the constraints or without them. An estimate of a state
    that hardly moves is best constrained so: in the recursion the same bound would be taken again in each step.

    Args:
        filter: its rule of the sensor linearises the constraints, its form takes them.
        model: that of the run, with the constraints of `constrain`.
        estimates: with mean and factor kept.

    Returns:
        The same with other means and factors, and a fault where a constraint could not be taken.

    Raises:
        InputError: where the model has no constraint, or the estimates are not of it.
    """
    model = current_model(model)
    check_one_mode(model, "constrained")
    if not isinstance(estimates, Smoothed):
        raise InputError(f"estimates are what run, smooth or Live.at gave; this is {type(estimates).__name__}")
    if not model.constraints:
        raise InputError(f"{model} has no constraint: see sigmax.constrain")
    chosen = of_one_belief(as_filter(filter).on(model.biases))
    check_layout(model, estimates.layout, chosen.form.bias_first)
    mean, factor = estimates.kept()[:2]
    model = cast(augment(model, chosen.form.bias_first), mean.dtype)
    shape = mean.shape[:-1]
    x = jnp.moveaxis(jnp.reshape(mean, (-1, mean.shape[-1])), 0, -1)
    S = jnp.moveaxis(jnp.reshape(factor, (-1, *factor.shape[-2:])), 0, -1)
    x, S, sound = _conditioned(chosen, model, x, S)
    array: Any = jnp if is_traced((mean, factor)) else np
    fault = estimates.stored_fault
    if fault is not None:
        left_out = ~array.reshape(array.asarray(sound), shape)
        fault = array.where(left_out & (array.asarray(fault) == 0), array.int8(Fault.CONSTRAINT_LEFT_OUT), fault)
    return replace(
        estimates,
        stored_mean=array.reshape(array.moveaxis(array.asarray(x), -1, 0), mean.shape),
        stored_factor=array.reshape(array.moveaxis(array.asarray(S), -1, 0), factor.shape),
        stored_fault=fault,
    )


@partial(jax.jit, static_argnums=0)
def _conditioned(filter: Filter, model: Model, x: Any, S: Any) -> Any:
    return conditioned(filter, model, x, S)
