"""The state of a live filter on XLA."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.compiling import compiled
from sigmax.algebra.factor import cholesky
from sigmax.filters import Filter
from sigmax.models.evaluate import noise_root
from sigmax.models.model import Model
from sigmax.models.opaque import failures_raised
from sigmax.running.covariances import covariances
from sigmax.running.scanned import batch_first, batch_last
from sigmax.running.step import Belief, Innovation, correct, later, predict


class XlaState:
    """A belief, batch last, and the compiled half-steps that move it on."""

    # See `LaneState`.
    whole: Mapping[str | None, Any] = {}

    def __init__(self, filter: Filter, model: Model, belief: Belief) -> None:
        self.filter, self.model = filter, model
        self.belief = jax.tree.map(jnp.asarray, belief)
        self.fault: Any = np.zeros(belief.mean.shape[1:], np.int8)
        # Flattened once: the model is the same in every call, and walking it would cost more than the step.
        self._leaves, structure = jax.tree.flatten(model)
        self._predict, self._update, self._step = half_steps(filter, structure)

    @classmethod
    def of_prior(cls, filter: Filter, model: Model, mean: np.ndarray, cov: np.ndarray) -> "XlaState":
        """The state of a prior (n,) or (B, n), with a covariance for all or one for each."""
        cov = np.broadcast_to(cov, (*mean.shape[:-1], *cov.shape[-2:]))
        return cls(filter, model, begun(batch_last(mean, 1), batch_last(cov, 2)))

    def read_mean(self) -> np.ndarray:
        """(n,) or (B, n)."""
        return np.asarray(self.belief.mean).T

    @property
    def factor(self) -> np.ndarray:
        """(n, n) or (B, n, n)."""
        S = np.asarray(self.belief.factor)
        return np.moveaxis(S, -1, 0) if S.ndim == 3 else S

    def read_cov(self) -> np.ndarray:
        """(n, n) or (B, n, n)."""
        made: np.ndarray = covariances(self.factor)
        return made

    def predict(self, dt: float, u: np.ndarray | None) -> None:
        """Move on."""
        with failures_raised():
            out = self._predict(self._leaves, self.belief, self._cast(dt), self._laid(u))
        self.belief, self.fault = out

    def update(self, sensor: str, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Correct."""
        with failures_raised():
            out = self._update(self._leaves, self.belief, sensor, z.T, R, self._laid(u))
        self.belief, told, self.fault = out
        return self._told(told)

    def step(self, sensor: str, dt: float, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Move on and correct."""
        with failures_raised():
            out = self._step(self._leaves, self.belief, sensor, self._cast(dt), z.T, R, self._laid(u))
        self.belief, told, self.fault = out
        return self._told(told)

    def _cast(self, dt: float) -> np.ndarray:
        return np.asarray(dt, self.belief.mean.dtype)

    def _laid(self, u: np.ndarray | None) -> Any:
        return u.T if u is not None and u.ndim == 2 else u

    def _told(self, told: Innovation) -> Innovation:
        laid = map(batch_first, told) if self.belief.mean.ndim == 2 else told
        return Innovation(*map(np.asarray, laid))


@jax.jit
def begun(mean: Any, cov: Any) -> Belief:
    """The belief of a prior (n,) and (n, n), or batch last."""
    return Belief(mean, cholesky(cov)[0])


@lru_cache(maxsize=128)
def half_steps(filter: Filter, structure: Any) -> tuple[Any, Any, Any]:
    """The compiled half-steps and the whole step of a filter on models of one structure; R is None or numbers."""

    def move(leaves: Any, belief: Belief, dt: Any, u: Any) -> tuple[Belief, Any]:
        model = jax.tree.unflatten(structure, leaves)
        return predict(filter, model, noise_root(model.Q), belief, dt, u)

    def see(leaves: Any, belief: Belief, sensor: str, z: Any, R: Any, u: Any) -> tuple[Belief, Innovation, Any]:
        model = jax.tree.unflatten(structure, leaves)
        return correct(filter, model, sensor, model.R[sensor] if R is None else R, belief, z, u)

    def both(
        leaves: Any, belief: Belief, sensor: str, dt: Any, z: Any, R: Any, u: Any
    ) -> tuple[Belief, Innovation, Any]:
        moved, fault = move(leaves, belief, dt, u)
        belief, told, failed = see(leaves, moved, sensor, jnp.where(fault <= 0, z, jnp.nan), R, u)
        return belief, told, later(fault, failed)

    return compiled(move), compiled(see, static=(2,)), compiled(both, static=(2,))
