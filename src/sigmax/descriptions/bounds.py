"""Bounds of components of the state, of a description."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from sigmax.descriptions.described_model import DescribedModel
from sigmax.errors import InputError, unknown
from sigmax.files.description import BoundPart
from sigmax.files.units import quantity
from sigmax.models import constrain


def bounded(built: DescribedModel, bounds: Mapping[str, BoundPart]) -> DescribedModel:
    """A model whose components keep within their bounds, see `sigmax.constrain`.

    Raises:
        InputError: for a component that is not there, and bounds that are none.
    """
    model = built.model
    for name, part in bounds.items():
        if name not in model.state:
            raise InputError(f"bounds: {unknown('component', name, model.state)}")
        place = model.state.index(name)
        ends = {
            end: quantity(value, built.dimensions[place], f"bounds.{name}.{end}")
            for end, value in (("low", part.low), ("high", part.high))
            if value is not None
        }
        try:
            model = constrain(model, _component(place), when=part.when, **ends)
        except InputError as error:
            raise InputError(f"bounds.{name}: {error}") from error
    return built._replace(model=model)


@lru_cache(maxsize=256)
def _component(place: int) -> Callable[[Any], Any]:
    return lambda x: x[place]
