"""Half-steps of a bank of filters: split where the sensor bends, correct, merge. See `sigmax.bank`.

Every member is there in every step, those that nobody needs with the weight 0; these are not computed.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import cholesky
from sigmax.filters import Bank
from sigmax.mixtures.merging import LIGHT, merged
from sigmax.mixtures.mixture import (
    NEVER,
    MixtureBelief,
    innovation,
    least,
    of_all,
    picked,
    settled,
    weighed,
    where_any,
)
from sigmax.mixtures.splitting import Slot, bent, split, too_bent
from sigmax.modelling.evaluate import noise_root
from sigmax.modelling.model import Model
from sigmax.spaces import moments
from sigmax.steps import step
from sigmax.steps.step import Belief, Fault, Innovation


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

        def moved(b: Belief) -> tuple[Belief, Any]:
            return step.predict(self.bank.member, self.model, self.root, b, dt, u)

        first, fault = moved(belief.members[0])
        rest = [
            where_any(w > NEVER / 2, partial(moved, b), (b, fault))
            for b, w in zip(belief.members[1:], belief.log_weight[1:], strict=True)
        ]
        members, faults = zip((first, fault), *rest, strict=True)
        log_weight = [jnp.where(f <= 0, w, NEVER) for w, f in zip(belief.log_weight, faults, strict=True)]
        return settled(self._moments, belief, members, log_weight, _heeded(faults, belief.log_weight))

    def correct(
        self, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any
    ) -> tuple[MixtureBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...); the innovation is that of the mixture of predictions."""
        R = self.model.R[sensor] if R is None else R
        slots = bent(self.model, sensor, R, belief, z, u)

        def taken(slots: list[Slot]) -> tuple[list[Belief], list[Any], Innovation, Any]:
            return self._taken(sensor, R, slots, z, u)

        members, log_weight, said, fault = where_any(
            too_bent(self.bank, slots), lambda: taken(split(self.bank, self.model.space, slots)), taken(slots)
        )
        heard = ~jnp.isnan(said.residual).all(0)
        lost = Fault.CORRECTION_INDEFINITE
        new, fault = settled(self._moments, belief, members, log_weight, [fault], lost, heard)
        return new, said, fault

    def _taken(
        self, sensor: str, R: Any, slots: Sequence[Slot], z: Any, u: Any
    ) -> tuple[list[Belief], list[Any], Innovation, Any]:
        """Members after a measurement, as many as are kept, their weights, what it said, and the fault."""

        def corrected(b: Belief) -> tuple[Belief, Innovation, Any]:
            return step.correct(self.bank.member, self.model, sensor, R, b, z, u)

        before = [slot.log_weight for slot in slots]
        first, *rest = [slot.belief for slot in slots]
        done = [corrected(first)]
        for b, w in zip(rest, before[1:], strict=True):
            done.append(where_any(w > NEVER / 2, partial(corrected, b), (b, *done[0][1:])))
        said = innovation(self.model.measured_space(sensor, z.shape[0]), before, done)
        after, _, faults = zip(*done, strict=True)
        members, log_weight = merged(self.model.space, after, weighed(before, done), self.bank.kept)
        return members, log_weight, said, of_all(_heeded(faults, before))

    def _moments(self, members: Sequence[Belief], shares: Any) -> Belief:
        def several() -> Belief:
            return Belief(*moments(self.model.space, [b.mean for b in members], [b.factor for b in members], shares))

        return where_any((shares[1:] > 0).any(0), several, members[0])


def _heeded(faults: Sequence[Any], log_weight: Sequence[Any]) -> list[Any]:
    """The faults of members, those of members of little weight that of the heaviest: their own mean nothing."""
    heaviest = picked(least([-w for w in log_weight]), list(faults))
    return [jnp.where(w < math.log(LIGHT), heaviest, f) for f, w in zip(faults, log_weight, strict=True)]
