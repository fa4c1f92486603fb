"""Fixed-interval smoothing from the same quantities as filtering."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import lift, outer, product, times, wrap
from sigmax.algebra.compiling import compiled, tracing
from sigmax.algebra.factor import Diagonal, Matrix, dense, downdate, inverse_lower, solve_lower, tria
from sigmax.filters import Filter
from sigmax.models.checks import is_traced
from sigmax.models.evaluate import motion_noise, moving, noise_root
from sigmax.models.model import Model
from sigmax.rules.linearization import Linearization
from sigmax.running.edge import as_filter, cast, laid_out_steps
from sigmax.running.result import Result, Smoothed, batch_first
from sigmax.running.step import Fault


def smooth(filter: Filter | str, model: Model, result: Result, *, dt: Any = 1.0, inputs: Any = None) -> Smoothed:
    """Estimates of every step from the whole record (Rauch, Tung and Striebel), in square-root form.

    Each step linearises the motion again with the filter's own rule about the filtered estimate:
    Cov(x, f(x)) = S Eᵀ is the numerator of the gain, and nothing else is needed.

    Args:
        filter: the filter of the run.
        model: the model of the run.
        result: what `run` gave, with mean, factor and fault kept.
        dt: as given to the run.
        inputs: as given to the run.

    Returns:
        Smoothed estimates; where a step could not be smoothed, the filtered estimate and a fault.

    Raises:
        InputError: where dt or inputs do not fit the result, or a part of it was not kept.
    """
    chosen = as_filter(filter)
    batched = result.layout.batched
    kept = (result.mean, result.factor, result.fault)
    mean, factor, fault = (jnp.moveaxis(a, 0, -1) if batched else a for a in kept)
    elapsed, u = laid_out_steps(model, dt, inputs, mean.shape[0], mean.dtype)
    inside = tracing() or is_traced((mean, model, elapsed, u))
    made = (_backwards if inside else _compiled_backwards)(
        chosen, cast(model, mean.dtype), mean, factor, fault, elapsed, u
    )
    if batched or not is_traced(made):
        made = jax.tree.map(batch_first if batched else np.asarray, made)
    return Smoothed(result.layout, *made)


def _backwards(
    filter: Filter, model: Model, mean: Any, factor: Any, fault: Any, dt: Any, u: Any
) -> tuple[Any, Any, Any]:
    noise = noise_root(model.Q)

    def back(later: tuple[Any, Any], at: Any) -> tuple[tuple[Any, Any], Any]:
        x, S, next_fault, next_dt, next_u = at
        new, root, sound = _back(filter, model, noise, x, S, later, next_dt, next_u)
        unmoved = (next_fault > 0) & (next_fault <= Fault.PREDICTION_INDEFINITE)
        new, root = (jnp.where(sound, a, b) for a, b in ((new, x), (root, S)))
        # A step whose prediction failed left the state as it was: its smoothed state is the next one's.
        new, root = (jnp.where(unmoved, a, b) for a, b in zip(later, (new, root), strict=True))
        failed = jnp.where(sound | unmoved, 0, int(Fault.PREDICTION_INDEFINITE)).astype(jnp.int8)
        return (new, root), (new, root, failed)

    last = mean[-1], factor[-1]
    inputs = None if u is None else u[1:]
    _, (x, S, failed) = jax.lax.scan(back, last, (mean[:-1], factor[:-1], fault[1:], dt[1:], inputs), reverse=True)
    none = jnp.zeros_like(fault[-1:])
    return (
        jnp.concatenate([x, last[0][None]]),
        jnp.concatenate([S, last[1][None]]),
        jnp.concatenate([failed, none]),
    )


_compiled_backwards = compiled(_backwards, static=(0,))


def _back(
    filter: Filter, model: Model, noise: Matrix | None, x: Any, S: Any, later: tuple[Any, Any], dt: Any, u: Any
) -> tuple[Any, Any, Any]:
    """One step backwards: G = S Eᵀ P⁻¹, S_s = tria[S − G E, G L_q, G N, G S_later], less G D."""
    line = filter.predict(moving(model, dt, u, x.ndim > 1), x, S, model.angular)
    Lq, sound = motion_noise(model, noise, x, dt, u)
    line, rest = _in_domain(model, line, dense(Lq))
    predicted = tria(jnp.concatenate([line.slope, rest], axis=1))
    if line.deficit.shape[1]:
        predicted, exists = downdate(predicted, line.deficit)
        sound &= exists
    # A component known exactly has a zero pivot and takes no part.
    pivot = jnp.stack([predicted[i, i] for i in range(x.shape[0])])
    known = pivot <= 0
    safe = predicted + dense(Diagonal(jnp.where(known, 1, 0).astype(x.dtype)))
    half = jnp.where(known[:, None], 0, solve_lower(safe, outer(line.slope, S)))
    gain = product(half.swapaxes(0, 1), inverse_lower(safe))
    later_mean, later_factor = later
    mean = wrap(x + times(gain, wrap(later_mean - line.mean, model.angular)), model.angular)
    pieces = [S - product(gain, line.slope), product(gain, rest), product(gain, later_factor)]
    factor = tria(jnp.concatenate(pieces, axis=1))
    if line.deficit.shape[1]:
        factor, exists = downdate(factor, product(gain, line.deficit))
        sound &= exists
    return mean, factor, sound & jnp.isfinite(mean.sum(0) + factor.sum((0, 1)))


def _in_domain(model: Model, line: Linearization, Lq: Any) -> tuple[Linearization, Any]:
    """The linearisation as the filter used it, after the model's domain, and the columns beside the slope."""
    rest = jnp.concatenate([Lq, line.residual], axis=1)
    if model.domain is None:
        return line, rest
    mean, derivative = jax.linearize(lift(model.domain, [], line.mean.ndim > 1), line.mean)
    turn = jax.vmap(derivative, in_axes=1, out_axes=1)
    deficit = turn(line.deficit) if line.deficit.shape[1] else line.deficit
    return Linearization(wrap(mean, model.angular), turn(line.slope), line.residual, deficit), turn(rest)
