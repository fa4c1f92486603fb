"""One step of the smoother: a pure function like a step of the filter."""

from typing import Any

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import Lifted, outer, product, times, wrap
from sigmax.algebra.factor import Diagonal, Matrix, dense, downdate, inverse_lower, solve_lower, tria
from sigmax.filters import Filter
from sigmax.models.evaluate import motion_noise, moving
from sigmax.models.model import Model
from sigmax.rules.linearization import Linearization
from sigmax.running.step import Fault

State = tuple[Any, Any]  # mean (n, ...) and factor (n, n, ...)


def back(
    filter: Filter,
    model: Model,
    noise: Matrix | None,
    filtered: State,
    later: State,
    later_fault: Any,
    dt: Any,
    u: Any,
) -> tuple[State, Any]:
    """The smoothed state of a step, and its fault (...), from the smoothed state of the step after it.

    `later_fault`, `dt` and `u` are those of the step after it.
    """
    x, S = filtered
    new, root, sound = _back(filter, model, noise, x, S, later, dt, u)
    unmoved = (later_fault > 0) & (later_fault <= Fault.PREDICTION_INDEFINITE)
    new, root = (jnp.where(sound, a, b) for a, b in ((new, x), (root, S)))
    # A step whose prediction failed left the state as it was: its smoothed state is the next one's.
    new, root = (jnp.where(unmoved, a, b) for a, b in zip(later, (new, root), strict=True))
    failed = jnp.where(sound | unmoved, 0, int(Fault.PREDICTION_INDEFINITE)).astype(jnp.int8)
    return (new, root), failed


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
    mean, derivative = jax.linearize(Lifted(model.domain, [], line.mean.ndim > 1), line.mean)
    turn = jax.vmap(derivative, in_axes=1, out_axes=1)
    deficit = turn(line.deficit) if line.deficit.shape[1] else line.deficit
    return Linearization(wrap(mean, model.angular), turn(line.slope), line.residual, deficit), turn(rest)
