"""Noises of motion and measurement that are correlated, rewritten as ones that are not."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import inner, times
from sigmax.algebra.factor import cholesky, pivoted, solve_lower
from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import numbers
from sigmax.modelling.model import Model, check_added, check_flat
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of, by_value
from sigmax.modelling.switching import check_one_mode
from sigmax.rewriting.stack import fronted, noise_of_sensor
from sigmax.spaces import Space


class _Sensor(NamedTuple):
    """A sensor that was heard before the motion: function, noise, space, S, and whether the first two take inputs."""

    function: Callable[..., Any]
    R: Any
    space: Space
    S: tuple[tuple[float, ...], ...]
    driven: bool


def correlated(model: Model, S: Any) -> Model:
    """The model whose noise over an interval is correlated with that of the measurement at its beginning.

    S = Cov(w_k, v_k) of x_{k+1} = f(x_k) + w_k and z_k = h(x_k) + v_k: what w_k has in common with v_k is predicted
    by S R⁻¹ (z_k − h(x_k)), and what is left of Q is Q − S R⁻¹ Sᵀ (Anderson and Moore 1979, 5.4). So its motion takes
    z_k as inputs, behind those that it has: see `after` and `shifted`. Exact where f and h are linear.

    Args:
        model: with its bias written into its state, if it has one.
        S: (d, m) of the whole interval; a dict by sensor where there are several, of those that are correlated.

    Raises:
        InputError: for another shape or sensor; for modes, fused sensors and curved spaces.
    """
    heard = []
    for s, value in correlations_of("correlated", model, S).items():
        names = model.measured_deviations(s)
        if names is None:
            raise InputError(f"name the components of the measurement of {s or 'the sensor'}: R is a function")
        R = model.R[s] if callable(model.R[s]) else by_value(model.R[s])
        space = model.measured_space(s, len(names))
        matrix = by_value(correlation(model, s, value, len(names)))
        heard.append(_Sensor(model.sensors[s], R, space, matrix, model.sensor_inputs[s]))
    extra = 2 * sum(len(one.S[0]) for one in heard)
    sensors = tuple(heard)
    Q = model.Q if callable(model.Q) else by_value(model.Q)
    return model.with_parts(
        motion=_moved(model.motion, model.motion_inputs, sensors, extra),
        motion_inputs=True,
        inputs=None,
        sensors={s: fronted(h, 1, extra) if model.sensor_inputs[s] else h for s, h in model.sensors.items()},
        Q=_left(Q, sensors, extra),
        R={s: noise_of_sensor(R, extra) for s, R in model.R.items()},
    )


def correlations_of(what: str, model: Model, S: Any) -> Mapping[str, Any]:
    """S by the name of the sensor, as it was given, of a model that `what` can rewrite.

    Raises:
        InputError: for a model that it cannot, and for what is not by sensor or names one that is not there.
    """
    check_one_mode(model, what)
    check_flat(model, what)
    check_added(model, what)
    if model.bias is not None or model.fusion is not None:
        raise InputError(f"{what} wants a model without bias and fusion: write it with sigmax.models.augment first")
    if model.several != isinstance(S, Mapping):
        wanted = f"a dict by sensor name, {sorted(model.sensors)}" if model.several else "a matrix (d, m)"
        raise InputError(f"S must be {wanted}; it is {type(S).__name__}")
    given: Mapping[str, Any] = S if isinstance(S, Mapping) else {"": S}
    for s in given:
        if s not in model.sensors:
            raise unknown("sensor", s, model.sensors)
    return given


def correlation(model: Model, sensor: str, value: Any, size: int) -> Any:
    """The covariance (d, m) of the motion's noise with that of a sensor of so many components.

    Raises:
        InputError: for another shape.
    """
    matrix = numbers(f"S[{sensor!r}]" if sensor else "S", value)
    if matrix.shape != (model.dim, size):
        raise InputError(f"S must have the shape {(model.dim, size)}, state by measurement; {matrix.shape}")
    return matrix


def covariance_over(Q: Any, x: jax.Array, dt: jax.Array, u: tuple[jax.Array, ...]) -> jax.Array:
    """The covariance of the motion's noise over an interval, of a function or of the rows of a matrix."""
    value = jnp.asarray(Q(*arguments_of(Q, "Q", OF_MOTION, x, dt, u)) if callable(Q) else Q).astype(x.dtype)
    value = value if callable(Q) else value * dt
    return jnp.diag(value) if value.ndim == 1 else value


def after(z: Any, u: Any = None) -> np.ndarray:
    """The inputs (k + 2m,) of a motion that follows a measurement z (m,), NaN where it is missing, with its own u (k,).

    Of several sensors z is a dict, in the order of S; for rows of measurements all have these in front.
    """
    parts = [np.asarray(v, float) for v in (z.values() if isinstance(z, Mapping) else [z])]
    told = [a for v in parts for a in (np.nan_to_num(v, nan=0.0), (~np.isnan(v)).astype(float))]
    own = [] if u is None else [np.asarray(u, float)]
    lead = np.broadcast_shapes(*(a.shape[:-1] for a in (*own, *told)))
    return np.concatenate([np.broadcast_to(a, (*lead, a.shape[-1])) for a in (*own, *told)], -1)


def shifted(z: Any, inputs: Any = None) -> np.ndarray:
    """The inputs (T, k + 2m) of a record: with each row the measurements z (T, m) of the row before it.

    Args:
        z: as `run` takes it, in the order of S where it is a dict; arrays of numbers.
        inputs: those that the model takes without, (T, k).
    """

    def before(v: Any) -> np.ndarray:
        v = np.asarray(v, float)
        return np.concatenate([np.full_like(v[..., :1, :], np.nan), v[..., :-1, :]], -2)

    return after({s: before(v) for s, v in z.items()} if isinstance(z, Mapping) else before(z), inputs)


def _common(sensors: tuple[_Sensor, ...], x: jax.Array, u: jax.Array, extra: int) -> list[tuple[jax.Array, jax.Array]]:
    """Of each sensor W = L⁻¹ Sᵀ and L⁻¹ (z − h(x)), L Lᵀ = R: what was not measured has no part in it."""
    own, at, found = (u[: u.shape[0] - extra],), u.shape[0] - extra, []
    for one in sensors:
        m = len(one.S[0])
        z, seen = u[at : at + m], u[at + m : at + 2 * m] > 0
        at += 2 * m
        R = one.R(*arguments_of(one.R, "R", OF_SENSOR, x, None, own)) if callable(one.R) else one.R
        R = jnp.asarray(R, x.dtype)
        R = jnp.diag(R) if R.ndim == 1 else R
        L = pivoted(cholesky(jnp.where(seen[:, None] & seen[None], R, jnp.eye(m, dtype=x.dtype)))[0])
        expected = jnp.asarray(one.function(x, *own[: one.driven]))
        off = one.space.difference(jnp.where(seen, z, expected), expected)
        S = jnp.where(seen[:, None], jnp.asarray(one.S, x.dtype).T, 0)
        found.append((solve_lower(L, S), solve_lower(L, off)))
    return found


@lru_cache(maxsize=256)
def _moved(f: Callable[..., Any], driven: bool, sensors: tuple[_Sensor, ...], extra: int) -> Callable[..., Any]:
    def motion(x: jax.Array, dt: jax.Array, u: jax.Array) -> jax.Array:
        moved = jnp.asarray(f(x, dt, *(u[: u.shape[0] - extra],)[:driven]))
        for W, off in _common(sensors, x, u, extra):
            moved = moved + times(W.T, off)
        return moved

    return motion


@lru_cache(maxsize=256)
def _left(Q: Any, sensors: tuple[_Sensor, ...], extra: int) -> Callable[..., Any]:
    def noise(x: jax.Array, dt: jax.Array, u: jax.Array) -> jax.Array:
        value = covariance_over(Q, x, dt, (u[: u.shape[0] - extra],))
        for W, _ in _common(sensors, x, u, extra):
            value = value - inner(W, W)
        return value

    return noise
