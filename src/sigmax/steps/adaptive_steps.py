"""Half-steps of a filter that finds noises as it goes: what it knows of them is part of its belief."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import cholesky
from sigmax.filters import Filter
from sigmax.modelling.evaluate import noise_root
from sigmax.modelling.model import Model
from sigmax.steps import smooth_step, step
from sigmax.steps.adaptive_noises import AdaptiveBelief, adapted_noises
from sigmax.steps.noise_estimation import QScale, Slope, estimate_Q
from sigmax.steps.step import Belief, Innovation


class AdaptiveSteps:
    """The half-steps of an adaptive filter on a model; pure functions that trace to plain operations.

    Args:
        filter: the filter.
        model: the model.
    """

    def __init__(self, filter: Filter, model: Model) -> None:
        self.filter, self.model, self.root = filter, model, noise_root(model.Q)
        self.noises = adapted_noises(filter, model)
        self._memory = math.inf if filter.Q is None else filter.Q.memory

    def begin(self, mean: Any, cov: Any) -> tuple[AdaptiveBelief, Any]:
        """The belief of a prior, noises as the model has them, and whether it is one (...)."""
        factor, sound = cholesky(cov)
        batch = mean.shape[1:]
        scales = jnp.ones((self.noises.first, *batch), mean.dtype)
        of_Q = jnp.zeros((self.noises.size - self.noises.first, *batch), mean.dtype)
        return AdaptiveBelief(mean, factor, jnp.concatenate([scales, of_Q])), sound

    def predict(self, belief: AdaptiveBelief, dt: Any, u: Any) -> tuple[AdaptiveBelief, Any]:
        """The belief dt later, and the fault (...) of each member of the batch."""
        found = self._found(belief.known)

        def moved(now: Belief, logarithms: Any) -> tuple[Belief, Any]:
            return step.predict(self.filter, self.model, self.root, now, dt, u, self._stretch(logarithms))

        logarithms = [f.logarithm for f in found]
        new, fault, slopes = _with_slopes(moved, Belief(*belief[:2]), logarithms, found)
        known = [f._replace(mean=s.mean, factor=s.factor) for f, s in zip(found, slopes, strict=True)]
        return AdaptiveBelief(new.mean, new.factor, self._known(belief.known, known)), fault

    def correct(
        self, sensor: str, R: Any, belief: AdaptiveBelief, z: Any, u: Any
    ) -> tuple[AdaptiveBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...), what it said, and the fault."""
        R, at = self.model.R[sensor] if R is None else R, self.noises.of(sensor)
        before, found = None if at is None else belief.known[at], self._found(belief.known)

        def corrected(now: Belief, _: Any) -> tuple[Any, Any]:
            done = step.corrected(self.filter, self.model, sensor, R, now, z, u, before)
            said = done.innovation
            told = Slope(said.residual, said.factor, said.log_likelihood)
            return (done.belief, told), (said, done.fault, done.scale)

        made, (said, fault, after), slopes = _with_slopes(corrected, Belief(*belief[:2]), [], found)
        new, known = made[0], []
        for f, (moved, told) in zip(found, slopes, strict=True):
            logarithm, information = estimate_Q(f, self._memory, said, told, said.dof > 0)
            known.append(QScale(logarithm, information, moved.mean, moved.factor))
        kept = (
            belief.known if at is None else jnp.concatenate([belief.known[: at.start], after, belief.known[at.stop :]])
        )
        return AdaptiveBelief(new.mean, new.factor, self._known(kept, known)), said, fault

    def back(
        self, filtered: AdaptiveBelief, later: AdaptiveBelief, later_fault: Any, dt: Any, u: Any
    ) -> tuple[AdaptiveBelief, Any]:
        """The smoothed belief of a step, and its fault; what is known of noises stays what the filter knew."""
        now, ahead = Belief(*filtered[:2]), Belief(*later[:2])
        stretch = self._stretch([f.logarithm for f in self._found(filtered.known)])
        new, failed = smooth_step.back(self.filter, self.model, self.root, now, ahead, later_fault, dt, u, stretch)
        return AdaptiveBelief(*new, filtered.known), failed

    def _found(self, known: Any) -> list[QScale]:
        """What is known of each group of Q."""
        noises, found = self.noises, []
        i, j = np.tril_indices(noises.n)
        for at in noises.logarithms:
            mean, lower = known[at + 2 : at + 2 + noises.points], known[at + 2 + noises.points : at + noises.each]
            factor = jnp.zeros((noises.n, noises.n, *known.shape[1:]), known.dtype).at[i, j].set(lower)
            found.append(QScale(known[at], known[at + 1], mean, factor))
        return found

    def _known(self, known: Any, found: list[QScale]) -> Any:
        """What is known of noises, with other numbers of the groups of Q."""
        lower = np.tril_indices(self.noises.n)
        parts = [a for f in found for a in (f.logarithm[None], f.information[None], f.mean, f.factor[lower])]
        return jnp.concatenate([known[: self.noises.first], *parts]) if found else known

    def _stretch(self, logarithms: list[Any]) -> Any:
        """By what the rows of the factor of Q are multiplied (n, ...); None where it is the model's."""
        if not logarithms:
            return None
        rows = [jnp.ones_like(logarithms[0])] * self.noises.n
        for group, logarithm in zip(self.noises.groups, logarithms, strict=True):
            for row in group:
                rows[row] = jnp.exp(logarithm / 2)
        return jnp.stack(rows)


def _with_slopes(function: Callable[..., Any], belief: Belief, logarithms: list[Any], found: list[QScale]) -> Any:
    """What a function of a belief and of logarithms gives, what goes with it, and its derivative by each of these."""
    if not found:
        return *function(belief, logarithms), []
    slopes = []
    for k, own in enumerate(found):
        along = [jnp.ones_like(a) if i == k else jnp.zeros_like(a) for i, a in enumerate(logarithms)]
        tangents = Belief(own.mean, own.factor), along
        made, slope, beside = jax.jvp(function, (belief, logarithms), tangents, has_aux=True)
        slopes.append(jax.tree.map(lambda a: jnp.where(jnp.isfinite(a), a, 0), slope))
    return made, beside, slopes
