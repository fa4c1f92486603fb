"""Smoothing on both engines: from what a filter kept, one step after another backwards."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled, tracing
from sigmax.engine import native_engine
from sigmax.engine.backend import attempt
from sigmax.engine.half_steps import back_steps
from sigmax.engine.packing import Packing
from sigmax.engine.xla_engine import batch_first, batch_last
from sigmax.errors import InputError
from sigmax.filters import Filter, of_one_belief
from sigmax.modelling.model import Model


def check_smoothed(filter: Filter) -> None:
    """Refuse a filter whose estimates cannot be smoothed.

    Raises:
        InputError: where it considers components: its errors depend on all measurements by way of these, and a step
            backwards takes them for those of a filter that has used all it was told.
    """
    if filter.consider:
        raise InputError(
            f"{filter.name} considers {', '.join(filter.consider)}, and smoothing takes every component as estimated: "
            "run and smooth the same filter without consider="
        )


def backwards(
    filter: Filter, model: Model, kept: Any, dt: Any, u: Any, batched: bool, traced: bool, backend: str | None
) -> tuple[Any, Any, Any, Any]:
    """Smoothed means, factors, faults and modes of filtered ones, all with the batch first; the arguments checked."""
    filter = of_one_belief(filter)
    kept = kept if Packing.of(filter, model).tail else (*kept[:3], None)

    def with_xla() -> Any:
        mean, factor, fault, rest = (None if a is None else batch_last(a, a.ndim - batched) for a in kept)
        steps = batch_last(dt, 1), None if u is None else batch_last(u, 2)
        made = (_backwards if traced or tracing() else _compiled_backwards)(
            filter, model, mean, factor, fault, rest, *steps
        )
        return jax.tree.map(batch_first if batched else jnp.asarray if traced else np.asarray, made)

    def natively() -> Any:
        return native_engine.smoother(filter, model, 0 if u is None else u.shape[-1], kept[0].dtype)(kept, dt, u)

    made: tuple[Any, Any, Any, Any] = attempt(backend, traced, natively, with_xla)
    return made


def _backwards(
    filter: Filter, model: Model, mean: Any, factor: Any, fault: Any, rest: Any, dt: Any, u: Any
) -> tuple[Any, Any, Any, Any]:
    steps, packing = back_steps(filter, model), Packing.of(filter, model)
    arrays = [mean, factor, *packing.behind(rest)]

    def step(later: Any, at: Any) -> tuple[Any, Any]:
        now, next_fault, next_dt, next_u = at
        new, failed = steps.back(packing.belief(now), later, next_fault, next_dt, next_u)
        return new, (packing.arrays(new), failed)

    last = packing.belief([a[-1] for a in arrays])
    inputs = None if u is None else u[1:]
    _, (made, failed) = jax.lax.scan(step, last, ([a[:-1] for a in arrays], fault[1:], dt[1:], inputs), reverse=True)
    all_steps = [jnp.concatenate([a, b[-1:]]) for a, b in zip(made, arrays, strict=True)]
    failed = jnp.concatenate([failed, jnp.zeros_like(fault[-1:])])
    behind = jax.vmap(packing.rest)(packing.belief(all_steps)) if packing.tail else None
    return all_steps[0], all_steps[1], failed, behind


_compiled_backwards = compiled(_backwards, static=(0,))
