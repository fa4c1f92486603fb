"""What a live filter knows of one moment, now or some time ago."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from sigmax.live.window import Engine, Standing
from sigmax.preparation.layout import Layout
from sigmax.results.smoothed import Smoothed


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


def smoothed(engine: Engine, layout: Layout, steps: Sequence[tuple[Standing, Any]]) -> Estimate:
    """The first of several steps, each with the inputs of the motion before it, from what all of them measured.

    It costs a step of the smoother for each of them.
    """
    standings = [s for s, _ in steps]
    mean, factor, rest = engine.kept([s.held for s in standings])
    fault = np.stack([s.fault for s in standings], -1)
    times = [s.time for s in standings]
    dt = np.array([0.0, *(b - a for a, b in pairwise(times))], mean.dtype)
    mean, factor, fault, rest = engine.backwards((mean, factor, fault, rest), dt, _inputs([u for _, u in steps]))
    return _estimate(layout, (mean, factor, rest), fault[..., 0], times[0])


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
