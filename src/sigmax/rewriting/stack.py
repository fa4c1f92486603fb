"""The one sensor that fused sensors make, as an engine takes it."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.modelling.components import components
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, by_value, dense_noise, sensor_of, takes
from sigmax.rewriting.fusion import Block, inputs_behind, name_of


def stack(model: Model) -> Model:
    """The model with the one sensor that its fusion makes: what an engine runs."""
    blocks = model.fusion or ()
    name, heads = name_of(model), [b.members[0] for b in blocks]
    extra = inputs_behind(model)
    driven = tuple(model.sensor_inputs[s] for s in heads)
    h = _stacked(tuple(model.sensors[s] for s in heads), driven, extra)
    return model.with_parts(
        fusion=None,
        motion=fronted(model.motion, 2, extra) if model.motion_inputs else model.motion,
        sensors={name: h},
        sensor_inputs={name: any(driven)},
        measured={name: components("measurement", _names(model, blocks), None, "R")},
        Q=noise_of_motion(model.Q, extra),
        R={name: _noise(model, blocks, extra)},
    )


def _names(model: Model, blocks: tuple[Block, ...]) -> tuple[str, ...]:
    found = [(type(c), f"{'+'.join(b.members)}.{c}") for b in blocks for c in model.measurement[b.members[0]] or ()]
    return tuple(kind(name) for kind, name in found)


def _front(u: Any, extra: int) -> Any:
    return u[: u.shape[0] - extra]


@lru_cache(maxsize=256)
def fronted(function: Callable[..., Any], before: int, extra: int) -> Callable[..., Any]:
    """A function of `before` arguments and u that sees of u what is in front of the last `extra` inputs."""
    if not extra:
        return function
    if before == 1:
        return lambda x, u: function(x, _front(u, extra))
    return lambda x, dt, u: function(x, dt, _front(u, extra))


@lru_cache(maxsize=256)
def _stacked(functions: tuple[Callable[..., Any], ...], driven: tuple[bool, ...], extra: int) -> Callable[..., Any]:
    def all_of(x: jax.Array, *u: jax.Array) -> jax.Array:
        given = [_front(v, extra) for v in u]
        return jnp.concatenate([jnp.asarray(h(x, *given[:d])) for h, d in zip(functions, driven, strict=True)])

    return sensor_of(all_of, any(driven))


def noise_of_motion(Q: Any, extra: int) -> Any:
    """Q as it was, of inputs that have `extra` more behind them."""
    return fronted(Q, 2, extra) if callable(Q) and takes(Q, "Q", OF_MOTION) == 3 else Q


def noise_of_sensor(R: Any, extra: int) -> Any:
    """R as it was, of inputs that have `extra` more behind them."""
    return fronted(R, 1, extra) if callable(R) and takes(R, "R", OF_SENSOR) == 2 else R


def _noise(model: Model, blocks: tuple[Block, ...], extra: int) -> Any:
    """R of all blocks: numbers where all are numbers, else a function that reads what is given from behind u."""
    own = [model.R[b.members[0]] for b in blocks]
    if not extra and not any(map(callable, own)):
        if all(isinstance(R, Diagonal) for R in own):
            return Diagonal(np.concatenate([R.entries for R in own]))
        return np.asarray(jax.scipy.linalg.block_diag(*map(dense_noise, own)))
    sizes = tuple(len(b.angular) for b in blocks)
    numbers = tuple(None if b.given or callable(R) else by_value(R) for b, R in zip(blocks, own, strict=True))
    functions = tuple(R if callable(R) and not b.given else None for b, R in zip(blocks, own, strict=True))
    return _noise_function(sizes, numbers, functions, extra)


@lru_cache(maxsize=256)
def _noise_function(
    sizes: tuple[int, ...], numbers: tuple[Any, ...], functions: tuple[Any, ...], extra: int
) -> Callable[..., Any]:
    def R(x: jax.Array, u: jax.Array) -> jax.Array:
        parts, place = [], u.shape[0] - extra
        for m, known, function in zip(sizes, numbers, functions, strict=True):
            if known is not None:
                parts.append(jnp.asarray(known))
            elif function is not None:
                value = jnp.asarray(function(*(x, _front(u, extra))[: takes(function, "R", OF_SENSOR)]))
                parts.append(jnp.diag(value) if value.ndim == 1 else value)
            else:
                parts.append(u[place : place + m * m].reshape(m, m))
                place += m * m
        return jax.scipy.linalg.block_diag(*parts)

    if extra or any(f is not None and takes(f, "R", OF_SENSOR) == 2 for f in functions):
        return R
    return lambda x: R(x, jnp.zeros(0))
