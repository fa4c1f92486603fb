"""Members of a bank split where a sensor bends within them. See `sigmax.bank`."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import diagonal, outer, times, total
from sigmax.algebra.factor import Diagonal, raised, reciprocal, safe_sqrt, solve_lower, tria
from sigmax.dependence import reading
from sigmax.filters import Bank
from sigmax.mixtures.mixture import NEVER, MixtureBelief, chosen, least, picked, where_any
from sigmax.modelling.evaluate import sensing, sensor_noise
from sigmax.modelling.model import Model
from sigmax.spaces import Space
from sigmax.steps.step import Belief
from sigmax.steps.updating import there

# Nodes and weights of Gauss and Hermite along the direction of a split, each child narrower there by this.
_NARROWER = 0.55
_LESS = 1 - _NARROWER
_AWAY = math.sqrt(3 * (1 - _NARROWER**2))
_CENTRE, _SIDE = math.log(2 / 3), math.log(1 / 6)
# The curvature of a sensor is squared so often in looking for its leading direction.
_SQUARINGS = 3
# A sensor with less noise than this part of its curvature bends as much as one can.
LEAST_NOISE = 1e-9


class Slot(NamedTuple):
    """A member while a measurement is taken.

    Attributes:
        belief: its mean and lower factor.
        log_weight: logarithm of its probability (...).
        root: a root of its covariance, not triangular (n, n, ...).
        curves: second differences of the sensor along the columns of the root (m, n, n, ...), in deviations of its
            noise.
        direction: of unit length, in which it bends most (n, ...).
        bend: what it departs from its line in that direction (...).
    """

    belief: Belief
    log_weight: Any
    root: Any
    curves: Any
    direction: Any
    bend: Any


def bent(model: Model, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any) -> list[Slot]:
    """The members with what a sensor bends within each."""

    def found(member: Belief) -> tuple[Any, Any, Any]:
        curves = _curves(model, sensor, R, member, z, u)
        return curves, *_leading(curves)

    first, *rest = belief.members
    of = [found(first)]
    for member, log_weight in zip(rest, belief.log_weight[1:], strict=True):
        straight = jax.tree.map(jnp.zeros_like, of[0])
        of.append(where_any(log_weight > NEVER / 2, partial(found, member), straight))
    return [Slot(b, w, b.factor, *how) for b, w, how in zip(belief.members, belief.log_weight, of, strict=True)]


def too_bent(bank: Bank, slots: Sequence[Slot]) -> Any:
    """Whether a member is to be split (...)."""
    return jnp.stack(_worth(bank, slots)).max(0) > 0


def split(bank: Bank, space: Space, slots: list[Slot]) -> list[Slot]:
    """Members, of which one is to be split, and two more for each split; unneeded ones have the weight 0."""
    slots = _split_once(bank, space, slots, again=bank.splits > 1)
    for left in reversed(range(bank.splits - 1)):
        free = slots[0]._replace(log_weight=jnp.full_like(slots[0].log_weight, NEVER))
        some = partial(_split_once, bank, space, slots, again=left > 0)
        slots = where_any(too_bent(bank, slots), some, [*slots, free, free])
    return slots


def _worth(bank: Bank, slots: Sequence[Slot]) -> list[Any]:
    return [jnp.where(s.bend > bank.bend, jnp.exp(s.log_weight) * s.bend, 0) for s in slots]


def _split_once(bank: Bank, space: Space, slots: Sequence[Slot], again: bool) -> list[Slot]:
    """The member of greatest weight and bend becomes three; `again` says whether they may be split as well."""
    which = least([-w for w in _worth(bank, slots)])
    children = _children(space, picked(which, slots), again)
    return [chosen(w, children[0], slot) for w, slot in zip(which, slots, strict=True)] + children[1:]


def _children(space: Space, parent: Slot, again: bool) -> list[Slot]:
    """Three members of one with its mean and covariance."""
    x, d = parent.belief.mean, parent.direction
    along = times(parent.root, d)
    # A root times I − less d dᵀ, and the curves along its columns.
    root = parent.root - _LESS * along[:, None] * d[None]
    factor = tria(root)
    curves, direction, bend = parent.curves, d, parent.bend
    if again:
        curves = jnp.stack([_along_narrower(H, d) for H in curves])
        direction, bend = _leading(curves)
    children = []
    for a, share in ((0.0, _CENTRE), (-_AWAY, _SIDE), (_AWAY, _SIDE)):
        shift = a * along
        belief = Belief(space.add(x, shift), space.turned(x, shift, factor)) if a else Belief(x, factor)
        turned = space.turned(x, shift, root) if a else root
        children.append(Slot(belief, parent.log_weight + share, turned, curves, direction, bend))
    return children


def _curves(model: Model, sensor: str, R: Any, member: Belief, z: Any, u: Any) -> Any:
    """Second differences (m, n, n, ...) of a sensor along the columns of a factor, in deviations of its noise."""
    (x, S), space, onto = member, model.space, model.measured_space(sensor, z.shape[0])
    h, n = sensing(model, sensor, x, u), S.shape[1]
    # The factor is a triangle: columns behind the last component in which the sensor bends do not move it.
    some = reading(h.function, len(x), h.single, x.dtype).nonlinear.bit_length() if space.flat else n
    if some == 0:
        return jnp.zeros((z.shape[0], n, n, *x.shape[1:]), x.dtype)
    pairs = [(i, j) for i in range(some) for j in range(i + 1)]
    away = [S[:, i] if i == j else S[:, i] + S[:, j] for i, j in pairs]
    points = jnp.stack([space.add(x, sign * v) for sign in (1, -1) for v in away] + [x], axis=1)
    seen_at = h(points)
    off = [onto.difference(seen_at[:, k], seen_at[:, -1]) for k in range(2 * len(pairs))]
    both = {pair: off[k] + off[k + len(pairs)] for k, pair in enumerate(pairs)}
    rows = [[_mixed(both, max(i, j), min(i, j)) for j in range(some)] for i in range(some)]
    curves = jnp.stack([jnp.stack(row, axis=1) for row in rows], axis=1)
    _, seen = there(onto, z)
    curves = jnp.where(seen[:, None, None] & jnp.isfinite(curves), curves, 0)
    noise, _ = sensor_noise(model, R, x, u, seen)
    # A sensor without noise bends as much as one can.
    size = jnp.abs(curves).sum((1, 2))
    noise = raised(noise, jnp.where(size > 0, LEAST_NOISE * size, 1))
    flat = curves.reshape(len(curves), some * some, *curves.shape[3:])
    whitened = flat / noise.entries[:, None] if isinstance(noise, Diagonal) else solve_lower(noise, flat)
    rest = (0, n - some)
    return jnp.pad(whitened.reshape(curves.shape), ((0, 0), rest, rest, *((0, 0) for _ in curves.shape[3:])))


def _mixed(both: dict[tuple[int, int], Any], i: int, j: int) -> Any:
    """The second difference of two columns from those along each and along their sum."""
    return both[i, i] if i == j else (both[i, j] - both[i, i] - both[j, j]) / 2


def _along_narrower(H: Any, d: Any) -> Any:
    """(I − less d dᵀ) H (I − less d dᵀ) for a symmetric H (n, n, ...) and a direction of unit length."""
    h = times(H, d)
    half = _LESS * (h - (_LESS / 2) * (d * h).sum(0) * d)
    return H - (half[:, None] * d[None] + d[:, None] * half[None])


def _leading(curves: Any) -> tuple[Any, Any]:
    """The direction (n, ...) of greatest curvature over all measurements, and the departure (...) from a line in it.

    The leading eigenvector of Σ H², by squaring, and the length of dᵀ H d over the measurements, divided by √2.
    """
    A = total([outer(H, H) for H in curves])
    for _ in range(_SQUARINGS):
        size = diagonal(A).sum(0)
        A = A / jnp.where(size > 0, size, 1)
        A = outer(A, A)
    most = least([-a for a in diagonal(A)])
    d = picked(most, list(A))
    length, some = safe_sqrt((d * d).sum(0))
    d = d * reciprocal(length, some)
    bends = jnp.stack([(d * times(H, d)).sum(0) for H in curves])
    return d, safe_sqrt((bends * bends).sum(0) / 2)[0]
