"""A whole record, or thousands of them, in one call."""

from collections.abc import Collection
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.engine import native_engine, xla_engine
from sigmax.engine.backend import attempt
from sigmax.errors import InputError, unknown
from sigmax.filters import Bank, Filter, FromInformation
from sigmax.modelling.checks import is_traced, strings
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.preparation.fusing import how, with_members
from sigmax.preparation.prepare import Prepared, as_filter, prepare
from sigmax.preparation.times import Times, later, times_of
from sigmax.results.result import PARTS, Result
from sigmax.steps.adaptive_noises import adapted_noises
from sigmax.steps.updating import update_on


def run(
    filter: Filter | str | None,
    model: Model,
    prior: Gaussian,
    z: Any,
    *,
    dt: Any = None,
    t: Any = None,
    t0: Any = None,
    inputs: Any = None,
    R: Any = None,
    update_first: bool = False,
    keep: Collection[str] = PARTS,
    dtype: Any = "float64",
    backend: str | None = None,
) -> Result:
    """Filter a record: predict over dt, correct with the measurements, step by step.

    Args:
        filter: a name of the catalogue, or a filter from `get` or of your own parts; None where the model has modes
            that all name theirs.
        model: the model, or several that take turns, by `imm`.
        prior: the state one dt before the first measurement, or at it: see `update_first`.
        z: measurements (T, m), or (B, T, m) for B tracks at once; NaN is missing, whole or in part.
            A dict by sensor name where the model has several; they are corrected in its order.
        dt: seconds since the step before: one number, (T,) or (B, T); timedeltas, too. 1 without dt and t.
        t: the times of the measurements in the place of dt, (T,) or (B, T): seconds, or instants, as lists, arrays, or
            columns of pandas, polars and Arrow. Instants without a time zone are taken to be in UTC.
        t0: the time of the prior, of the same kind: with t where it does not stand at the first measurement, with dt
            so that the times of the result begin there.
        inputs: (T, k) or (B, T, k) for motions and sensors that take u.
        R: the noise of each measurement, if it is not the model's: variances (T, m) or covariances (T, m, m), with a
            batch in front or without; a dict by sensor name where the model has several, of those that have their own.
        update_first: whether the prior stands at the first measurement: then no motion and no Q come before that one,
            whatever the motion. The first dt is not read, and may be left out: (T − 1,) or (B, T − 1).
        keep: which parts of the result to store, to save memory on large batches; the log-likelihood
            of the record always is.
        dtype: float64, or float32 where the square-root forms allow it.
        backend: "native" for steps compiled by the C compiler, "xla" for XLA. Without it native where
            the model can be lowered and there is a compiler and no GPU, else XLA.

    Returns:
        The estimates after each step with innovations, NIS, likelihood and soundness.

    Raises:
        InputError: before anything is computed, for whatever does not fit. A failure inside
            the run is no error but data: `result.ok`, `result.faults()`.
    """
    chosen = as_filter(filter, model)
    keep = strings("keep", keep, ordered=False)
    for part in keep:
        if part not in PARTS:
            raise unknown("part of a result", part, PARTS)
    times = times_of(t, t0)
    ready = prepare(chosen, model, prior, z, steps_given(dt, t, times), inputs, dtype, update_first, keep, R)
    kept = frozenset(keep) | ({"dof"} if ready.fused is not None else set())
    traced = ready.traced
    total, parts = attempt(
        backend,
        traced,
        lambda: native_engine.filtered(kept, ready),
        lambda: xla_engine.filtered(kept, ready, traced),
    )
    each = () if isinstance(ready.filter, Bank) else ready.z
    layout = ready.layout._replace(
        filter=chosen.name,
        from_information=isinstance(ready.filter, FromInformation),
        dated=times is not None and times.dated,
        noises=adapted_noises(ready.filter, ready.model),
        weights=tuple((s, update_on(ready.filter, ready.model, s).weight) for s in each),
    )
    if ready.fused is not None:
        total, parts = with_members(parts, total, ready.fused)
        layout = layout._replace(fusion=how(ready.filter, model))
    return Result(
        layout=layout,
        stored_mean=parts.get("mean"),
        stored_factor=parts.get("factor"),
        stored_fault=parts.get("fault"),
        stored_modes=parts.get("modes"),
        stored_innovations=parts.get("innovation"),
        stored_nis=parts.get("nis"),
        stored_log_likelihood=parts.get("step_log_likelihood"),
        stored_count=parts.get("dof"),
        stored_total=total,
        **_steps_taken(ready, kept),
        stored_time=None if times is None else _time(times, t is not None, ready),
    )


def steps_given(dt: Any, t: Any, times: Times | None) -> Any:
    """The intervals of a record from what was given of them: seconds, or times; 1 where nothing was.

    Raises:
        InputError: where both were.
    """
    if t is None:
        return 1.0 if dt is None else dt
    if dt is not None:
        raise InputError("dt and t both tell the time between steps: give one of them")
    return times


def _time(times: Times, whole: bool, ready: Prepared) -> Any:
    """The times of all steps, of each track where there are tracks."""
    value = times.value if whole else later(times, ready.dt)
    array: Any = jnp if is_traced(value) else np
    tracks = () if ready.batch is None else (ready.batch,)
    return array.broadcast_to(value, (*tracks, ready.dt.shape[-1]))


def _steps_taken(ready: Prepared, kept: Collection[str]) -> dict[str, Any]:
    """A copy of intervals and inputs for what can be smoothed; views of it for each track where there are tracks."""
    if not {"mean", "factor", "fault"} <= set(kept):
        return {}
    array: Any = jnp if is_traced(ready.dt) or is_traced(ready.inputs) else np
    if ready.batch is None and ready.inputs is None:
        return {"stored_dt": array.array(ready.dt), "stored_inputs": None}
    tracks = () if ready.batch is None else (ready.batch,)
    return {
        "stored_dt": array.broadcast_to(array.array(ready.dt), (*tracks, ready.dt.shape[-1])),
        "stored_inputs": None
        if ready.inputs is None
        else array.broadcast_to(array.array(ready.inputs), (*tracks, *ready.inputs.shape[-2:])),
    }
