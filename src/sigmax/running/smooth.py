"""Fixed-interval smoothing from the same quantities as filtering."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled, tracing
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.models.checks import is_traced
from sigmax.models.evaluate import noise_roots
from sigmax.models.model import Model
from sigmax.running import lanes
from sigmax.running.backend import attempt
from sigmax.running.current import current_model
from sigmax.running.edge import as_filter, cast, laid_out_steps
from sigmax.running.result import Layout, Result, Smoothed
from sigmax.running.scanned import batch_first, batch_last
from sigmax.running.smooth_step import back


def smooth(
    filter: Filter | str,
    model: Model,
    result: Result,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    backend: str | None = None,
) -> Smoothed:
    """Estimates of every step from the whole record (Rauch, Tung and Striebel), in square-root form.

    Each step linearises the motion again with the filter's own rule about the filtered estimate:
    Cov(x, f(x)) = S Eᵀ is the numerator of the gain, and nothing else is needed.

    Args:
        filter: the filter of the run.
        model: the model of the run.
        result: what `run` gave, with mean, factor and fault kept.
        dt: as given to the run; the first is not read, and may be left out.
        inputs: as given to the run.
        backend: as in `run`.

    Returns:
        Smoothed estimates; where a step could not be smoothed, the filtered estimate and a fault.

    Raises:
        InputError: where dt or inputs do not fit the result, or a part of it was not kept.
    """
    model = current_model(model)
    if not isinstance(result, Result):
        raise InputError(f"result must be what sigmax.run gave, it is {type(result).__name__}")
    chosen = as_filter(filter).on(model.biases)
    kept = result.kept()
    dtype = kept[0].dtype
    elapsed, u = laid_out_steps(model, dt, inputs, kept[0].shape[-2], dtype)
    model = cast(model.placed(chosen.form.bias_first), dtype)
    if Layout.of(model, result.layout.batched) != result.layout._replace(fusion=()):
        raise InputError("model and filter are not those of the run: state and bias stand in another order")
    traced = is_traced((kept, model, elapsed, u))

    def with_xla() -> Any:
        batched = result.layout.batched
        mean, factor, fault = (batch_last(a, a.ndim - batched) for a in kept)
        steps = batch_last(elapsed, 1), None if u is None else batch_last(u, 2)
        made = (_backwards if traced or tracing() else _compiled_backwards)(chosen, model, mean, factor, fault, *steps)
        return jax.tree.map(batch_first if batched else jnp.asarray if traced else np.asarray, made)

    made = attempt(backend, traced, lambda: lanes.smoothed(chosen, model, kept, elapsed, u), with_xla)
    return Smoothed(result.layout, *made)


def _backwards(
    filter: Filter, model: Model, mean: Any, factor: Any, fault: Any, dt: Any, u: Any
) -> tuple[Any, Any, Any]:
    noise = noise_roots(model)

    def step(later: tuple[Any, Any], at: Any) -> tuple[tuple[Any, Any], Any]:
        x, S, next_fault, next_dt, next_u = at
        new, failed = back(filter, model, noise, (x, S), later, next_fault, next_dt, next_u)
        return new, (*new, failed)

    last = mean[-1], factor[-1]
    inputs = None if u is None else u[1:]
    _, (x, S, failed) = jax.lax.scan(step, last, (mean[:-1], factor[:-1], fault[1:], dt[1:], inputs), reverse=True)
    none = jnp.zeros_like(fault[-1:])
    return (
        jnp.concatenate([x, last[0][None]]),
        jnp.concatenate([S, last[1][None]]),
        jnp.concatenate([failed, none]),
    )


_compiled_backwards = compiled(_backwards, static=(0,))
