"""A whole record, or thousands of them, in one call."""

import os
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled, tracing
from sigmax.errors import unknown
from sigmax.filters import Filter
from sigmax.models.checks import is_traced
from sigmax.models.evaluate import noise_root
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.running.edge import Prepared, as_filter, prepare
from sigmax.running.result import Layout, Result, batch_first
from sigmax.running.step import Belief, Innovation, begin, correct, predict

PARTS = ("mean", "factor", "fault", "nis", "dof", "step_log_likelihood", "innovation")
_SMALLEST_PART = 256

Parts = tuple[Any, dict[str, Any]]


def run(
    filter: Filter | str,
    model: Model,
    prior: Gaussian,
    z: Any,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    keep: Collection[str] = PARTS,
    dtype: Any = "float64",
) -> Result:
    """Filter a record: predict over dt, correct with the measurements, step by step.

    Args:
        filter: a name of the catalogue, or a filter from `get` or of your own parts.
        model: the model.
        prior: the state one dt before the first measurement (dt[0] = 0: at the first measurement).
        z: measurements (T, m), or (B, T, m) for B tracks at once; NaN is missing, whole or in part.
            A dict by sensor name where the model has several; they are corrected in its order.
        dt: seconds since the step before: one number, (T,) or (B, T).
        inputs: (T, k) or (B, T, k) for motions and sensors that take u.
        keep: which parts of the result to store, to save memory on large batches; the log-likelihood
            of the record always is.
        dtype: float64, or float32 where the square-root forms allow it.

    Returns:
        The estimates after each step with innovations, NIS, likelihood and soundness.

    Raises:
        InputError: before anything is computed, for whatever does not fit. A failure inside
            the run is no error but data: `result.ok`, `result.faults()`.
    """
    chosen = as_filter(filter)
    for part in keep:
        if part not in PARTS:
            raise unknown("part of a result", part, PARTS)
    ready = prepare(chosen, model, prior, z, dt, inputs, dtype)
    if tracing() or is_traced(ready):
        total, parts = jax.jit(scan, static_argnums=(0, 1))(chosen, frozenset(keep), *ready)
    else:
        total, parts = _over_cores(chosen, frozenset(keep), ready)
    batched = ready.mean.ndim == 2
    if batched or not is_traced(total):
        total, parts = jax.tree.map(batch_first if batched else np.asarray, (total, parts))
    return Result(
        layout=Layout(model.state, model.angular, batched, model.several),
        stored_mean=parts.get("mean"),
        stored_factor=parts.get("factor"),
        stored_fault=parts.get("fault"),
        stored_innovations=parts.get("innovation"),
        stored_nis=parts.get("nis"),
        stored_log_likelihood=parts.get("step_log_likelihood"),
        stored_count=parts.get("dof"),
        stored_total=total,
    )


def _over_cores(filter: Filter, keep: frozenset[str], ready: Prepared) -> Parts:
    """A large batch in as many equal parts as there are cores: the compiler alone uses little more than one."""
    cores = os.cpu_count() or 1
    batch = ready.mean.shape[1] if ready.mean.ndim == 2 else 1
    if jax.default_backend() != "cpu" or cores == 1 or batch < cores * _SMALLEST_PART:
        return compiled_scan(filter, keep, *ready)
    size = -(-batch // cores)
    # Equal parts share one compilation; the last one repeats some tracks to be as long as the others.
    starts = [min(i * size, batch - size) for i in range(cores)]
    cuts = (False, True, True, True, ready.dt.ndim == 2, ready.u is not None and ready.u.ndim == 3)

    def part(start: int) -> Parts:
        mine = (
            jax.tree.map(lambda a: a[..., start : start + size], value) if cut else value
            for value, cut in zip(ready, cuts, strict=True)
        )
        return jax.block_until_ready(compiled_scan(filter, keep, *mine))

    with ThreadPoolExecutor(cores) as pool:
        parts = list(pool.map(part, starts))
    overlap = starts[-2] + size - starts[-1]

    def joined(*pieces: Any) -> Any:
        return np.concatenate([*pieces[:-1], np.asarray(pieces[-1])[..., overlap:]], axis=-1)

    return jax.tree.map(joined, *parts)


def scan(
    filter: Filter, keep: frozenset[str], model: Model, mean: Any, factor: Any, z: dict[str, Any], dt: Any, u: Any
) -> Parts:
    """The run over a `Prepared` record: total log-likelihood and what is kept, batch last."""
    root = noise_root(model.Q)

    def step(carry: tuple[Belief, jax.Array], at: Prepared) -> tuple[tuple[Belief, jax.Array], dict[str, Any]]:
        belief, total = carry
        belief, fault = predict(filter, model, root, belief, at.dt, at.u)
        sound = fault == 0
        told = {}
        for sensor, measured in at.z.items():
            measured = jnp.where(sound, measured, jnp.nan)
            belief, told[sensor], failed = _corrected(filter, model, sensor, belief, measured, at.u, len(z) > 1)
            fault = jnp.where(fault == 0, failed, fault)
        count = sum(i.dof for i in told.values())
        log_likelihood = sum(i.log_likelihood for i in told.values())
        nis = sum(jnp.where(i.dof > 0, i.nis, 0) for i in told.values())
        parts = {
            "mean": belief.mean,
            "factor": belief.factor,
            "fault": fault,
            "nis": jnp.where(count > 0, nis, jnp.nan),
            "dof": count,
            "step_log_likelihood": log_likelihood,
            "innovation": told,
        }
        return (belief, total + log_likelihood), {name: parts[name] for name in keep}

    started = begin(filter, mean, factor)
    zero = jnp.zeros(mean.shape[1:], mean.dtype)
    records = Prepared(model=None, mean=None, factor=None, z=z, dt=dt, u=u)  # type: ignore[arg-type]
    (_, total), parts = jax.lax.scan(step, (started, zero), records)
    return total, parts


compiled_scan = compiled(scan, static=(0, 1))


def _corrected(
    filter: Filter, model: Model, sensor: str, belief: Belief, z: Any, u: Any, skip: bool
) -> tuple[Belief, Innovation, jax.Array]:
    """A correction; where there are several sensors, one that nobody heard from in this step costs nothing."""

    def heard(belief: Belief) -> tuple[Belief, Innovation, jax.Array]:
        return correct(filter, model, sensor, model.R[sensor], belief, z, u)

    if not skip:
        return heard(belief)

    def silent(belief: Belief) -> tuple[Belief, Innovation, jax.Array]:
        _, told, fault = jax.eval_shape(heard, belief)
        empty = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), told)
        missing = empty._replace(residual=jnp.full_like(empty.residual, jnp.nan), nis=jnp.full_like(empty.nis, jnp.nan))
        return belief, missing, jnp.zeros(fault.shape, fault.dtype)

    return jax.lax.cond(jnp.isfinite(z).any(), heard, silent, belief)
