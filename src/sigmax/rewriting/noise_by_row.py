"""Noises of measurements that come with them: R of every row."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import is_traced, numbers, symmetric_semidefinite
from sigmax.modelling.model import Model, check_added
from sigmax.modelling.switching import SwitchingModel
from sigmax.rewriting.stack import fronted, noise_of_motion, noise_of_sensor


class NoiseByRow(NamedTuple):
    """The noise of a sensor in each row.

    Attributes:
        values: variances (…, T, d), or covariances row by row (…, T, d²).
        dim: d.
        full: whether they are covariances.
    """

    values: Any
    dim: int
    full: bool


def noises_by_row(model: Model, z: Mapping[str, Any], R: Any) -> dict[str, NoiseByRow]:
    """The noise of each row by sensor; 1 where nothing was measured.

    Args:
        model: the model as the user has it.
        z: measurements by sensor, (T, m) or (B, T, m), checked.
        R: variances (T, d), (B, T, d) or covariances (T, d, d), (B, T, d, d); a dict by sensor where there are several.

    Raises:
        InputError: for another shape, what is no covariance where something was measured, and fused sensors.
    """
    check_added(model, "R by row")
    if model.fusion is not None:
        raise InputError("the sensors are fused, each with the R of the model: R by row needs them apart")
    if model.several != isinstance(R, Mapping):
        wanted = f"a dict by sensor name, {sorted(model.sensors)}" if model.several else "an array (T, m) or (T, m, m)"
        raise InputError(f"R of every row must be {wanted}; it is {type(R).__name__}")
    given: Mapping[str, Any] = R if isinstance(R, Mapping) else {"": R}
    for sensor in given:
        if sensor not in z:
            raise unknown("sensor with measurements", sensor, z)
    return {s: _checked(f"R[{s!r}]" if s else "R", model, s, z[s], value) for s, value in given.items()}


def _checked(label: str, model: Model, sensor: str, z: Any, given: Any) -> NoiseByRow:
    value = numbers(label, given, missing=True)
    space = model.measured_space(sensor, z.shape[-1])
    T, d = z.shape[-2], space.dim
    batch = z.shape[:-2] or value.shape[: value.ndim > 2]
    shapes = {False: {(T, d), (*batch, T, d)}, True: {(T, d, d), (*batch, T, d, d)}}
    fitting = [full for full, some in shapes.items() if value.shape in some]
    if len(fitting) != 1:
        wanted = f"{(T, d)} for variances or {(T, d, d)} for covariances, with a batch in front where there is one"
        hint = "; one R for all rows belongs to the model" if value.ndim < 2 else ""
        hint = f"; both fit: write the batch of {batch[0]} out" if fitting else hint
        raise InputError(f"{label} must have the shape {wanted}; it has {value.shape}{hint}")
    (full,) = fitting
    array: Any = jnp if is_traced((value, z)) else np
    seen = array.moveaxis(array.asarray(space.whole(~array.isnan(array.moveaxis(z, -1, 0)))), 0, -1)
    value = array.where(seen[..., :, None] & seen[..., None, :] if full else seen, value, array.eye(d) if full else 1.0)
    if not is_traced(value):
        _check(label, value, full)
    return NoiseByRow(value.reshape(*value.shape[:-2], d * d) if full else value, d, full)


def _check(label: str, value: np.ndarray, full: bool) -> None:
    """Refuse what is no covariance, naming the place."""
    wrong = ~np.isfinite(value) if full else ~(np.isfinite(value) & (value >= 0))
    if wrong.any():
        place = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise InputError(
            f"{label} must be finite, and variances at least 0, wherever something was measured; it has "
            f"{value[place]} at {list(place)}"
        )
    if full:
        symmetric_semidefinite(label, value)


def with_noise_by_row(model: Model, R: Mapping[str, NoiseByRow], u: Any) -> tuple[Model, Any]:
    """The same model with noises that it reads from its inputs, and these: u, and behind it R of every row."""
    array: Any = jnp if is_traced(([r.values for r in R.values()], u)) else np
    arrays = [*([] if u is None else [u]), *(r.values for r in R.values())]
    lead = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    inputs = array.concatenate([array.broadcast_to(a, (*lead, a.shape[-1])) for a in arrays], -1)
    return _reading(model, R, sum(r.values.shape[-1] for r in R.values())), inputs


def _reading(model: Model, R: Mapping[str, NoiseByRow], extra: int) -> Model:
    if isinstance(model, SwitchingModel):
        return model.with_models([_reading(m, R, extra) for m in model.models])
    noises, behind = {}, extra
    for sensor, given in R.items():
        noises[sensor] = _behind(behind, given.dim, given.full)
        behind -= given.values.shape[-1]
    own = {s: noise_of_sensor(noise, extra) for s, noise in model.R.items()}
    return model.with_parts(
        motion=fronted(model.motion, 2, extra) if model.motion_inputs else model.motion,
        sensors={s: fronted(h, 1, extra) if model.sensor_inputs[s] else h for s, h in model.sensors.items()},
        Q=noise_of_motion(model.Q, extra),
        R=own | noises,
    )


@lru_cache(maxsize=256)
def _behind(end: int, dim: int, full: bool) -> Callable[..., Any]:
    """A noise that begins so many inputs before the end of u: the same function for the same place."""

    def R(x: jax.Array, u: jax.Array) -> jax.Array:
        start = u.shape[0] - end
        return u[start : start + dim * dim].reshape(dim, dim) if full else u[start : start + dim]

    return R
