"""Whether what was traced from a model's functions is what they give, near the state where a run starts."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any
from weakref import WeakSet

import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.tracing import Traceable, check_alike

# Of the functions that stand for the user's as they are now: see `current`.
_compared: WeakSet[Any] = WeakSet()


def check_calls(
    model: Model, prior: Gaussian, dt: np.ndarray, u: tuple[np.ndarray, ...], sizes: Mapping[str, int]
) -> None:
    """Compare motion and sensors with themselves as they are called, once for each.

    Args:
        model: with its functions as they are now.
        prior: of which the first counts.
        dt: seconds, one number.
        u: inputs (k,), alone in a tuple, which is empty where there are none.
        sizes: by sensor; others are left out.

    Raises:
        InputError: where a function gives something else when it is called, or something else every time.
    """
    for what, function, rest in _functions(model, dt, u, sizes):
        if not is_compared(function) or function in _compared:
            continue
        _compared.add(function)
        points = [[x, *rest] for x in _states(prior, dt.dtype)]
        try:
            check_alike(function, points)
        except InputError as error:
            raise InputError(f"{what}: {error}") from error


def is_compared(function: Callable[..., Any]) -> bool:
    """Whether a function is traced in another way than it is called, so that the two are compared."""
    own = getattr(function, "__wrapped__", function)
    return isinstance(own, Traceable) and not own.with_jax


def _functions(
    model: Model, dt: np.ndarray, u: tuple[np.ndarray, ...], sizes: Mapping[str, int]
) -> Iterator[tuple[str, Callable[..., Any], tuple[np.ndarray, ...]]]:
    if u or not model.motion_inputs:
        yield "motion", model.motion, (dt, *u)[: 1 + model.motion_inputs]
    for s in sizes:
        if u or not model.sensor_inputs[s]:
            yield f"sensor {s!r}" if s else "sensor", model.sensors[s], u[: int(model.sensor_inputs[s])]


def _states(prior: Gaussian, dtype: np.dtype[Any]) -> Iterator[np.ndarray]:
    """The mean, and states a deviation away from it."""
    mean = np.asarray(prior.mean if prior.mean.ndim == 1 else prior.mean[0], dtype)
    cov = prior.cov if prior.cov.ndim == 2 else prior.cov[0]
    yield mean
    spread = np.sqrt(np.diagonal(cov)) if len(cov) == len(mean) else 0.1 * np.abs(mean)
    for signs in np.random.default_rng(5).normal(size=(2, len(mean))):
        yield (mean + signs * spread).astype(dtype)
