"""Half-steps of a bank of filters: split where the sensor bends, correct, merge. See `sigmax.bank`.

Every member is there in every step, those that nobody needs with the weight 0: a step is one straight line.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from sigmax.algebra.arrays import diagonal, outer, times, total
from sigmax.algebra.factor import Diagonal, cholesky, raised, reciprocal, safe_sqrt, solve_lower, square, tria
from sigmax.filters import Bank
from sigmax.models.evaluate import noise_root, sensing, sensor_noise
from sigmax.models.model import Model
from sigmax.running import step
from sigmax.running.mixture import NEVER, MixtureBelief, chosen, innovation, log, normalised, settled, weighed
from sigmax.running.step import Belief, Fault, Innovation
from sigmax.running.updating import there
from sigmax.spaces import moments

# Nodes and weights of Gauss and Hermite along the direction of a split, each child narrower there by this.
_NARROWER = 0.55
_AWAY = math.sqrt(3 * (1 - _NARROWER**2))
_CENTRE, _SIDE = math.log(2 / 3), math.log(1 / 6)
# The curvature of a sensor is squared so often in looking for its leading direction.
_SQUARINGS = 3
# A member of less than this probability is of no account.
_LIGHT = 1e-12
# Below these a noise and a pivot count as 0.
_LEAST_NOISE, _LEAST_PIVOT = 1e-9, 1e-6


class _Slot(NamedTuple):
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


class _Weighed(NamedTuple):
    """A member with its probability (...), its covariance (n, n, ...), and the logarithm of √|P| (...)."""

    belief: Belief
    weight: Any
    cov: Any
    log_volume: Any

    @classmethod
    def of(cls, belief: Belief, weight: Any) -> "_Weighed":
        return cls(belief, weight, square(belief.factor), _log_volume(belief.factor))


class BankSteps:
    """The half-steps of a bank of filters on a model; pure functions that trace to plain operations.

    Args:
        bank: the filter.
        model: the model.
    """

    def __init__(self, bank: Bank, model: Model) -> None:
        self.bank, self.model, self.root = bank, model, noise_root(model.Q)

    def begin(self, mean: Any, cov: Any) -> tuple[MixtureBelief, Any]:
        """The belief of a prior, all of it with one member, and whether it is one (...)."""
        factor, sound = cholesky(cov)
        one = Belief(mean, factor)
        nothing = jnp.full_like(mean[0], NEVER)
        weights = jnp.stack([jnp.zeros_like(mean[0]), *(nothing for _ in range(self.bank.kept - 1))])
        return MixtureBelief(mean, factor, (one,) * self.bank.kept, weights), sound

    def predict(self, belief: MixtureBelief, dt: Any, u: Any) -> tuple[MixtureBelief, Any]:
        """The belief dt later, and the fault (...) of each member of the batch."""
        moved, faults = zip(
            *(step.predict(self.bank.one, self.model, self.root, b, dt, u) for b in belief.members), strict=True
        )
        log_weight = [jnp.where(f <= 0, w, NEVER) for w, f in zip(belief.log_weight, faults, strict=True)]
        return settled(self._moments, belief, moved, log_weight, _heeded(faults, belief.log_weight))

    def correct(
        self, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any
    ) -> tuple[MixtureBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...); the innovation is that of the mixture of predictions."""
        R = self.model.R[sensor] if R is None else R
        split = self._split(sensor, R, belief, z, u)
        before = [slot.log_weight for slot in split]
        done = [step.correct(self.bank.one, self.model, sensor, R, s.belief, z, u) for s in split]
        said = innovation(self.model.measured_space(sensor, z.shape[0]), before, done)
        after, _, faults = zip(*done, strict=True)
        members, log_weight = self._merged(after, weighed(before, done))
        new, fault = settled(
            self._moments, belief, members, log_weight, _heeded(faults, before), Fault.CORRECTION_INDEFINITE
        )
        # To the last bit as it was where nothing was heard.
        return chosen(~jnp.isnan(said.residual).all(0), new, belief), said, fault

    def _moments(self, members: Sequence[Belief], shares: Any) -> Belief:
        return Belief(*moments(self.model.space, [b.mean for b in members], [b.factor for b in members], shares))

    def _split(self, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any) -> list[_Slot]:
        """The members, and two more for each split; where there is no reason for one, these have the weight 0."""
        slots = []
        for member, log_weight in zip(belief.members, belief.log_weight, strict=True):
            curves = self._curves(sensor, R, member, z, u)
            slots.append(_Slot(member, log_weight, member.factor, curves, *_leading(curves)))
        for left in reversed(range(self.bank.splits)):
            worth = [jnp.where(s.bend > self.bank.bend, jnp.exp(s.log_weight) * s.bend, 0) for s in slots]
            which = _least([-w for w in worth])
            parent: _Slot = _picked(which, slots)
            children = self._children(parent, again=left > 0)
            slots = [chosen(w, children[0], slot) for w, slot in zip(which, slots, strict=True)] + children[1:]
        return slots

    def _children(self, parent: _Slot, again: bool) -> list[_Slot]:
        """Three members of one with its mean and covariance; the parent alone where it does not bend enough.

        `again` says whether they may be split as well.
        """
        space, x, d = self.model.space, parent.belief.mean, parent.direction
        split = parent.bend > self.bank.bend
        less = jnp.where(split, 1 - _NARROWER, 0)
        along = times(parent.root, d)
        # A root times I − less d dᵀ, and the curves along its columns.
        root = parent.root - less * along[:, None] * d[None]
        factor = jnp.where(split, tria(root), parent.belief.factor)
        curves, direction, bend = parent.curves, d, parent.bend
        if again:
            curves = jnp.stack([_along_narrower(H, less, d) for H in curves])
            direction, bend = _leading(curves)
        children = []
        for a, share in ((0.0, _CENTRE), (-_AWAY, _SIDE), (_AWAY, _SIDE)):
            shift = jnp.where(split, a * along, 0)
            belief = Belief(space.add(x, shift), space.turned(x, shift, factor)) if a else Belief(x, factor)
            log_weight = jnp.where(split, parent.log_weight + share, parent.log_weight if a == 0 else NEVER)
            children.append(_Slot(belief, log_weight, space.turned(x, shift, root), curves, direction, bend))
        return children

    def _curves(self, sensor: str, R: Any, member: Belief, z: Any, u: Any) -> Any:
        """Second differences (m, n, n, ...) of a sensor along the columns of a factor, in deviations of its noise."""
        (x, S), space, onto = member, self.model.space, self.model.measured_space(sensor, z.shape[0])
        n = S.shape[1]
        pairs = [(i, j) for i in range(n) for j in range(i + 1)]
        away = [S[:, i] if i == j else S[:, i] + S[:, j] for i, j in pairs]
        points = jnp.stack([space.add(x, sign * v) for sign in (1, -1) for v in away] + [x], axis=1)
        seen_at = sensing(self.model, sensor, x, u)(points)
        off = [onto.difference(seen_at[:, k], seen_at[:, -1]) for k in range(2 * len(pairs))]
        both = {pair: off[k] + off[k + len(pairs)] for k, pair in enumerate(pairs)}
        rows = [[_mixed(both, max(i, j), min(i, j)) for j in range(n)] for i in range(n)]
        curves = jnp.stack([jnp.stack(row, axis=1) for row in rows], axis=1)
        _, seen = there(onto, z)
        curves = jnp.where(seen[:, None, None] & jnp.isfinite(curves), curves, 0)
        noise, _ = sensor_noise(self.model, R, x, u, seen)
        # A sensor without noise bends as much as one can.
        noise = raised(noise, _LEAST_NOISE * (1 + jnp.abs(curves).sum((1, 2))))
        flat = curves.reshape(len(curves), n * n, *curves.shape[3:])
        whitened = flat / noise.entries[:, None] if isinstance(noise, Diagonal) else solve_lower(noise, flat)
        return whitened.reshape(curves.shape)

    def _merged(self, members: Sequence[Belief], log_weight: Sequence[Any]) -> tuple[list[Belief], list[Any]]:
        """As many members as are kept: the lightest joins that with which it loses least, again and again."""
        shares, _ = normalised(log_weight)
        slots = [_Weighed.of(b, w) for b, w in zip(members, shares, strict=True)]
        while len(slots) > self.bank.kept:
            which = _least([s.weight for s in slots])
            lightest: _Weighed = _picked(which, slots)
            # The last one takes its place.
            slots = [chosen(w, slots[-1], s) for w, s in zip(which, slots[:-1], strict=False)]
            which = _least([self._loss(lightest, s) for s in slots])
            joined = self._joined(lightest, _picked(which, slots))
            slots = [chosen(w, joined, s) for w, s in zip(which, slots, strict=True)]
        return [s.belief for s in slots], [log(s.weight) for s in slots]

    def _joined(self, one: _Weighed, other: _Weighed) -> _Weighed:
        """Two members as one; the other to the last bit where the one is of no account."""
        weight = one.weight + other.weight
        share = one.weight * reciprocal(weight, weight > 0)
        both = self._moments([other.belief, one.belief], jnp.stack([1 - share, share]))
        return chosen(one.weight < _LIGHT, other, _Weighed.of(both, weight))

    def _loss(self, one: _Weighed, other: _Weighed) -> Any:
        """Runnalls' bound of what is lost by a merge, (w₁ + w₂) log|P₁₂| − w₁ log|P₁| − w₂ log|P₂|, halved.

        Covariances are taken as they are, each in its member's own tangent.
        """
        weight = one.weight + other.weight
        share = one.weight * reciprocal(weight, weight > 0)
        d = self.model.space.difference(one.belief.mean, other.belief.mean)
        P = other.cov + share * (one.cov - other.cov) + share * (1 - share) * (d[:, None] * d[None])
        return weight * _half_log_det(P) - one.weight * one.log_volume - other.weight * other.log_volume


def _mixed(both: dict[tuple[int, int], Any], i: int, j: int) -> Any:
    """The second difference of two columns from those along each and along their sum."""
    return both[i, i] if i == j else (both[i, j] - both[i, i] - both[j, j]) / 2


def _along_narrower(H: Any, less: Any, d: Any) -> Any:
    """(I − less d dᵀ) H (I − less d dᵀ) for a symmetric H (n, n, ...) and a direction of unit length."""
    h = times(H, d)
    half = less * (h - (less / 2) * (d * h).sum(0) * d)
    return H - (half[:, None] * d[None] + d[:, None] * half[None])


def _leading(curves: Any) -> tuple[Any, Any]:
    """The direction (n, ...) of greatest curvature over all measurements, and the departure (...) from a line in it.

    The leading eigenvector of Σ H², by squaring, and the length of dᵀ H d over the measurements, divided by √2.
    """
    A = total([outer(H, H) for H in curves])
    for _ in range(_SQUARINGS):
        A = outer(A, A)
        size = diagonal(A).sum(0)
        A = A / jnp.where(size > 0, size, 1)
    most = _least([-a for a in diagonal(A)])
    d = _picked(most, list(A))
    length, some = safe_sqrt((d * d).sum(0))
    d = d * reciprocal(length, some)
    bends = jnp.stack([(d * times(H, d)).sum(0) for H in curves])
    return d, safe_sqrt((bends * bends).sum(0) / 2)[0]


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


def _least(values: Sequence[Any]) -> list[Any]:
    """Which of some values (...) is the least, the first of equals: a truth value for each."""
    least, at = values[0], jnp.zeros(values[0].shape, int)
    for k, value in enumerate(values[1:], 1):
        at, least = jnp.where(value < least, k, at), jnp.minimum(value, least)
    return [at == k for k in range(len(values))]


def _picked(which: Sequence[Any], among: Sequence[Any]) -> Any:
    """The one of some that is marked."""
    found = among[0]
    for mark, one in zip(which[1:], among[1:], strict=True):
        found = chosen(mark, one, found)
    return found


def _heeded(faults: Sequence[Any], log_weight: Sequence[Any]) -> list[Any]:
    """The faults of members, those of members of little weight that of the heaviest: their own mean nothing."""
    heaviest = _picked(_least([-w for w in log_weight]), list(faults))
    return [jnp.where(w < math.log(_LIGHT), heaviest, f) for f, w in zip(faults, log_weight, strict=True)]
