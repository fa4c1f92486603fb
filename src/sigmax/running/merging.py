"""Members of a mixture merged again, with the least loss (Runnalls 2007)."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from sigmax.algebra.arrays import diagonal, total
from sigmax.algebra.factor import reciprocal, square
from sigmax.running.mixture import chosen, least, log, normalised, picked
from sigmax.running.step import Belief
from sigmax.spaces import Space, moments

# A member of less than this probability is of no account.
LIGHT = 1e-12
# A pivot below this part of the widest deviation counts as 0.
_LEAST_PIVOT = 1e-6


class _Weighed(NamedTuple):
    """A member with its probability (...), its covariance P (n, n, ...) in some units, and the logarithm of √|P|."""

    belief: Belief
    weight: Any
    cov: Any
    log_volume: Any

    @classmethod
    def of(cls, belief: Belief, weight: Any, units: Any) -> "_Weighed":
        factor = belief.factor / units[:, None]
        return cls(belief, weight, square(factor), _log_volume(factor))


def merged(
    space: Space, members: Sequence[Belief], log_weight: Sequence[Any], kept: int
) -> tuple[list[Belief], list[Any]]:
    """As many members as are kept: the lightest joins that with which it loses least, again and again."""
    shares, _ = normalised(log_weight)
    # Deviations in units of the widest member, so that a pivot that counts as 0 does so in any units of the user's.
    widest = functools.reduce(jnp.maximum, (jnp.abs(b.factor).sum(1) for b in members))
    units = jnp.where(widest > 0, widest, 1)
    slots = [_Weighed.of(b, w, units) for b, w in zip(members, shares, strict=True)]
    while len(slots) > kept:
        which = least([s.weight for s in slots])
        lightest: _Weighed = picked(which, slots)
        # The last one takes its place.
        slots = [chosen(w, slots[-1], s) for w, s in zip(which, slots[:-1], strict=False)]
        which = least([_loss(space, lightest, s, units) for s in slots])
        joined = _joined(space, lightest, picked(which, slots), units)
        slots = [chosen(w, joined, s) for w, s in zip(which, slots, strict=True)]
    return [s.belief for s in slots], [log(s.weight) for s in slots]


def _joined(space: Space, one: _Weighed, other: _Weighed, units: Any) -> _Weighed:
    """Two members as one; the other to the last bit where the one is of no account."""
    weight = one.weight + other.weight
    share = one.weight * reciprocal(weight, weight > 0)
    pair = other.belief, one.belief
    shares = jnp.stack([1 - share, share])
    both = Belief(*moments(space, [b.mean for b in pair], [b.factor for b in pair], shares))
    return chosen(one.weight < LIGHT, other, _Weighed.of(both, weight, units))


def _loss(space: Space, one: _Weighed, other: _Weighed, units: Any) -> Any:
    """Runnalls' bound of what is lost by a merge, (w₁ + w₂) log|P₁₂| − w₁ log|P₁| − w₂ log|P₂|, halved.

    Covariances are taken as they are, each in its member's own tangent.
    """
    weight = one.weight + other.weight
    share = one.weight * reciprocal(weight, weight > 0)
    d = space.difference(one.belief.mean, other.belief.mean) / units
    P = other.cov + share * (one.cov - other.cov) + share * (1 - share) * (d[:, None] * d[None])
    return weight * _half_log_det(P) - one.weight * one.log_volume - other.weight * other.log_volume


def _half_log_det(P: Any) -> Any:
    """The logarithm of √|P| (...) of a covariance, pivots of 0 as in `_log_volume`."""
    pivots = []
    while len(P):
        pivots.append(jnp.maximum(P[0, 0], _LEAST_PIVOT**2))
        below = P[1:, 0]
        P = P[1:, 1:] - below[:, None] * below[None] * (1 / pivots[-1])
    return _log_product(pivots) / 2


def _log_volume(L: Any) -> Any:
    """The logarithm of |L| (...) of a triangle; pivots of 0 count alike everywhere."""
    return _log_product([jnp.maximum(pivot, _LEAST_PIVOT) for pivot in diagonal(L)])


def _log_product(factors: Sequence[Any]) -> Any:
    """The logarithm of a product; a few factors, no more than a float32 bears, share a logarithm."""
    few = [factors[k : k + 3] for k in range(0, len(factors), 3)]
    return total([jnp.log(math.prod(some[1:], start=some[0])) for some in few])
