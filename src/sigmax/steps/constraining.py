"""A belief conditioned on what is known of every state: cut off between bounds, projected onto a value."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import Lifted, static
from sigmax.algebra.factor import Diagonal, reciprocal, safe_sqrt
from sigmax.filters import Filter
from sigmax.modelling.constraint import Constraint
from sigmax.modelling.model import Model
from sigmax.rules.charted import linearized
from sigmax.rules.linearization import Linearization
from sigmax.spaces import Flat, reset
from sigmax.steps.considering import considered
from sigmax.steps.updating import ROUNDING, Observed, without_deficit

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
# Where a normal density has fallen to the rounding of its largest value: exp(−_DEEP).
_DEEP = 39.0
# A bound that takes less of the variance than this is none.
_LEAST = 1e-12


def conditioned(
    filter: Filter, model: Model, x: jax.Array, S: jax.Array, when: str | None = None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Mean and factor given the constraints of a model, and whether these could be taken (...).

    All of them, or those that are taken at one time of a step.
    """
    sound = jnp.ones(x.shape[1:], bool)
    for constraint in (c for c in model.constraints if when in (None, c.when)):
        for row in range(len(constraint.low)):
            new, root, fine = _by_row(filter, model, constraint, row, x, S)
            x, S = jnp.where(fine, new, x), jnp.where(fine, root, S)
            sound &= fine
    return x, S, sound


def _by_row(
    filter: Filter, model: Model, constraint: Constraint, row: int, x: jax.Array, S: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """One function y of the state between two bounds: a measurement whose noise leaves the variance that is left.

    y ~ N(ŷ, s²) cut off has the mean ŷ + s δ and the variance s² τ². A measurement of noise r² = s² τ² / (1 − τ²) and
    innovation s δ / (1 − τ²) gives y just these, and the state what its regression on y makes of them.
    """
    low, high = constraint.low[row], constraint.high[row]

    one = Lifted(_row(constraint.function, row), [], x.ndim > 1)
    line = linearized(filter.correct, one, x, S, model.space, Flat((False,)))
    variance = sum(((M[0] ** 2).sum(0) for M in (line.slope, line.residual)), start=jnp.zeros_like(x[0]))
    s, spread = safe_sqrt(variance - (line.deficit[0] ** 2).sum(0))
    y, eps = line.mean[0], float(np.finfo(x.dtype).eps)
    shift, left = truncated(*(jnp.where(spread, (b - y) * reciprocal(s, spread), 0.0) for b in (low, high)))
    taken = jnp.where(spread, 1 - left, 0.0)
    acts = taken > _LEAST
    noise = safe_sqrt(left * reciprocal(taken, acts))[0] * s
    least = ROUNDING * eps * jnp.abs(line.slope).sum(1) + 4 * eps * jnp.abs(line.mean)
    Lr = Diagonal(jnp.maximum(jnp.where(acts, noise, 1.0)[None], least))
    line, widened = without_deficit(line, Lr)
    line = _silent(line, acts)
    innovation = jnp.where(acts, s * shift * reciprocal(taken, acts), 0.0)[None]
    observed = Observed(line, innovation, innovation, Lr, widened)
    done = considered(filter, model, S, observed, filter.form.correct(S, line, Lr, innovation))
    root = reset(model.space, x, done.shift, done.factor).factor
    new = model.space.add(x, done.shift)
    # What is known exactly must not contradict, but for rounding.
    off = jnp.maximum(jnp.maximum(low - y, y - high), 0.0)
    agrees = spread | (off <= ROUNDING * eps * (1 + jnp.abs(y)))
    finite = jnp.isfinite(y + s) & jnp.isfinite(new.sum(0) + root.sum((0, 1)))
    return jnp.where(acts, new, x), jnp.where(acts, root, S), agrees & finite & (done.sound | ~acts)


@lru_cache(maxsize=256)
def _row(function: Callable[..., Any], row: int) -> Callable[..., Any]:
    return lambda X: jnp.ravel(jnp.asarray(function(X)))[row : row + 1]


def _silent(line: Linearization, acts: jax.Array) -> Linearization:
    """The line without effect where a bound does not act."""
    return Linearization(line.mean, *(jnp.where(acts, M, 0) for M in line[1:]))


def truncated(low: Any, high: Any) -> tuple[jax.Array, jax.Array]:
    """Mean and variance of N(0, 1) between bounds (...), either of which may be infinite.

    By Gauss and Legendre on both sides of the mode, as far as the density reaches: to 1e-13, far out in a tail as well
    as between bounds that nearly meet.
    """
    mode = jnp.clip(jnp.zeros_like(low), low, high)
    far = 2 * _DEEP / (jnp.abs(mode) + jnp.sqrt(mode * mode + 2 * _DEEP))
    near = float(np.sqrt(2 * _DEEP))
    above = jnp.minimum(high - mode, jnp.where(mode < 0, near, far))
    below = jnp.minimum(mode - low, jnp.where(mode > 0, near, far))
    u, w = (static(a, jnp.broadcast_to(low, (len(_NODES), *jnp.shape(low)))) for a in ((1 + _NODES) / 2, _WEIGHTS / 2))
    steps = jnp.concatenate([u * above, -u * below])
    parts = jnp.concatenate([w * above, w * below]) * jnp.exp(-steps * (mode + steps / 2))
    # Of bounds that meet nothing is left to be weighed.
    whole = reciprocal(parts.sum(0), parts.sum(0) > 0)
    off = (parts * steps).sum(0) * whole
    return mode + off, (parts * (steps - off) ** 2).sum(0) * whole
