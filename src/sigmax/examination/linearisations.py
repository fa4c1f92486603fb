"""Whether another linearisation than the filter's explains a record better."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.examination.search import Candidate, Setup, masked
from sigmax.examination.variants import RecordData, Runner, Variant, log_likelihood
from sigmax.filters import get, once

# Of degree 3, of order 2, of degree 5, and iterated.
_OTHERS = ("CKF", "SOKF", "HCKF", "IEKF")


def other_linearisations(setup: Setup, theta: np.ndarray, record: RecordData, as_it_stands: float) -> list[Candidate]:
    """What other filters gain in log-likelihood on a record whose model bends; none has a number to fit."""
    if not bends(setup, record):
        return []
    names = [name for name in _OTHERS if name != setup.runner.filter.name]
    return [_with(setup, theta, record, name, as_it_stands) for name in names]


def with_filter(setup: Setup, name: str) -> Setup:
    """The same search by another filter."""
    old = setup.runner
    filter = get(name)
    runner = Runner(filter if name == "IEKF" else replace(filter, update=once), old.family, old.update_first)
    return replace(setup, climber=setup.climber._replace(runner=runner))


def bends(setup: Setup, record: RecordData) -> bool:
    """Whether the motion or a sensor is other than linear within two deviations of the prior."""
    model, spread = setup.runner.family.plain, np.sqrt(np.diag(record.cov))
    u = jnp.asarray(record.u[0])
    dt = jnp.asarray(float(np.median(record.dt)))
    functions: list[Callable[[jax.Array], Any]] = [
        lambda x: model.motion(x, dt, *((u,) if model.motion_inputs else ()))
    ]
    for s, h in model.sensors.items():
        functions.append(partial(_seen, h, (u,) if model.sensor_inputs[s] else ()))
    for f in functions:
        for direction in np.eye(len(spread)) * 2 * spread:
            a, b, c = (np.asarray(f(jnp.asarray(record.mean + k * direction))) for k in (-1.0, 0.0, 1.0))
            if (np.abs(a + c - 2 * b) > 1e-9 * (np.abs(a) + np.abs(b) + np.abs(c) + 1e-300)).any():
                return True
    return False


def _seen(h: Callable[..., Any], u: tuple[jax.Array, ...], x: jax.Array) -> Any:
    return h(x, *u)


def _with(setup: Setup, theta: np.ndarray, record: RecordData, name: str, as_it_stands: float) -> Candidate:
    L = float(log_likelihood(masked(with_filter(setup, name), [Variant(theta, record)])[1])[0])
    gain = L - as_it_stands if np.isfinite(as_it_stands) else 1e9 + L / 1e3
    return Candidate("linearisation", name, gain, np.zeros(0), np.nan)
