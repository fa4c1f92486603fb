"""Records through steps compiled for this machine: many tracks side by side in the lanes of a core."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from sigmax.engine import job
from sigmax.engine.lowered import Lowered, lowered
from sigmax.engine.steady import settled
from sigmax.filters import Filter, of_one_belief
from sigmax.modelling.model import Model
from sigmax.preparation.prepare import Prepared
from sigmax.steps.step import Innovation

# A single track of so many steps takes those that are made for one, which are compiled by themselves.
_LONG = 2048


@cache
def _lower_places(n: int) -> tuple[np.ndarray, ...]:
    return np.tril_indices(n)


def started(low: Lowered, parts: job.Parts, mean: np.ndarray, cov: np.ndarray, batch: int) -> np.ndarray:
    """The rows (B, size) of a prior, by the part "start": the same for all tracks where it has no batch."""
    points = low.packing.points
    i, j = _lower_places(low.packing.n)
    lower = cov[..., i, j]
    alone = mean.ndim == 1 and lower.ndim == 1
    count = 1 if alone else batch
    given, out = (np.empty((count, size), low.dtype) for size in (low.packing.head, low.packing.size))
    given[:, :points], given[:, points:] = mean, lower
    job.execute(low, "rows", job.rows(parts["start",], given, out), count)
    return np.repeat(out, batch, 0) if alone else out


def filtered(keep: frozenset[str], ready: Prepared) -> tuple[Any, dict[str, Any]]:
    """The total log-likelihood and what is kept, by track and time.

    Raises:
        Refused: for a model or filter that cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    z = {s: np.ascontiguousarray(v) for s, v in ready.z.items()}
    B, T = 1 if ready.batch is None else ready.batch, ready.dt.shape[-1]
    inputs = 0 if ready.u is None else ready.u.shape[-1]
    low = lowered(ready.filter, ready.model, inputs, ready.mean.dtype, alone=B == 1 and T >= _LONG)
    parts = job.bind(low, ready.model, ("start",), ("predict",), *(("correct", s, v.shape[-1]) for s, v in z.items()))
    dtype = low.dtype
    points, n = low.packing[:2]
    state = started(low, parts, ready.mean, ready.cov, B)

    def array(part: str, *shape: int, of: Any = dtype) -> np.ndarray | None:
        return np.empty((B, T, *shape), of) if part in keep else None

    dims = {s: ready.model.measured_space(s, v.shape[-1]).dim for s, v in z.items()} if "innovation" in keep else {}
    out = job.Outputs(
        mean=array("mean", points),
        factor=array("factor", n, n),
        nis=array("nis"),
        log_likelihood=array("step_log_likelihood"),
        fault=array("fault", of=np.int8),
        dof=array("dof", of=np.int64),
        total=np.empty(B, dtype),
        rest=array("modes", low.packing.size - low.packing.head) if low.packing.tail else None,
        innovation={
            s: Innovation(np.empty((B, T, m), dtype), np.empty((B, T, m, m), dtype), None, None, None)
            for s, m in dims.items()
        },
    )
    u = None if ready.u is None else np.ascontiguousarray(ready.u)
    dt = np.ascontiguousarray(ready.dt)
    steady = settled(low, ready.model, {s: v.shape[-1] for s, v in z.items()}, T, u is not None)
    task = job.record(low.packing, parts, ready.model, state, z, dt, u, out, int(ready.update_first), steady)
    job.execute(low, "record", task, B)
    return _kept(out, ready.batch is not None)


def _kept(out: job.Outputs, batched: bool) -> tuple[Any, dict[str, Any]]:
    """The total, and what there is by its name in a result, without the axis of tracks where there is one track."""

    def laid(a: np.ndarray) -> Any:
        return a if batched else a[0]

    arrays = out._asdict() | {"step_log_likelihood": out.log_likelihood, "modes": out.rest}
    kept: dict[str, Any] = {
        name: laid(a)
        for name, a in arrays.items()
        if a is not None and name not in ("log_likelihood", "innovation", "rest")
    }
    if out.innovation:
        kept["innovation"] = {
            s: i._replace(residual=laid(i.residual), factor=laid(i.factor)) for s, i in out.innovation.items()
        }
    return kept.pop("total"), kept


def smoother(filter: Filter, model: Model, inputs: int, dtype: Any) -> Callable[..., tuple[Any, ...]]:
    """A function of what was kept, dt and u: smoothed means, factors, faults and the rest, laid out as the filtered.

    Raises:
        Refused: for a model or filter that cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    low = lowered(of_one_belief(filter), model, inputs, dtype)
    (back,) = job.bind(low, model, ("back",)).values()
    return partial(_smoothed, low, back)


def _smoothed(low: Lowered, back: job.BoundStep, kept: tuple[Any, ...], dt: Any, u: Any) -> tuple[Any, ...]:
    dtype = kept[0].dtype
    mean, factor, fault = (np.ascontiguousarray(a, dtype) for a in kept[:3])
    rest = np.ascontiguousarray(kept[3]) if low.packing.tail else None
    behind = None if rest is None else np.empty_like(rest)
    out = np.empty_like(mean), np.empty_like(factor), behind, np.empty(fault.shape, np.int8)
    dt, u = np.ascontiguousarray(dt), None if u is None else np.ascontiguousarray(u)
    task = job.smoothing(low.packing, back, (mean, factor, fault, rest), dt, u, out)
    job.execute(low, "backwards", task, task.tracks)
    return out[0], out[1], out[3], out[2]
