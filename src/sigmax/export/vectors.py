"""Rows of measurements and what a filter makes of them: what an exported filter is tested against."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import takes
from sigmax.running import run

STEPS, _MOST = 60, 200
# A filter in C differs by the rounding of another order of operations. How far it is carried is seen by disturbing the
# input by some units of rounding, several times; the limit is so many times that, and never below the first number.
_DRAWS, _UNITS, _MARGIN = 6, 4, 100.0
_LEAST = {"float64": 1e-9, "float32": 2e-2}
# Rows that carry it farther are left out, as long as so many remain.
_WORTH = {"float64": 1e-6, "float32": 2e-1}
_FEWEST = 20


class Rows(NamedTuple):
    """What a filter is given step by step.

    Attributes:
        dt: seconds (T,).
        u: inputs (T, k), or None.
        z: by sensor (T, m), NaN where missing.
    """

    dt: np.ndarray
    u: np.ndarray | None
    z: dict[str, np.ndarray]

    def first(self, count: int) -> "Rows":
        """The first rows alone."""
        return Rows(
            self.dt[:count], None if self.u is None else self.u[:count], {s: z[:count] for s, z in self.z.items()}
        )


class Vectors(NamedTuple):
    """Rows and what the filter made of them.

    Attributes:
        rows: the rows; of fused sensors what they measured is all in one.
        mean: (T, n).
        factor: (T, n, n).
        nis: (T,), NaN without measurement.
        tolerance: by how much another order of operations may differ, in standard deviations.
    """

    rows: Rows
    mean: np.ndarray
    factor: np.ndarray
    nis: np.ndarray
    tolerance: float


def filtered(filter: Filter, model: Model, prior: Gaussian, rows: Rows, dtype: Any) -> Vectors:
    """The rows filtered, up to the first at which the filter fails or rounding alone decides.

    Raises:
        InputError: where the filter fails at the first row.
    """
    name = str(np.dtype(dtype))
    rows = rows.first(_MOST)
    told = _run(filter, model, prior, rows, dtype)
    rng = np.random.default_rng(2)
    apart, sound = np.zeros(len(rows.dt)), told.sound
    for _ in range(_DRAWS):
        near = _run(filter, model, *_disturbed(prior, rows, rng, _UNITS * float(np.finfo(dtype).eps)), dtype)
        apart, sound = np.fmax(apart, _difference(near, told)), sound & near.sound
    whole = len(sound) if sound.all() else int(np.argmin(sound))
    if not whole:
        raise InputError(f"{filter.name} fails at the first of the rows that the test is made of")
    limit = np.fmax(_LEAST[name], _MARGIN * np.fmax.accumulate(apart[:whole]))
    count = max(int((limit <= _WORTH[name]).sum()), min(_FEWEST, whole))
    rows = rows.first(count)
    if model.fusion is not None:
        rows = rows._replace(z={"": np.concatenate(list(rows.z.values()), axis=1)})
    return Vectors(rows, told.mean[:count], told.factor[:count], told.nis[:count], float(limit[count - 1]))


class _Told(NamedTuple):
    mean: np.ndarray
    factor: np.ndarray
    nis: np.ndarray
    sound: np.ndarray


def _run(filter: Filter, model: Model, prior: Gaussian, rows: Rows, dtype: Any) -> _Told:
    z = rows.z if model.several else rows.z[""]
    result = run(filter, model, prior, z, dt=rows.dt, inputs=rows.u, dtype=dtype)
    mean, factor, fault, _ = result.kept()
    return _Told(mean, factor, result.nis, ~(fault > 0))


def _disturbed(prior: Gaussian, rows: Rows, rng: np.random.Generator, size: float) -> tuple[Gaussian, Rows]:
    """All that is given, changed by a relative `size`."""

    def near(value: np.ndarray) -> np.ndarray:
        return value * (1 + size * rng.standard_normal(np.shape(value)))

    mean, cov = np.asarray(prior.mean, float), np.asarray(prior.cov, float)
    variances = np.diag(cov) if cov.ndim == 2 else cov
    scale = 1 + size * rng.standard_normal(len(variances))
    moved = np.sqrt(variances) if len(variances) == len(mean) else np.ones(len(mean))
    start = Gaussian(
        near(mean) + size * moved * rng.standard_normal(len(mean)),
        cov * np.outer(scale, scale) if cov.ndim == 2 else cov * scale**2,
    )
    return start, Rows(near(rows.dt), None if rows.u is None else near(rows.u), {s: near(z) for s, z in rows.z.items()})


def _difference(near: _Told, told: _Told) -> np.ndarray:
    """What the test program calls the largest difference, at each step (T,)."""
    size = np.linalg.norm(told.factor, axis=2)
    # The numbers of curved parts have no standard deviation of their own.
    scale = size if near.mean.shape == size.shape else 1.0
    mean = np.abs(near.mean - told.mean) / (np.abs(told.mean) + scale)
    factor = np.abs(near.factor - told.factor) / (np.abs(told.factor) + size[:, :, None])
    nis = np.abs(near.nis - told.nis) / (1 + np.abs(told.nis))
    return np.fmax(np.fmax(np.nanmax(mean, axis=1), np.nanmax(factor, axis=(1, 2))), np.nan_to_num(nis))


def simulated(model: Model, prior: Gaussian, dt: float, inputs: np.ndarray | None) -> Rows:
    """Rows simulated from the prior's mean with gaps, parts missing and one long step."""
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
            there, deviation = np.asarray(h(x), float), _deviation(model.R[s], x, given)
            noise = deviation * rng.standard_normal(len(deviation))
            z = np.array(model.measured_space(s, len(there)).add(there, noise))
            silent = (k + number) % 3 == 2 if together else (k + number) % len(see)
            if k % 9 == 5 or silent:
                z[:] = np.nan
            elif (k + number * together) % 7 == 3:
                z[k % len(z)] = np.nan
            seen[s].append(z)
    return Rows(elapsed, u, {s: np.array(rows) for s, rows in seen.items()})


def _seen(sensor: Callable[..., Any], given: tuple[Any, ...], x: Any) -> Any:
    return sensor(x, *given)


def _deviation(R: Any, x: np.ndarray, given: tuple[Any, ...]) -> np.ndarray:
    if callable(R):
        R = R(*(x, *given)[: takes(R, "R", (1, 2))])
    variance = np.asarray(getattr(R, "entries", R))
    return np.sqrt(np.diagonal(variance) if variance.ndim == 2 else variance)
