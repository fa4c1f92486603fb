"""Noises times factors: all of Q or R, or a component of them, whose correlations stay."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of, arrays_of, takes
from sigmax.modelling.switching import SwitchingModel

Place = tuple[str | int, ...]


def with_factor(model: Model, at: Place, factor: Any) -> Model:
    """A model whose variances are times a factor, a number or traced.

    Args:
        model: the model.
        at: ("Q",), ("Q", component), ("R",), ("R", sensor) or ("R", sensor, component).
        factor: of variances.
    """
    if isinstance(model, SwitchingModel):
        return model.with_models([with_factor(m, at, factor) for m in model.models])
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
