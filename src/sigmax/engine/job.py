"""Jobs of the native engine: a record of T steps over B beliefs, or a function of B rows, as its C driver has them."""

import ctypes
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sigmax.engine.lowered import Lowered
from sigmax.engine.packing import Packing
from sigmax.functions.current import found_once
from sigmax.modelling.model import Model
from sigmax.native.driver import (
    EMPTY,
    RecordJob,
    RowsJob,
    SensorJob,
    Settled,
    SmoothingJob,
    Step,
    over_cores,
    pointer,
    series,
)
from sigmax.steps.step import Innovation


class BoundStep(NamedTuple):
    """A compiled part of a filter, bound to the numbers of a model."""

    step: Step
    constants: np.ndarray


Parts = Mapping[tuple[Any, ...], BoundStep]


class Outputs(NamedTuple):
    """Arrays that a record is written to, by track and step; None for what nobody asked for.

    Attributes:
        mean: (B, T, n).
        factor: (B, T, d, d).
        nis: (B, T).
        log_likelihood: (B, T).
        fault: (B, T).
        dof: (B, T).
        total: (B,), the log-likelihood of all steps.
        rest: (B, T, k), what stands behind mean and factor in a row.
        innovation: by sensor: residual (B, T, m) and factor (B, T, m, m).
    """

    mean: np.ndarray | None = None
    factor: np.ndarray | None = None
    nis: np.ndarray | None = None
    log_likelihood: np.ndarray | None = None
    fault: np.ndarray | None = None
    dof: np.ndarray | None = None
    total: np.ndarray | None = None
    rest: np.ndarray | None = None
    innovation: Mapping[str, Innovation] = {}


def bind(low: Lowered, model: Model, *parts: tuple[Any, ...]) -> dict[tuple[Any, ...], BoundStep]:
    """Compiled parts, see `Lowered.need`, with the numbers of a model.

    Raises:
        Refused: for what cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    return _bound(model, low, parts)


@found_once
def _bound(model: Model, low: Lowered, parts: tuple[tuple[Any, ...], ...]) -> dict[tuple[Any, ...], BoundStep]:
    numbers = low.parameters(model)
    return {part: BoundStep(step, step.setup(numbers)) for part, step in zip(parts, low.need(*parts), strict=True)}


def without_numbers(step: Step) -> BoundStep:
    """A compiled function that reads no numbers of a model."""
    return BoundStep(step, step.setup(np.zeros(1)))


def record(
    packing: Packing,
    parts: Parts,
    model: Model,
    state: np.ndarray,
    z: Mapping[str, np.ndarray],
    dt: np.ndarray | None,
    u: np.ndarray | None,
    out: Outputs,
    moving_from: int = 0,
    settled: Settled | None = None,
) -> RecordJob:
    """A record to be filtered: the job that `run`, a live step (T = 1) and steps of rows (T = 1) are.

    Args:
        packing: of the rows.
        parts: compiled, from `bind`; they must live as long as the job.
        model: tells what sensors measure.
        state: rows (B, size), moved on in place.
        z: measurements by sensor (T, m) or (B, T, m), corrected in their order.
        dt: (T,) or (B, T); None where no time passes.
        u: (T, k) or (B, T, k), or None.
        out: where the results go.
        moving_from: the first step that is predicted.
        settled: its steps once the covariance has settled.
    """
    sensors = [_sensor(parts, model, s, v, out.innovation.get(s)) for s, v in z.items()]
    predict = None if dt is None else parts[("predict",)]
    some = next(iter(z.values()), None)
    steps = dt.shape[-1] if dt is not None else 1 if some is None else some.shape[-2]
    # In the order of the fields, which costs half as much as by name.
    return RecordJob(
        len(state),
        steps,
        packing.points,
        packing.n,
        packing.size,
        None if predict is None else predict.step.address,
        None if predict is None else pointer(predict.constants),
        EMPTY if dt is None else series(dt, 0, dt.ndim == 2, True),
        EMPTY if u is None else series(u, 1, u.ndim == 3, True),
        len(sensors),
        (SensorJob * max(len(sensors), 1))(*sensors),
        pointer(state),
        *map(pointer, (out.total, out.mean, out.factor, out.nis, out.log_likelihood, out.fault, out.dof, out.rest)),
        moving_from,
        max((part.step.workspace for part in parts.values()), default=0),
        None if settled is None else ctypes.pointer(settled),
    )


def _sensor(parts: Parts, model: Model, name: str, z: np.ndarray, told: Innovation | None) -> SensorJob:
    part = parts["correct", name, z.shape[-1]]
    return SensorJob(
        part.step.address,
        pointer(part.constants),
        series(z, 1, z.ndim == 3, True),
        model.measured_space(name, z.shape[-1]).dim,
        *((None, None) if told is None else (pointer(told.residual), pointer(told.factor))),
    )


def empty_innovation(tracks: int, dim: int, dtype: Any) -> Innovation:
    """Arrays for what one step says of a measurement of so many deviations, by track."""
    residual, factor = np.empty((tracks, dim), dtype), np.empty((tracks, dim, dim), dtype)
    return Innovation(residual, factor, np.empty(tracks, dtype), np.empty(tracks, dtype), np.empty(tracks, np.int64))


def one_step(sensor: str | None, told: Innovation | None, fault: np.ndarray) -> Outputs:
    """The outputs of a record of one step, by track: what it said, and the fault."""
    if sensor is None or told is None:
        return Outputs(fault=fault)
    return Outputs(None, None, told.nis, told.log_likelihood, fault, told.dof, innovation={sensor: told})


def smoothing(
    packing: Packing,
    back: BoundStep,
    filtered: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None],
    dt: np.ndarray,
    u: np.ndarray | None,
    out: tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray],
) -> SmoothingJob:
    """A record to be smoothed: means, factors, faults and the rest, the batch first where there is one.

    And where they go: means, factors, the rest, faults.
    """
    mean, factor, fault, rest = filtered
    batched = mean.ndim == 3
    return SmoothingJob(
        len(mean) if batched else 1,
        mean.shape[-2],
        packing.points,
        packing.n,
        packing.size,
        back.step.address,
        pointer(back.constants),
        series(mean, 1, batched, True),
        series(factor, 2, batched, True),
        EMPTY if rest is None else series(rest, 1, batched, True),
        series(fault, 0, batched, True),
        series(dt, 0, dt.ndim == 2, True),
        EMPTY if u is None else series(u, 1, u.ndim == 3, True),
        *map(pointer, out),
        back.step.workspace,
    )


def rows(part: BoundStep, given: np.ndarray, out: np.ndarray) -> RowsJob:
    """A function of rows `given` (B, k), or (k,) for one, whose results go to `out` (B, l) or (l,)."""
    return RowsJob(
        part.step.address,
        pointer(part.constants),
        series(given, 1, given.ndim == 2, False),
        out.shape[-1],
        pointer(out),
        part.step.workspace,
    )


def execute(low: Lowered, what: str, job: ctypes.Structure, tracks: int) -> None:
    """Call a function of the driver, "record", "backwards" or "rows", on a job, over all tracks and all cores."""
    over_cores(low.driver[what], job, tracks, low.dtype == np.float32)
