"""Whether a model is linear, as the Kalman filter needs it: found once for each of its functions."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.functions.current import found_once
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, takes

# Three states of different size for each interval and input.
_SCALES = (1.0, 1e3, 1e7)
_INTERVALS = (0.0173, 0.93, 7.1, 61.0)


@found_once
def check_linear(
    model: Model,
    inputs: int | None,
    said: str = "KF is for linear models",
    instead: str = "EKF or a sigma-point filter",
) -> None:
    """Refuse a model whose derivative in the state is not the same everywhere, its domain and bias included.

    What counts is the functions, at intervals and inputs of any kind, not the record at hand.

    Args:
        model: the model as the user has it.
        inputs: how many it is given; None for none.
        said: who asks, in words.
        instead: what takes any model.

    Raises:
        InputError: naming the function that is not linear.
    """
    n, k = model.size, inputs or 0
    parts = [("motion", model.motion, (3 if model.motion_inputs else 2), True)]
    parts += [("domain", model.domain, 1, False)] if model.domain is not None else []
    parts += [
        (f"sensor {s!r}" if s else "sensor", h, 1 + model.sensor_inputs[s], False) for s, h in model.sensors.items()
    ]
    for what, g, count, moving in parts:
        if not _linear(g, count, moving, n, k):
            raise InputError(f"{said}, and {what} is not linear; take {instead}")
    for what, C, allowed in _matrices(model):
        count = takes(C, what, allowed)
        if (allowed == OF_SENSOR or count > 1) and in_state(C, count, allowed == OF_MOTION, n, k):
            raise InputError(f"{said}, and {what} of the bias depends on the state; take {instead}")


def _matrices(model: Model) -> list[tuple[str, Callable[..., Any], tuple[int, ...]]]:
    if model.bias is None:
        return []
    found: list[tuple[str, Any, tuple[int, ...]]] = [("B", model.bias.motion, OF_MOTION)]
    found += [(f"F of the sensor {s!r}" if s else "F", F, OF_SENSOR) for s, F in model.bias.sensor.items()]
    return [one for one in found if callable(one[1])]


@lru_cache(maxsize=512)
def _linear(function: Callable[..., Any], count: int, moving: bool, n: int, k: int) -> bool:
    slopes = _slopes(function, count, moving, n, k)
    return _same(slopes, slopes[:, :1])


@lru_cache(maxsize=512)
def in_state(function: Callable[..., Any], count: int, moving: bool, n: int, k: int) -> bool:
    """Whether a function of the state, an interval where it is `moving`, and inputs depends on the state."""
    slopes = _slopes(function, count, moving, n, k)
    return not _same(slopes, np.zeros_like(slopes))


def _same(slopes: np.ndarray, wanted: np.ndarray) -> bool:
    """Whether all are alike; what is not finite, beyond where a function makes sense, says nothing."""
    known = np.isfinite(slopes) & np.isfinite(wanted)
    size = np.abs(np.where(known, slopes, 0)).max(initial=1.0)
    return bool(
        (np.abs(np.where(known, slopes - wanted, 0)) <= 1e-9 * np.abs(np.where(known, wanted, 0)) + 1e-12 * size).all()
    )


def _slopes(function: Callable[..., Any], count: int, moving: bool, n: int, k: int) -> np.ndarray:
    """Derivatives in the state (intervals and inputs, states, components, n)."""
    rng = np.random.default_rng(0)
    cases = [(dt, u) for dt in _INTERVALS for u in (rng.uniform(0.5, 1.5, k), 10 * rng.standard_normal(k))]
    x = np.array([[scale * rng.standard_normal(n) for scale in _SCALES] for _ in cases])
    dt, u = np.array([dt for dt, _ in cases]), np.array([u for _, u in cases]).reshape(len(cases), k)

    def slope(x: Any, dt: Any, u: Any) -> Any:
        rest = ((dt, u) if moving else (u,))[: count - 1]
        return jax.jacfwd(lambda at: jnp.ravel(jnp.asarray(function(at, *rest))))(x)

    over_states = jax.vmap(slope, in_axes=(0, None, None))
    # Numbers are known here even while something else is being traced. Compiled as a whole: operation by operation it
    # takes twenty times as long.
    with jax.ensure_compile_time_eval():
        return np.asarray(jax.jit(jax.vmap(over_states))(x, dt, u))
