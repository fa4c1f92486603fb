"""Members of a mixture merged again, with the least loss (Runnalls 2007)."""

import functools
import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp

from sigmax.algebra.arrays import diagonal, total
from sigmax.algebra.factor import reciprocal, square
from sigmax.mixtures.mixture import chosen, least, log, normalised, picked, where_any
from sigmax.spaces import Space, moments
from sigmax.steps.step import Belief

# A member of less than this probability is of no account.
LIGHT = 1e-12
# What merges without need may lose, as a divergence in nats, shared out to those that are kept.
_LITTLE = 0.03
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
    """As many members as are kept: the lightest joins that with which it loses least, again and again.

    Where next to nothing is lost it does so further on, and the last of what is kept have the weight 0.
    """
    shares, _ = normalised(log_weight)
    # Deviations in units of the widest member, so that a pivot that counts as 0 does so in any units of the user's.
    widest = functools.reduce(jnp.maximum, (jnp.abs(b.factor).sum(1) for b in members))
    units = jnp.where(widest > 0, widest, 1)
    slots = []
    for b, w in zip(members, shares, strict=True):
        nobody = _Weighed(b, w, jnp.zeros_like(b.factor), jnp.zeros_like(w))
        slots.append(where_any(w > 0, partial(_Weighed.of, b, w, units), nobody))
    while len(slots) > kept:
        # Where the last one is of no weight it goes as it is.
        slots = where_any(slots[-1].weight > 0, partial(_fewer, space, slots, units), slots[:-1])
    for count in range(kept, 1, -1):
        some, gone = slots[:count], slots[count:]
        left = some[-1].weight > 0
        left = left & (gone[0].weight == 0) if gone else left
        slots = where_any(left, partial(_alike_joined, space, some, units, _LITTLE / kept), some) + gone
    return [s.belief for s in slots], [log(s.weight) for s in slots]


def _fewer(space: Space, slots: Sequence[_Weighed], units: Any) -> list[_Weighed]:
    """One less: the lightest joins that with which it loses least."""
    lightest, which, rest, _ = _lightest(space, slots, units)
    return _joint(space, units, lightest, which, rest)


def _alike_joined(space: Space, slots: Sequence[_Weighed], units: Any, most: float) -> list[_Weighed]:
    """As many, the last of the weight 0 where the lightest has joined another and less than `most` was lost."""
    lightest, which, rest, loss = _lightest(space, slots, units)

    def joined() -> list[_Weighed]:
        return [*_joint(space, units, lightest, which, rest), slots[-1]._replace(weight=jnp.zeros_like(loss))]

    return where_any(loss < most, joined, list(slots))


def _lightest(space: Space, slots: Sequence[_Weighed], units: Any) -> tuple[_Weighed, list[Any], list[_Weighed], Any]:
    """The lightest, which of the others it is to join, these with the last in its place, and what is lost."""
    which = least([s.weight for s in slots])
    lightest: _Weighed = picked(which, slots)
    rest = [chosen(w, slots[-1], s) for w, s in zip(which, slots[:-1], strict=False)]
    losses = [_loss(space, lightest, s, units) for s in rest]
    nearest = least(losses)
    return lightest, nearest, rest, picked(nearest, losses)


def _joint(
    space: Space, units: Any, lightest: _Weighed, which: Sequence[Any], rest: Sequence[_Weighed]
) -> list[_Weighed]:
    both = _joined(space, lightest, picked(which, rest), units)
    return [chosen(w, both, s) for w, s in zip(which, rest, strict=True)]


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
