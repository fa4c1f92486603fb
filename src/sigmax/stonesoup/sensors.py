"""Measurement models of Stone Soup as functions that sigmax can compile."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import (
    Cartesian2DToBearing,
    CartesianToBearingRange,
    CartesianToElevationBearingRange,
    CartesianToElevationBearingRangeRate,
)
from stonesoup.types.angle import Bearing, Elevation

from sigmax.stonesoup.translate import Seen, sensor_of


@lru_cache
def _components(mapping: tuple[int, ...]) -> Callable[..., Any]:
    return lambda x: jnp.stack([x[i] for i in mapping])


@sensor_of.register
def _(model: LinearGaussian) -> Seen:
    mapping = tuple(int(i) for i in model.mapping)
    return Seen(_components(mapping), None, np.asarray(model.covar(), float), (None,) * len(mapping), model.ndim_state)


@lru_cache
def _flat(mapping: tuple[int, ...], ranged: bool) -> Callable[..., Any]:
    def function(x: Any, u: Any) -> Any:
        a, b = x[mapping[0]] - u[0], x[mapping[1]] - u[1]
        right, up = u[2] * a + u[3] * b, u[4] * a + u[5] * b
        bearing = jnp.arctan2(up, right)
        return jnp.stack([bearing, jnp.hypot(right, up)] if ranged else [bearing])

    return function


@lru_cache
def _round(mapping: tuple[int, ...], velocity: tuple[int, ...]) -> Callable[..., Any]:
    def function(x: Any, u: Any) -> Any:
        away = jnp.stack([x[i] - u[k] for k, i in enumerate(mapping)])
        right, up, high = (sum(u[3 + 3 * r + k] * away[k] for k in range(3)) for r in range(3))
        flat = jnp.hypot(right, up)
        seen = [jnp.arctan2(high, flat), jnp.arctan2(up, right), jnp.hypot(flat, high)]
        if velocity:
            rate = sum(away[k] * (x[i] - u[12 + k]) for k, i in enumerate(velocity))
            seen.append(rate / seen[2])
        return jnp.stack(seen)

    return function


def _mapping(given: Any) -> tuple[int, ...]:
    return tuple(int(i) for i in given)


@sensor_of.register(CartesianToBearingRange)
@sensor_of.register(Cartesian2DToBearing)
def _(model: Any) -> Seen:
    ranged = isinstance(model, CartesianToBearingRange)
    u = np.concatenate([np.ravel(model.translation_offset)[:2], model.rotation_matrix[:2, :2].ravel()]).astype(float)
    angles = (Bearing, None) if ranged else (Bearing,)
    function = _flat(_mapping(model.mapping[:2]), ranged)
    return Seen(function, u, np.asarray(model.covar(), float), angles, model.ndim_state)


@sensor_of.register(CartesianToElevationBearingRange)
@sensor_of.register(CartesianToElevationBearingRangeRate)
def _(model: Any) -> Seen:
    rate = isinstance(model, CartesianToElevationBearingRangeRate)
    parts = [np.ravel(model.translation_offset), model.rotation_matrix.ravel()]
    if rate:
        parts.append(np.ravel(model.velocity))
    velocity = _mapping(model.velocity_mapping) if rate else ()
    angles = (Elevation, Bearing, None, *((None,) if rate else ()))
    function = _round(_mapping(model.mapping), velocity)
    return Seen(
        function, np.concatenate(parts).astype(float), np.asarray(model.covar(), float), angles, model.ndim_state
    )
