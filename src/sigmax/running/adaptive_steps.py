"""Half-steps of a filter that finds noises as it goes: what it knows of them is part of its belief."""

from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import cholesky
from sigmax.filters import Filter
from sigmax.models.evaluate import noise_root
from sigmax.models.model import Model
from sigmax.running import smooth_step, step
from sigmax.running.adapting import Adapted, adapted_noises
from sigmax.running.step import Belief, Innovation


class AdaptiveSteps:
    """The half-steps of an adaptive filter on a model; pure functions that trace to plain operations."""

    def __init__(self, filter: Filter, model: Model) -> None:
        self.filter, self.model, self.root = filter, model, noise_root(model.Q)
        self.noises = adapted_noises(filter, model)

    def begin(self, mean: Any, cov: Any) -> tuple[Adapted, Any]:
        """The belief of a prior, noises as the model has them, and whether it is one (...)."""
        factor, sound = cholesky(cov)
        return Adapted(mean, factor, jnp.ones((self.noises.size, *mean.shape[1:]), mean.dtype)), sound

    def predict(self, belief: Adapted, dt: Any, u: Any) -> tuple[Adapted, Any]:
        """The belief dt later, and the fault (...) of each member of the batch."""
        new, fault = step.predict(self.filter, self.model, self.root, Belief(*belief[:2]), dt, u)
        return Adapted(*new, belief.known), fault

    def correct(self, sensor: str, R: Any, belief: Adapted, z: Any, u: Any) -> tuple[Adapted, Innovation, Any]:
        """The belief after a measurement z (m, ...), what it said, and the fault."""
        R, at = self.model.R[sensor] if R is None else R, self.noises.of(sensor)
        before = None if at is None else belief.known[at]
        done = step.corrected(self.filter, self.model, sensor, R, Belief(*belief[:2]), z, u, before)
        known = belief.known if at is None else jnp.concatenate([belief.known[: at.start], done.scale, belief.known[at.stop :]])
        return Adapted(*done.belief, known), done.innovation, done.fault

    def back(self, filtered: Adapted, later: Adapted, later_fault: Any, dt: Any, u: Any) -> tuple[Adapted, Any]:
        """The smoothed belief of a step, and its fault; what is known of noises stays what the filter knew."""
        now, ahead = Belief(*filtered[:2]), Belief(*later[:2])
        new, failed = smooth_step.back(self.filter, self.model, self.root, now, ahead, later_fault, dt, u)
        return Adapted(*new, filtered.known), failed
