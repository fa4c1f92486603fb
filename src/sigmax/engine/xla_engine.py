"""Records through XLA: for gradients, for GPUs, and where a model cannot be lowered to C."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled, tracing
from sigmax.engine.advance import Advanced, Instant, advance
from sigmax.engine.half_steps import half_steps
from sigmax.engine.packing import Packing
from sigmax.filters import Filter
from sigmax.modelling.checks import is_traced
from sigmax.modelling.model import Model
from sigmax.modelling.opaque import calls_out
from sigmax.preparation.prepare import Prepared

_SMALLEST_PART = 256

Parts = tuple[Any, dict[str, Any]]


class _Laid(NamedTuple):
    """A record as the engine takes it: time first, batch last or absent."""

    mean: Any
    cov: Any
    z: Any
    dt: Any
    u: Any


def batch_first(a: Any) -> Any:
    """An array of the engine, batch last, with the batch first: a view where its numbers are known."""
    return jnp.moveaxis(a, -1, 0) if is_traced(a) else np.moveaxis(np.asarray(a), -1, 0)


def batch_last(a: Any, core: int) -> Any:
    """An array with the batch, if it has one before its `core` axes, behind them."""
    a = jnp.asarray(a)
    return jnp.moveaxis(a, 0, -1) if a.ndim > core else a


def filtered(keep: frozenset[str], ready: Prepared, traced: bool) -> Parts:
    """The total log-likelihood and what is kept, by track and time."""
    filter = ready.filter
    laid = _Laid(
        batch_last(ready.mean, 1),
        batch_last(ready.cov, 2),
        {s: batch_last(v, 2) for s, v in ready.z.items()},
        batch_last(ready.dt, 1),
        None if ready.u is None else batch_last(ready.u, 2),
    )
    if ready.batch is not None:
        B = ready.batch
        laid = laid._replace(
            mean=laid.mean if laid.mean.ndim == 2 else jnp.repeat(laid.mean[:, None], B, 1),
            cov=laid.cov if laid.cov.ndim == 3 else jnp.repeat(laid.cov[:, :, None], B, 2),
            z={s: v if v.ndim == 3 else jnp.repeat(v[:, :, None], B, 2) for s, v in laid.z.items()},
        )
    # Options of a compilation belong to the outermost one.
    if traced or tracing():
        made = jax.jit(_scan, static_argnums=(0, 1, 2))(filter, keep, ready.update_first, ready.model, *laid)
    else:
        made = _over_cores(filter, keep, ready.update_first, ready.model, laid)
    if ready.batch is None:
        return made if traced else jax.tree.map(np.asarray, made)
    return jax.tree.map(batch_first, made)


def _over_cores(filter: Filter, keep: frozenset[str], update_first: bool, model: Model, laid: _Laid) -> Parts:
    """A large batch in as many equal parts as there are cores: the compiler alone uses little more than one."""
    cores = os.cpu_count() or 1
    batch = laid.mean.shape[1] if laid.mean.ndim == 2 else 1
    small = cores == 1 or batch < cores * _SMALLEST_PART
    # What is opaque is to be called once for the whole batch, and never by two threads at a time.
    if jax.default_backend() != "cpu" or small or _opaque(model, laid):
        return _compiled_scan(filter, keep, update_first, model, *laid)
    size = -(-batch // cores)
    # Equal parts share one compilation; the last one repeats some tracks to be as long as the others.
    starts = [min(i * size, batch - size) for i in range(cores)]
    cuts = (True, True, True, laid.dt.ndim == 2, laid.u is not None and laid.u.ndim == 3)

    def part(start: int) -> Parts:
        mine = (
            jax.tree.map(lambda a: a[..., start : start + size], value) if cut else value
            for value, cut in zip(laid, cuts, strict=True)
        )
        return jax.block_until_ready(_compiled_scan(filter, keep, update_first, model, *mine))

    with ThreadPoolExecutor(cores) as pool:
        parts = list(pool.map(part, starts))
    overlap = starts[-2] + size - starts[-1]

    def joined(*pieces: Any) -> Any:
        return np.concatenate([*pieces[:-1], np.asarray(pieces[-1])[..., overlap:]], axis=-1)

    return jax.tree.map(joined, *parts)


def _opaque(model: Model, laid: _Laid) -> bool:
    x, dt = jnp.zeros(model.size), jnp.zeros(())
    u = () if laid.u is None else (jnp.zeros(laid.u.shape[1]),)
    return calls_out(model.motion, x, dt, *u[: model.motion_inputs]) or any(
        calls_out(h, x, *u[: model.sensor_inputs[s]]) for s, h in model.sensors.items()
    )


def _scan(
    filter: Filter,
    keep: frozenset[str],
    update_first: bool,
    model: Model,
    mean: Any,
    cov: Any,
    z: dict[str, Any],
    dt: Any,
    u: Any,
) -> Parts:
    """The run over a record: total log-likelihood and what is kept, batch last."""
    steps, packing = half_steps(filter, model), Packing.of(filter, model)

    def step(
        carry: tuple[Any, jax.Array], here: tuple[Instant, jax.Array]
    ) -> tuple[tuple[Any, jax.Array], dict[str, Any]]:
        (belief, total), (given, moving) = carry, here
        belief, said, fault = advance(steps, model.sensors, belief, given, moving if update_first else True)
        count = sum(i.dof for i in said.values())
        log_likelihood = sum(i.log_likelihood for i in said.values())
        nis = sum(jnp.where(i.dof > 0, i.nis, 0) for i in said.values())
        parts = {
            "mean": belief.mean,
            "factor": belief.factor,
            "fault": fault,
            "nis": jnp.where(count > 0, nis, jnp.nan),
            "dof": count,
            "step_log_likelihood": log_likelihood,
            "innovation": said,
        }
        if packing.tail:
            parts["modes"] = packing.rest(belief)
        return (belief, total + log_likelihood), {name: parts[name] for name in keep & parts.keys()}

    started, _ = steps.begin(mean, cov)
    zero = jnp.zeros(mean.shape[1:], mean.dtype)
    (_, total), parts = jax.lax.scan(step, (started, zero), (Instant(z, dt, u), jnp.arange(dt.shape[0]) > 0))
    return total, parts


_compiled_scan = compiled(_scan, static=(0, 1, 2))


@partial(jax.jit, static_argnums=0)
def begun(filter: Filter, model: Model, mean: Any, cov: Any) -> Any:
    """The belief of a prior (n,) and (n, n), or batch last."""
    return half_steps(filter, model).begin(mean, cov)[0]


@lru_cache(maxsize=128)
def advancing(filter: Filter, structure: Any) -> Any:
    """The compiled step of a filter on models of one structure: (leaves, belief, given) -> `Advanced`."""

    def go(leaves: Any, belief: Any, given: Instant) -> Advanced:
        model = jax.tree.unflatten(structure, leaves)
        return advance(half_steps(filter, model), model.sensors, belief, given, True)

    return compiled(go)
