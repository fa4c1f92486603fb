"""Recorded inputs and outputs: what an exported filter is tested against."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.filters import Filter
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.models.noise import takes
from sigmax.running import run

STEPS = 60


class Vectors(NamedTuple):
    """A simulated record and what the filter made of it.

    Attributes:
        dt: (T,).
        u: (T, k), or None.
        z: by sensor (T, m), NaN where missing; of fused ones all in one.
        mean: (T, n).
        factor: (T, n, n).
        nis: (T,), NaN without measurement.
        fault: (T,).
    """

    dt: np.ndarray
    u: np.ndarray | None
    z: dict[str, np.ndarray]
    mean: np.ndarray
    factor: np.ndarray
    nis: np.ndarray
    fault: np.ndarray


def recorded(
    filter: Filter, model: Model, prior: Gaussian, dt: float, inputs: np.ndarray | None, dtype: Any
) -> Vectors:
    """A record simulated from the prior's mean with gaps, parts missing and one long step, filtered."""
    rng = np.random.default_rng(1)
    together = model.fusion is not None
    elapsed = np.full(STEPS, float(dt))
    elapsed[20] *= 2
    u = None if inputs is None else np.repeat(np.asarray(inputs, float)[None], STEPS, 0)
    given = () if u is None else (u[0],)
    x = np.asarray(prior.mean, float)
    seen: dict[str, list[np.ndarray]] = {s: [] for s in model.sensors}
    move = jax.jit(lambda x, dt: model.motion(x, dt, *given[: model.motion_inputs]))
    see = {s: jax.jit(partial(_seen, h, given[: model.sensor_inputs[s]])) for s, h in model.sensors.items()}
    for k in range(STEPS):
        x = np.asarray(move(x, elapsed[k]))
        for number, (s, h) in enumerate(see.items()):
            z = np.array(h(x)) + _deviation(model.R[s], x, given) * rng.standard_normal(np.shape(h(x)))
            silent = (k + number) % 3 == 2 if together else (k + number) % len(see)
            if k % 9 == 5 or silent:
                z[:] = np.nan
            elif (k + number * together) % 7 == 3:
                z[k % len(z)] = np.nan
            seen[s].append(z)
    z = {s: np.array(rows) for s, rows in seen.items()}
    result = run(filter, model, prior, z if model.several else z[""], dt=elapsed, inputs=u, dtype=dtype)
    mean, factor, fault = result.kept()
    if together:
        z = {"": np.concatenate(list(z.values()), axis=1)}
    return Vectors(elapsed, u, z, mean, factor, result.nis, fault)


def _seen(sensor: Callable[..., Any], given: tuple[Any, ...], x: Any) -> Any:
    return sensor(x, *given)


def _deviation(R: Any, x: np.ndarray, given: tuple[Any, ...]) -> np.ndarray:
    if callable(R):
        R = R(*(x, *given)[: takes(R, "R", (1, 2))])
    variance = np.asarray(getattr(R, "entries", R))
    return np.sqrt(np.diagonal(variance) if variance.ndim == 2 else variance)
