"""Records through steps compiled for this machine: many tracks side by side in the lanes of a core."""

from functools import cache
from typing import Any

import numpy as np

from sigmax.filters import Filter
from sigmax.models.model import Model
from sigmax.native.driver import EMPTY, Record, Rows, Sensor, Smoothing, driver, over_cores, pointer, series
from sigmax.running.edge import Prepared
from sigmax.running.lowered import Lowered, lowered
from sigmax.running.step import Innovation


@cache
def _lower_places(n: int) -> tuple[np.ndarray, ...]:
    return np.tril_indices(n)


def started(low: Lowered, mean: np.ndarray, cov: np.ndarray, batch: int) -> np.ndarray:
    """The rows (B, size) of a prior: the same for all tracks where it has no batch."""
    (step,) = low.need(("start",))
    points = low.packing.points
    i, j = _lower_places(low.packing.n)
    lower = cov[..., i, j]
    alone = mean.ndim == 1 and lower.ndim == 1
    count = 1 if alone else batch
    given = np.empty((count, low.packing.size), low.dtype)
    given[:, :points], given[:, points:] = mean, lower
    made = np.empty((count, low.packing.size), low.dtype)
    constants = step.setup(np.zeros(sum(z.size for z in low.zeros) + 1))
    job = Rows(step.address, pointer(constants), series(given, 1, True, False), made.shape[1], pointer(made))
    over_cores(low.driver["rows"], job, count, low.dtype == np.float32)
    return np.repeat(made, batch, 0) if alone else made


def filtered(keep: frozenset[str], ready: Prepared) -> tuple[Any, dict[str, Any]]:
    """The total log-likelihood and what is kept, by track and time.

    Raises:
        Refused: for a model or filter that cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    inputs = 0 if ready.u is None else ready.u.shape[-1]
    z = {s: np.ascontiguousarray(v) for s, v in ready.z.items()}
    low = lowered(ready.filter, ready.model, inputs, ready.mean.dtype)
    needed = [("predict",), *(("correct", s, v.shape[-1]) for s, v in z.items())]
    _, predict, *corrects = low.need(("start",), *needed)
    points, n, dtype, B = low.packing.points, low.packing.n, low.dtype, 1 if ready.batch is None else ready.batch
    T = ready.dt.shape[-1]
    state = started(low, ready.mean, ready.cov, B)
    numbers = low.parameters(ready.model)
    dt = np.ascontiguousarray(ready.dt)
    u = None if ready.u is None else np.ascontiguousarray(ready.u)

    def made(part: str, *shape: int, of: Any = dtype) -> np.ndarray | None:
        return np.empty((B, T, *shape), of) if part in keep else None

    dims = {s: ready.model.measured_space(s, v.shape[-1]).dim for s, v in z.items()}
    told = {
        s: Innovation(np.empty((B, T, m), dtype), np.empty((B, T, m, m), dtype), None, None, None)
        for s, m in dims.items()
        if "innovation" in keep
    }
    constants = [step.setup(numbers) for step in (predict, *corrects)]
    sensors = (Sensor * len(z))(
        *(
            Sensor(
                step.address,
                pointer(c),
                series(v, 1, v.ndim == 3, True),
                dims[s],
                pointer(told[s].residual) if s in told else None,
                pointer(told[s].factor) if s in told else None,
            )
            for (s, v), step, c in zip(z.items(), corrects, constants[1:], strict=True)
        )
    )
    total = np.empty(B, dtype)
    parts = {
        "mean": made("mean", points),
        "factor": made("factor", n, n),
        "nis": made("nis"),
        "step_log_likelihood": made("step_log_likelihood"),
        "fault": made("fault", of=np.int8),
        "dof": made("dof", of=np.int64),
    }
    job = Record(
        B,
        T,
        points,
        n,
        low.packing.size,
        predict.address,
        pointer(constants[0]),
        series(dt, 0, dt.ndim == 2, True),
        EMPTY if u is None else series(u, 1, u.ndim == 3, True),
        len(z),
        sensors,
        pointer(state),
        pointer(total),
        *(pointer(a) for a in parts.values()),
        int(ready.update_first),
    )
    single = dtype == np.float32
    over_cores(driver(single)["record"], job, B, single)
    kept: dict[str, Any] = {name: a for name, a in parts.items() if a is not None}
    if told:
        kept["innovation"] = told
    return (total, kept) if ready.batch is not None else _without_batch(total, kept)


def _without_batch(total: np.ndarray, kept: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    alone = {name: a[0] for name, a in kept.items() if name != "innovation"}
    if "innovation" in kept:
        alone["innovation"] = {
            s: i._replace(residual=i.residual[0], factor=i.factor[0]) for s, i in kept["innovation"].items()
        }
    return total[0], alone


def smoothed(filter: Filter, model: Model, kept: tuple[Any, Any, Any], dt: Any, u: Any) -> tuple[Any, Any, Any]:
    """Smoothed means, factors and faults, laid out as the filtered ones.

    Raises:
        Refused: for a model or filter that cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    dtype = kept[0].dtype
    low = lowered(filter, model, 0 if u is None else u.shape[-1], dtype)
    (step,) = low.need(("back",))
    mean, factor, fault = (np.ascontiguousarray(a, dtype) for a in kept)
    batched = mean.ndim == 3
    B, T = len(mean) if batched else 1, mean.shape[-2]
    new_mean, new_factor, failed = np.empty_like(mean), np.empty_like(factor), np.empty(fault.shape, np.int8)
    constants = step.setup(low.parameters(model))
    dt = np.ascontiguousarray(dt)
    u = None if u is None else np.ascontiguousarray(u)
    job = Smoothing(
        B,
        T,
        *low.packing,
        low.packing.size,
        step.address,
        pointer(constants),
        series(mean, 1, batched, True),
        series(factor, 2, batched, True),
        series(fault, 0, batched, True),
        series(dt, 0, dt.ndim == 2, True),
        EMPTY if u is None else series(u, 1, u.ndim == 3, True),
        *(pointer(a) for a in (new_mean, new_factor, failed)),
    )
    single = dtype == np.float32
    over_cores(driver(single)["backwards"], job, B, single)
    return new_mean, new_factor, failed
