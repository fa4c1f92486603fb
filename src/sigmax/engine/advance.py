"""One step of a record as a pure function: the motion, then what each sensor measured."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.engine.half_steps import HalfSteps
from sigmax.steps.step import Innovation, later


class Instant(NamedTuple):
    """What one step is given.

    Attributes:
        z: by sensor, (m, ...), NaN where missing; corrected in the order of the model.
        dt: () or (B,); None where no time passes.
        u: (k,) or (k, B), or None.
        R: by sensor, of this measurement; the model's where it is not there.
    """

    z: Mapping[str, Any]
    dt: Any = None
    u: Any = None
    R: Mapping[str, Any] = {}


class Advanced(NamedTuple):
    """What a step gives: the belief, what each sensor said of it, and the fault (...)."""

    belief: Any
    innovations: dict[str, Innovation]
    fault: Any


def advance(steps: HalfSteps, sensors: Iterable[str], belief: Any, given: Instant, moving: Any) -> Advanced:
    """The belief a step later. What is measured where the motion failed is not heard.

    Args:
        steps: the filter's half-steps.
        sensors: of the model, in its order.
        belief: of the step before.
        given: of this step.
        moving: whether the motion is done, where that differs from step to step; True where it is always.
    """
    fault = jnp.zeros(belief.mean.shape[1:], jnp.int8)
    if given.dt is not None:

        def moved(belief: Any) -> tuple[Any, jax.Array]:
            return steps.predict(belief, given.dt, given.u)

        def stayed(belief: Any) -> tuple[Any, jax.Array]:
            return belief, fault

        belief, fault = moved(belief) if moving is True else jax.lax.cond(moving, moved, stayed, belief)
    sound = fault <= 0
    innovations = {}
    # In the model's order: JAX sorts the keys of a dict.
    for sensor in (s for s in sensors if s in given.z):
        measured = given.z[sensor] if given.dt is None else jnp.where(sound, given.z[sensor], jnp.nan)
        done = _corrected(steps, sensor, belief, measured, given, len(given.z) > 1)
        belief, innovations[sensor], failed = done
        fault = later(fault, failed)
    return Advanced(belief, innovations, fault)


def _corrected(
    steps: HalfSteps, sensor: str, belief: Any, z: Any, given: Instant, skip: bool
) -> tuple[Any, Innovation, jax.Array]:
    """A correction; where there are several sensors, one that nobody heard from in this step costs nothing."""

    def heard(belief: Any) -> tuple[Any, Innovation, jax.Array]:
        return steps.correct(sensor, given.R.get(sensor), belief, z, given.u)

    if not skip:
        return heard(belief)

    def silent(belief: Any) -> tuple[Any, Innovation, jax.Array]:
        _, said, fault = jax.eval_shape(heard, belief)
        empty = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), said)
        missing = empty._replace(residual=jnp.full_like(empty.residual, jnp.nan), nis=jnp.full_like(empty.nis, jnp.nan))
        return belief, missing, jnp.zeros(fault.shape, fault.dtype)

    return jax.lax.cond(jnp.isfinite(z).any(), heard, silent, belief)
