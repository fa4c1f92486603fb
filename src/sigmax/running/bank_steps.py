"""Half-steps of a bank of filters: split where the sensor bends, correct, merge. See `sigmax.bank`.

Every member is there in every step, those that nobody needs with the weight 0: a step is one straight line.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import cholesky
from sigmax.filters import Bank
from sigmax.models.evaluate import noise_root
from sigmax.models.model import Model
from sigmax.running import step
from sigmax.running.merging import LIGHT, merged
from sigmax.running.mixture import NEVER, MixtureBelief, chosen, innovation, least, picked, settled, weighed
from sigmax.running.splitting import split
from sigmax.running.step import Belief, Fault, Innovation
from sigmax.spaces import moments


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
            *(step.predict(self.bank.member, self.model, self.root, b, dt, u) for b in belief.members), strict=True
        )
        log_weight = [jnp.where(f <= 0, w, NEVER) for w, f in zip(belief.log_weight, faults, strict=True)]
        return settled(self._moments, belief, moved, log_weight, _heeded(faults, belief.log_weight))

    def correct(
        self, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any
    ) -> tuple[MixtureBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...); the innovation is that of the mixture of predictions."""
        R = self.model.R[sensor] if R is None else R
        slots = split(self.bank, self.model, sensor, R, belief, z, u)
        before = [slot.log_weight for slot in slots]
        done = [step.correct(self.bank.member, self.model, sensor, R, s.belief, z, u) for s in slots]
        said = innovation(self.model.measured_space(sensor, z.shape[0]), before, done)
        after, _, faults = zip(*done, strict=True)
        members, log_weight = merged(self.model.space, after, weighed(before, done), self.bank.kept)
        new, fault = settled(
            self._moments, belief, members, log_weight, _heeded(faults, before), Fault.CORRECTION_INDEFINITE
        )
        # To the last bit as it was where nothing was heard.
        return chosen(~jnp.isnan(said.residual).all(0), new, belief), said, fault

    def _moments(self, members: Sequence[Belief], shares: Any) -> Belief:
        return Belief(*moments(self.model.space, [b.mean for b in members], [b.factor for b in members], shares))


def _heeded(faults: Sequence[Any], log_weight: Sequence[Any]) -> list[Any]:
    """The faults of members, those of members of little weight that of the heaviest: their own mean nothing."""
    heaviest = picked(least([-w for w in log_weight]), list(faults))
    return [jnp.where(w < math.log(LIGHT), heaviest, f) for f, w in zip(faults, log_weight, strict=True)]
