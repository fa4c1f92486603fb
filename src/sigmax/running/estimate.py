"""What a live filter knows of one moment, now or some time ago."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from sigmax.filters import Filter
from sigmax.models.model import Model
from sigmax.running.layout import Layout
from sigmax.running.live_xla import XlaState
from sigmax.running.smooth import backwards
from sigmax.running.smoothed import Smoothed
from sigmax.running.step import Fault
from sigmax.running.window import Engine, Standing


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class Estimate(Smoothed):
    """What a live filter knows of one moment: as `Smoothed`, without the axis of time."""


def left_as_it_was(engine: Engine, call: Callable[[], Any]) -> Any:
    """What a call gives, after which the engine holds what it held."""
    held, fault = engine.held(), np.array(engine.fault)
    try:
        return call()
    finally:
        engine.put_held(held, fault)


def ahead(engine: Engine, layout: Layout, start: Standing, time: float, u: Any) -> Estimate:
    """The belief of a step, predicted to a time that is not before it."""

    def there() -> Estimate:
        engine.put_held(start.held, np.zeros_like(start.fault))
        if time > start.time:
            engine.predict(time - start.time, u)
        fault = np.array(engine.fault, np.int8).reshape(start.fault.shape)
        return _estimate(layout, engine.kept([engine.held()]), fault, time)

    found: Estimate = left_as_it_was(engine, there)
    return found


def smoothed(
    engine: Engine,
    filter: Filter,
    model: Model,
    layout: Layout,
    steps: Sequence[tuple[Standing, Any]],
    backend: str | None,
) -> Estimate:
    """The first of several steps, each with the inputs of the motion before it, from what all of them measured.

    It costs a step of the smoother for each of them.
    """
    standings, batched = [s for s, _ in steps], layout.batched
    fault = np.stack([s.fault for s in standings], -1)
    dt = np.diff([s.time for s in standings], prepend=standings[0].time)
    u = _inputs([u for _, u in steps])
    mean, factor, rest = engine.kept([s.held for s in standings])
    if isinstance(engine, XlaState):
        # Compiled for powers of two. Where the motion failed, a smoothed step is the one after it.
        more = (1 << (len(steps) - 1).bit_length()) - len(steps)
        mean, factor, rest, u = (_longer(a, more, c) for a, c in ((mean, 1), (factor, 2), (rest, 1), (u, 1)))
        dt = np.pad(dt, (0, more))
        fault = np.pad(fault, ((0, 0),) * batched + ((0, more),), constant_values=int(Fault.MOTION_NOT_FINITE))
    kept = mean, factor, fault, rest
    mean, factor, fault, rest = backwards(filter, model, kept, dt.astype(mean.dtype), u, batched, False, backend)
    return _estimate(layout, (mean, factor, rest), fault[..., 0], standings[0].time)


def _estimate(layout: Layout, kept: Sequence[Any], fault: Any, time: float) -> Estimate:
    mean, factor, rest = kept
    rest = None if rest is None else rest[..., 0, :]
    return Estimate(layout, mean[..., 0, :], factor[..., 0, :, :], fault, rest, stored_time=time)


def _inputs(of_steps: list[Any]) -> Any:
    """Inputs (T, k) or (B, T, k); those of the first step are not read."""
    if all(u is None for u in of_steps[1:]):
        return None
    of_steps[0] = of_steps[1]
    return np.stack(np.broadcast_arrays(*of_steps), -2)


def _longer(a: Any, more: int, core: int) -> Any:
    """An array with its last step repeated."""
    if a is None:
        return None
    return np.concatenate([a, np.repeat(np.take(a, [-1], -1 - core), more, -1 - core)], -1 - core)
