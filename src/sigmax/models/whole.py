"""A model with its bias as the last components of its state: what truth is drawn from."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.models.bias import joint
from sigmax.models.components import components
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.models.noise import OF_MOTION, OF_SENSOR, by_value, takes


def whole(model: Model) -> Model:
    """The same without a bias: its components stand behind those of the state, in motion, sensors and noise.

    Filters take the model with its bias; this is for all that knows states alone.
    """
    bias = model.bias
    if bias is None:
        return model
    n = model.size
    sensors = {s: _sensor(h, model.sensor_inputs[s], n, by_value(bias.sensor.get(s))) for s, h in model.sensors.items()}
    made = object.__new__(Model)
    made.__dict__.update(
        model.__dict__,
        motion=_motion(model.motion, model.motion_inputs, n, by_value(bias.motion)),
        motion_inputs=model.motion_driven,
        sensors=sensors,
        sensor_inputs={s: model.sensor_driven(s) for s in model.sensors},
        components=components("state", (*model.state, *bias.names), None, "Q"),
        Q=_noise(model.Q, bias.Q, n),
        R={s: _of_state(R, n) if callable(R) else R for s, R in model.R.items()},
        domain=None if model.domain is None else _domain(model.domain, n),
        bias=None,
        fusion=None,
    )
    return made


def with_bias(model: Model, prior: Gaussian) -> tuple[Model, Gaussian]:
    """The `whole` model, and the prior of state and bias together; both as they are where there is no bias."""
    return (model, prior) if model.bias is None else (whole(model), joint(prior, model.bias.starting(), False))


def _added(C: Any, b: jax.Array) -> Any:
    return 0.0 if C is None else jnp.asarray(C) @ b


@lru_cache(maxsize=64)
def _motion(f: Any, driven: bool, n: int, B: Any) -> Any:
    def moved(X: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        x, b = X[:n], X[n:]
        count = takes(B, "B", OF_MOTION) if callable(B) else 0
        C = B if not count else B(dt) if count == 1 else B(*(x, dt, *u)[:count])
        return jnp.concatenate([jnp.asarray(f(x, dt, *u[:driven])) + _added(C, b), b])

    if driven or (callable(B) and takes(B, "B", OF_MOTION) == 3):
        return lambda X, dt, u: moved(X, dt, u)
    return lambda X, dt: moved(X, dt)


@lru_cache(maxsize=64)
def _sensor(h: Any, driven: bool, n: int, F: Any) -> Any:
    def seen(X: jax.Array, *u: jax.Array) -> jax.Array:
        x, b = X[:n], X[n:]
        C = F(*(x, *u)[: takes(F, "F", OF_SENSOR)]) if callable(F) else F
        return jnp.asarray(h(x, *u[:driven])) + _added(C, b)

    if driven or (callable(F) and takes(F, "F", OF_SENSOR) == 2):
        return lambda X, u: seen(X, u)
    return lambda X: seen(X)


@lru_cache(maxsize=64)
def _domain(domain: Any, n: int) -> Any:
    return lambda X: jnp.concatenate([domain(X[:n]), X[n:]])


@lru_cache(maxsize=64)
def _of_state(R: Any, n: int) -> Any:
    if takes(R, "R", OF_SENSOR) == 2:
        return lambda X, u: R(X[:n], u)
    return lambda X: R(X[:n])


def _noise(Q: Any, Qb: Any, n: int) -> Any:
    """The noise of both: numbers, or a function of the interval alone where it can be one."""
    if isinstance(Q, Diagonal) and isinstance(Qb, Diagonal):
        return Diagonal(np.concatenate([Q.entries, Qb.entries]))
    return _noise_function((by_value(Q), by_value(Qb)), n)


@lru_cache(maxsize=64)
def _noise_function(parts: tuple[Any, Any], n: int) -> Any:
    def one(part: Any, given: tuple[Any, ...]) -> Any:
        x, dt, *u = given
        if not callable(part):
            return jnp.asarray(part) * dt
        count = takes(part, "Q", OF_MOTION)
        value = jnp.asarray(part(dt) if count == 1 else part(*(x, dt, *u)[:count]))
        return jnp.diag(value) if value.ndim == 1 else value

    def Q(X: Any, dt: Any, *u: Any) -> Any:
        return jax.scipy.linalg.block_diag(*(one(part, (X if X is None else X[:n], dt, *u)) for part in parts))

    most = max(takes(part, "Q", OF_MOTION) if callable(part) else 1 for part in parts)
    if most == 1:
        return lambda dt: Q(None, dt)
    return (lambda X, dt: Q(X, dt)) if most == 2 else (lambda X, dt, u: Q(X, dt, u))
