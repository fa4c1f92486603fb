"""How heavy the tails of each sensor's noise are, found by the likelihood of a record."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter, Update, by_sensor, robust
from sigmax.modelling.checks import numbers
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.preparation.prepare import as_filter
from sigmax.running.run import run
from sigmax.steps.updating import update_on

# Degrees of freedom from which tails are Gaussian for any practical purpose are "once".
DEGREES = (0.5, 1.0, 2.0, 4.0, 8.0)
# The logarithm of a likelihood ratio that one number more has to gain (Akaike asks for 1).
_WORTH = 2.0


def fit_tails(
    filter: Filter | str, model: Model, prior: Gaussian, z: Any, *, degrees: Sequence[float] = DEGREES, **options: Any
) -> Filter:
    """The filter with a Student update for each sensor whose noise has heavier tails than a Gaussian's.

    Sensor by sensor the degrees of freedom with the largest likelihood are taken, or the update that the filter has,
    where they gain less than 2 in the logarithm. R is not fitted: it has to be that of good measurements.

    Args:
        filter: a name of the catalogue, or a filter; iterations of its update stay.
        model: the model.
        prior: as in `run`.
        z: the record; the likelihoods of a batch are added.
        degrees: to choose from, above 0.
        options: of `run`: dt, inputs, update_first, backend.

    Raises:
        InputError: for what `run` refuses, where there is nothing to choose from, and where sensors are fused.

    It runs the record once for each of the degrees and sensors, and compiles as often.
    """
    chosen = as_filter(filter)
    choices = np.atleast_1d(numbers("degrees", degrees)).astype(float)
    if choices.ndim != 1 or not choices.size or not (choices > 0).all():
        raise InputError(f"degrees must hold at least one number above 0 to choose from; it is {degrees!r}")
    if "keep" in options:
        raise InputError("fit_tails gives a filter, not a result: keep= belongs to run")
    if model.fusion is not None:
        raise InputError("the tails of fused sensors cannot be told apart; give the model before it was fused")
    own = {sensor: update_on(chosen, model, sensor) for sensor in model.sensors}
    best, most = dict(own), _likelihood(chosen, model, prior, z, options)
    for sensor, update in own.items():
        bare = replace(update, weight=None)
        tried = [best | {sensor: robust("student", bare, dof=float(dof))} for dof in choices]
        gained = [_likelihood(_with(chosen, updates), model, prior, z, options) for updates in tried]
        top = int(np.argmax(gained))
        if gained[top] > most + _WORTH:
            best, most = tried[top], gained[top]
    return chosen if best == own else _with(chosen, best)


def _with(filter: Filter, updates: dict[str, Update]) -> Filter:
    (first, *more) = updates.values()
    update = by_sensor(updates) if more else first
    return replace(filter, update=update, name=f"{filter.name}, {update}")


def _likelihood(filter: Filter, model: Model, prior: Gaussian, z: Any, options: dict[str, Any]) -> float:
    """The log-likelihood of all tracks; none where a step failed, as what was left out has no likelihood."""
    result = run(filter, model, prior, z, keep=("fault",), **options)
    total = float(np.sum(result.log_likelihood))
    return total if np.isfinite(total) and (np.asarray(result.fault) <= 0).all() else -np.inf
