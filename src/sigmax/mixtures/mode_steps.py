"""Half-steps of a model that switches between modes: each mode's filter, mixed before the motion (IMM).

Blom and Bar-Shalom 1988. A mode that does not have a component of another
takes it by its declared entry, and forgets it on leaving.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import diagonal, inner, times
from sigmax.algebra.factor import Diagonal, absorb, cholesky, identity, pivoted, solve_lower, tria
from sigmax.filters import Filter
from sigmax.mixtures.mixture import (
    NEVER,
    MixtureBelief,
    chosen,
    innovation,
    log,
    normalised,
    settled,
    weighed,
)
from sigmax.mixtures.mode_components import entered, returned, way
from sigmax.modelling.evaluate import noise_root
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.spaces import Space, moments
from sigmax.steps import step
from sigmax.steps.smooth_step import back
from sigmax.steps.step import Belief, Fault, Innovation

# A mode that is less probable may fail without the step being said to have failed.
_LITTLE = 1e-6


class ModeSteps:
    """The half-steps of filters on the modes of a model; pure functions that trace to plain operations.

    Args:
        filters: of the modes.
        model: the model.
    """

    def __init__(self, filters: Sequence[Filter], model: SwitchingModel) -> None:
        self.model, self.each = model, list(zip(filters, model.models, strict=True))
        self.roots = [noise_root(m.Q) for m in model.models]

    def begin(self, mean: Any, cov: Any) -> tuple[MixtureBelief, Any]:
        """The belief of a prior of all components, and whether it is one (...)."""
        factor, sound = cholesky(cov)
        modes = []
        for m in self.model.models:
            found = way(self.model, m)
            at = np.array(found.deviations)
            own = factor if found.straight else cholesky(cov[at][:, at])[0]
            modes.append(Belief(mean[np.array(found.points)], own))
        initial = jnp.asarray(self.model.initial, mean.dtype)
        log_weight = jnp.broadcast_to(log(initial).reshape(-1, *(1,) * (mean.ndim - 1)), (len(modes), *mean.shape[1:]))
        return MixtureBelief(mean, factor, tuple(modes), log_weight), sound

    def predict(self, belief: MixtureBelief, dt: Any, u: Any) -> tuple[MixtureBelief, Any]:
        """The belief dt later, and the fault (...) of each member of the batch."""
        change = log(self.model.transitions(dt))
        moved, faults, log_weight = [], [], []
        for i, ((filter, model), root) in enumerate(zip(self.each, self.roots, strict=True)):
            shares, total = normalised([w + change[j, i] for j, w in enumerate(belief.log_weight)])
            new, fault = step.predict(filter, model, root, self._mixed(belief.members, model, shares), dt, u)
            # A mode that failed stays as it was, and so does all where they all fail.
            moved.append(chosen(fault <= 0, new, belief.members[i]))
            faults.append(fault)
            log_weight.append(jnp.where(fault <= 0, total, NEVER))
        return settled(self._moments, belief, moved, log_weight, faults)

    def correct(
        self, sensor: str, R: Any, belief: MixtureBelief, z: Any, u: Any
    ) -> tuple[MixtureBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...); the innovation is that of the mixture of predictions."""
        done = [
            step.correct(f, m, sensor, m.R[sensor] if R is None else R, b, z, u)
            for (f, m), b in zip(self.each, belief.members, strict=True)
        ]
        said = innovation(self.model.measured_space(sensor, z.shape[0]), belief.log_weight, done)
        members, _, faults = zip(*done, strict=True)
        log_weight = weighed(belief.log_weight, done)
        new, fault = settled(self._moments, belief, members, log_weight, faults, Fault.CORRECTION_INDEFINITE)
        # To the last bit as it was where nothing was heard.
        return chosen(~jnp.isnan(said.residual).all(0), new, belief), said, fault

    def back(
        self, filtered: MixtureBelief, later: MixtureBelief, later_fault: Any, dt: Any, u: Any
    ) -> tuple[MixtureBelief, Any]:
        """The smoothed belief of a step, and its fault, from that of the step after it.

        What is heard later of the next mode is what its smoothed belief knows more than its predicted one: a likelihood
        by which each mode before is judged and from which it is smoothed on its own. Smoothing all of them from one
        smoothed belief, as Kim (1994) does, takes what two modes expected for one. What a mode has and the next has not
        follows by its regression on the rest. The work of two predictions and a smoothing for each of the M² pairs.
        """
        change = log(self.model.transitions(dt))
        none = jnp.zeros_like(later_fault)
        M = len(self.each)
        pairs: dict[tuple[int, int], Belief] = {}
        weights: dict[tuple[int, int], Any] = {}
        failed = none
        for i, ((filter, model), root) in enumerate(zip(self.each, self.roots, strict=True)):
            shares, _ = normalised([w + change[j, i] for j, w in enumerate(filtered.log_weight)])
            ahead, _ = step.predict(filter, model, root, self._mixed(filtered.members, model, shares), dt, u)
            heard = []
            for j in range(M):
                begun = self._entered(filtered.members[j], self.model.models[j], model)
                moved, fault = step.predict(filter, model, root, begun, dt, u)
                known, likelihood = _learnt(model.space, ahead, later.members[i], moved)
                heard.append(jnp.where(fault <= 0, log(shares[j]) + likelihood, NEVER))
                pair, fault = back(filter, model, root, begun, known, none, dt, u)
                pairs[j, i] = returned(self.model.models[j], model, filtered.members[j], Belief(*pair))
                failed = jnp.where((fault > 0) & (shares[j] > _LITTLE), fault, failed)
            shares, _ = normalised(heard)
            weights |= {(j, i): log(shares[j]) + later.log_weight[i] for j in range(M)}
        modes, log_weight = [], []
        for j, own in enumerate(self.model.models):
            shares, total = normalised([weights[j, i] for i in range(M)])
            both = [pairs[j, i] for i in range(M)]
            modes.append(Belief(*moments(own.space, [b.mean for b in both], [b.factor for b in both], shares)))
            log_weight.append(total)
        new, _ = settled(self._moments, filtered, modes, log_weight, [none] * M)
        # A step whose prediction failed left the belief as it was: its smoothed one is the next one's.
        unmoved = (later_fault > 0) & (later_fault <= Fault.PREDICTION_INDEFINITE)
        return chosen(unmoved, later, new), jnp.where(unmoved, 0, failed).astype(jnp.int8)

    def _moments(self, beliefs: Sequence[Belief], shares: Any) -> Belief:
        """The mixture of the modes' beliefs with the components of all."""
        return self._mixed(beliefs, self.model, shares)

    def _entered(self, belief: Belief, source: Model, onto: Model) -> Belief:
        """The belief of one mode with the components of another model."""
        mean, root = entered(belief, way(source, onto, self.model.entry))
        return belief if root is belief.factor else Belief(mean, tria(root))

    def _mixed(self, beliefs: Sequence[Belief], onto: Model, shares: Any) -> Belief:
        """The mixture of the modes' beliefs with the components of another model."""
        each = [
            entered(belief, way(own, onto, self.model.entry))
            for belief, own in zip(beliefs, self.model.models, strict=True)
        ]
        return Belief(*moments(onto.space, [mean for mean, _ in each], [root for _, root in each], shares))


def _learnt(space: Space, ahead: Belief, smoothed: Belief, moved: Belief) -> tuple[tuple[Any, Any], Any]:
    """Another prediction with what a smoothed belief knows more than its own prediction, and that one's log-likelihood.

    P_s⁻¹ − P⁻¹ = S_s⁻ᵀ V Vᵀ S_s⁻¹ with V Vᵀ = I − S_sᵀ P⁻¹ S_s, as a measurement Vᵀ S_s⁻¹ (x − x⁻) of noise I. Where a
    mixture is wider than what was predicted it knows nothing.
    """
    x, L = ahead
    delta = space.difference(smoothed.mean, x)
    root = pivoted(space.turned_back(x, delta, smoothed.factor))
    inside = solve_lower(pivoted(L), root)
    V, _ = cholesky(identity(root) - inner(inside, inside))
    knows = diagonal(V) > 0
    said = jnp.where(knows, solve_lower(pivoted(V), solve_lower(root, delta)), 0)
    away = space.difference(moved.mean, x)
    S = space.turned_back(x, away, moved.factor)
    seen = inner(V, solve_lower(root, jnp.concatenate([away[:, None], S], axis=1)))
    innovation = said - seen[:, 0]
    Sy, gain, rest = absorb(Diagonal(jnp.ones_like(said)), seen[:, 1:], S)
    whitened = solve_lower(Sy, innovation)
    shift = away + times(gain, whitened)
    likelihood = -0.5 * (whitened**2).sum(0) - jnp.log(diagonal(Sy)).sum(0)
    return (space.add(x, shift), space.turned(x, shift, rest)), likelihood
