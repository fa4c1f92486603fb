"""One step of the smoother: a pure function like a step of the filter."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Matrix, absorb, add, dense, downdate, pivoted, raised, release, solve_lower, tria
from sigmax.filters import Filter
from sigmax.modelling.evaluate import disturbed_motion, in_domain
from sigmax.modelling.model import Model
from sigmax.rules import Taylor1
from sigmax.rules.charted import linearized
from sigmax.rules.linearization import Linearization
from sigmax.spaces import reset
from sigmax.steps.constraining import conditioned
from sigmax.steps.step import Fault
from sigmax.steps.updating import ROUNDING

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
    stretch: Any = None,
) -> tuple[State, Any]:
    """The smoothed state of a step, and its fault (...), from the smoothed state of the step after it.

    `later_fault`, `dt` and `u` are those of the step after it, `stretch` as in `step.predict`.
    """
    x, S, _ = conditioned(filter, model, *filtered, "measured")
    new, root, sound = _back(filter, model, noise, x, S, later, dt, u, stretch)
    unmoved = (later_fault > 0) & (later_fault <= Fault.PREDICTION_INDEFINITE)
    new, root = (jnp.where(sound, a, b) for a, b in ((new, x), (root, S)))
    # A step whose prediction failed left the state as it was: its smoothed state is the next one's.
    new, root = (jnp.where(unmoved, a, b) for a, b in zip(later, (new, root), strict=True))
    failed = jnp.where(sound | unmoved, 0, int(Fault.PREDICTION_INDEFINITE)).astype(jnp.int8)
    return (new, root), failed


def _back(
    filter: Filter,
    model: Model,
    noise: Matrix | None,
    x: Any,
    S: Any,
    later: tuple[Any, Any],
    dt: Any,
    u: Any,
    stretch: Any,
) -> tuple[Any, Any, Any]:
    """One step backwards: x_s = x + C S⁻⁻¹ (x_later − x⁻), S_s = tria[left, C S⁻⁻¹ S_later], less what D takes.

    [[L, E], [0, S]] → [[S⁻, 0], [C, left]], L = tria[L_q, N]: C S⁻⁻¹ is the smoother's gain, and left leftᵀ what x⁻
    leaves open of x. P⁻ is neither formed nor inverted.
    """
    line, Lq, sound = disturbed_motion(filter.predict, model, noise, x, S, dt, u, stretch)
    line, L = _in_domain(model, line, Lq)
    # Rounding counts as noise: neither a row of E and S nor the mean is better than its last digits.
    rows = jnp.abs(line.slope).sum(1) + jnp.abs(S).sum(1)
    L = raised(L, float(np.finfo(x.dtype).eps) * (ROUNDING * rows + 4 * model.space.magnitude(line.mean)))
    predicted, cross, left = absorb(L, line.slope, S)
    taken = line.deficit
    if taken.shape[1]:
        # As the filter did: without the negative weights where the difference is indefinite.
        less, exists = release(predicted, taken, cross)
        predicted, cross = (jnp.where(exists, a, b) for a, b in ((less.factor, predicted), (less.cross, cross)))
        taken = jnp.where(exists, less.rest, 0)
    later_mean, later_factor = later
    space = model.space
    ahead = space.difference(later_mean, line.mean)
    later_factor = space.turned_back(line.mean, ahead, later_factor)
    along = _solved(predicted, jnp.concatenate([ahead[:, None], later_factor], axis=1))
    shift = times(cross, along[:, 0])
    mean = space.add(x, shift)
    factor = tria(jnp.concatenate([left, product(cross, along[:, 1:])], axis=1))
    if taken.shape[1]:
        factor, exists = downdate(factor, taken)
        sound &= exists
    factor = reset(space, x, shift, factor).factor
    return mean, factor, sound & jnp.isfinite(mean.sum(0) + factor.sum((0, 1)))


def _solved(L: Any, b: Any) -> Any:
    """L⁻¹ b, where a pivot of 0 belongs to a component known exactly, which takes no part."""
    known = jnp.stack([L[i, i] <= 0 for i in range(len(L))])
    return jnp.where(known[:, None], 0, solve_lower(pivoted(L), b))


def _in_domain(model: Model, line: Linearization, Lq: Matrix) -> tuple[Linearization, Matrix]:
    """The linearisation as the filter used it, after the model's domain, and a factor of what its slope leaves."""
    L = add(Lq, line.residual) if line.residual.shape[1] else Lq
    function = in_domain(model, line.mean.ndim > 1)
    if function is None:
        return line, L
    space = model.space

    def turned(M: Any) -> Linearization:
        return linearized(Taylor1(), function, line.mean, M, space, space)

    slope = turned(line.slope)
    deficit = turned(line.deficit).slope if line.deficit.shape[1] else line.deficit
    return Linearization(slope.mean, slope.slope, line.residual, deficit), tria(turned(dense(L)).slope)
