"""The state of a live filter on XLA."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.engine.advance import Instant
from sigmax.engine.backwards import backwards
from sigmax.engine.packing import Packing
from sigmax.engine.xla_engine import advancing, batch_first, batch_last, begun
from sigmax.filters import Filter
from sigmax.modelling.model import Model
from sigmax.modelling.opaque import failures_raised
from sigmax.results.covariances import Moments, covariances
from sigmax.steps.step import Fault, Innovation


class XlaState:
    """A belief, batch last, and the compiled step that moves it on."""

    # See `NativeState`.
    whole: Mapping[str | None, Any] = {}

    def __init__(self, filter: Filter, model: Model, belief: Any) -> None:
        self.filter, self.model = filter, model
        self.belief = jax.tree.map(jnp.asarray, belief)
        self.fault: Any = np.zeros(belief.mean.shape[1:], np.int8)
        # Flattened once: the model is the same in every call, and walking it would cost more than the step.
        self._leaves, structure = jax.tree.flatten(model)
        self._advance = advancing(filter, structure)

    @classmethod
    def of_prior(cls, filter: Filter, model: Model, mean: np.ndarray, cov: np.ndarray) -> "XlaState":
        """The state of a prior (n,) or (B, n), with a covariance for all or one for each."""
        cov = np.broadcast_to(cov, (*mean.shape[:-1], *cov.shape[-2:]))
        return cls(filter, model, begun(filter, model, batch_last(mean, 1), batch_last(cov, 2)))

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

    def read_moments(self) -> Moments:
        """Both."""
        return Moments(self.read_mean(), self.read_cov())

    def belief_of(self, held: Any) -> Any:
        """What was held, as a belief."""
        return held

    def rows_of(self, belief: Any) -> Any:
        """A belief, to be held."""
        return jax.tree.map(jnp.asarray, belief)

    def held(self) -> Any:
        """See `NativeState`."""
        return self.belief

    def put_held(self, held: Any, fault: Any) -> None:
        """Take up what was held, and the faults of the tracks."""
        self.put(held, fault)

    def kept(self, helds: Sequence[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """See `NativeState`."""
        packing = Packing.of(self.filter, self.model)
        arrays = [(b.mean, b.factor, *([packing.rest(b)] if packing.tail else [])) for b in helds]
        stacked = (np.stack([np.asarray(a) for a in some]) for some in zip(*arrays, strict=True))
        mean, factor, *rest = (np.moveaxis(a, -1, 0) if self.belief.mean.ndim == 2 else a for a in stacked)
        return mean, factor, rest[0] if rest else None

    def backwards(self, kept: Any, dt: np.ndarray, u: np.ndarray | None) -> tuple[Any, ...]:
        """See `NativeState`. Compiled for powers of two: where the motion failed, a smoothed step is the next one."""
        mean, factor, fault, rest = kept
        more = (1 << (len(dt) - 1).bit_length()) - len(dt)
        mean, factor, rest, u = (_longer(a, more, core) for a, core in ((mean, 1), (factor, 2), (rest, 1), (u, 1)))
        ends = ((0, 0),) * (fault.ndim - 1) + ((0, more),)
        longer = mean, factor, np.pad(fault, ends, constant_values=int(Fault.MOTION_NOT_FINITE)), rest
        batched = self.belief.mean.ndim == 2
        return backwards(self.filter, self.model, longer, np.pad(dt, (0, more)), u, batched, False, "xla")

    def put(self, belief: Any, fault: Any) -> None:
        """Take up another belief, and the faults of the tracks."""
        self.belief = jax.tree.map(jnp.asarray, belief)
        self.fault = np.asarray(fault, np.int8).reshape(belief.mean.shape[1:])

    def predict(self, dt: float, u: np.ndarray | None) -> None:
        """Move on."""
        self._go({}, self._cast(dt), None, u)

    def update(self, sensor: str, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Correct."""
        return self._go({sensor: z.T}, None, R, u)[sensor]

    def step(self, sensor: str, dt: float, z: np.ndarray, R: Any, u: np.ndarray | None) -> Innovation:
        """Move on and correct."""
        return self._go({sensor: z.T}, self._cast(dt), R, u)[sensor]

    def _go(self, z: dict[str, Any], dt: Any, R: Any, u: np.ndarray | None) -> dict[str, Innovation]:
        given = Instant(z, dt, self._laid(u), {} if R is None else dict.fromkeys(z, R))
        with failures_raised():
            done = self._advance(self._leaves, self.belief, given)
        # Not before it is known that no function of the model has failed: the state stays as it was then.
        self.belief, said, self.fault = done
        return {s: self._told(told) for s, told in said.items()}

    def _cast(self, dt: float) -> np.ndarray:
        return np.asarray(dt, self.belief.mean.dtype)

    def _laid(self, u: np.ndarray | None) -> Any:
        return u.T if u is not None and u.ndim == 2 else u

    def _told(self, told: Innovation) -> Innovation:
        laid = map(batch_first, told) if self.belief.mean.ndim == 2 else told
        return Innovation(*map(np.asarray, laid))


def _longer(a: Any, more: int, core: int) -> Any:
    """An array with its last step repeated."""
    if a is None:
        return None
    return np.concatenate([a, np.repeat(np.take(a, [-1], -1 - core), more, -1 - core)], -1 - core)
