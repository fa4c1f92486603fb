"""Records whose covariance settles: of linear models whose noises, intervals and sensors stay the same."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax.numpy as jnp

from sigmax.dependence import reading
from sigmax.engine.lowered import Lowered
from sigmax.functions.current import found_once
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.native import Refused
from sigmax.native.driver import Settled, pointer

# A step that is compiled for less than this takes longer than it saves.
_LONG = 256
# States beyond which a straight line of scalars takes long to compile.
_WIDE = 20


def settled(low: Lowered, model: Model, sizes: dict[str, int], steps: int, inputs: bool) -> Settled | None:
    """The steps of a record once its covariance has settled, None where it does not, or hardly has the time to.

    Args:
        low: the filter's steps.
        model: as the engine takes it.
        sizes: what is measured, by sensor.
        steps: of the record.
        inputs: whether there are inputs.
    """
    if steps < _LONG or inputs or len(sizes) != 1 or low.packing.tail:
        return None
    ((sensor, size),) = sizes.items()
    return _settled(model, low, sensor, size)


@found_once
def _settled(model: Model, low: Lowered, sensor: str, size: int) -> Settled | None:
    if not _is_linear(model, sensor):
        return None
    try:
        (step,) = low.need(("steady", sensor, size))
    except Refused:
        return None
    numbers = low.parameters(model)[:-1]
    made = Settled(step.address, step.preparing, pointer(numbers), numbers.size, step.constants)
    made.kept = numbers
    return made


def _is_linear(model: Model, sensor: str) -> bool:
    """Whether nothing that a covariance depends on can depend on the state: found without compiling anything."""
    if isinstance(model, SwitchingModel) or model.domain is not None or model.constraints or model.curved:
        return False
    if model.size > _WIDE or callable(model.Q) or callable(model.R[sensor]):
        return False
    return not (_bends(model.motion, model.size, True) or _bends(model.sensors[sensor], model.size, False))


@lru_cache(maxsize=512)
def _bends(function: Callable[..., Any], n: int, moving: bool) -> bool:
    return bool(reading(function, n, [jnp.ones(())] if moving else []).nonlinear)
