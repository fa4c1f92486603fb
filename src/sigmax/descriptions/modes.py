"""Modes of a description: several motions of one target, which take turns."""

from collections.abc import Mapping

from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.trial import parse_trial, with_updates
from sigmax.errors import InputError
from sigmax.files.description import Description
from sigmax.files.units import TIME, quantity
from sigmax.filters import Filter
from sigmax.models import imm


def in_turns(description: Description, built: Mapping[str, DescribedModel]) -> DescribedModel:
    """One model of the modes' models; what is not in every mode enters as its prior says.

    Raises:
        InputError: where the modes do not fit each other.
    """
    first = next(iter(built.values()))
    if description.bias or any(one.inputs for one in built.values()):
        raise InputError("modes: motions and sensors that take turns take no inputs and have no bias yet")
    for name, one in built.items():
        if [one.model.state[i] for i in one.position] != [first.model.state[i] for i in first.position]:
            raise InputError(f"modes.{name}: all modes must have the position in the same components")
    parts = description.modes
    sojourn = {name: quantity(mode.sojourn, TIME, f"modes.{name}.sojourn") for name, mode in parts.items()}
    for name, seconds in sojourn.items():
        if not seconds > 0:
            raise InputError(f"modes.{name}.sojourn must be above 0; it is {parts[name].sojourn!r}")
    initial = {name: mode.probability for name, mode in parts.items() if mode.probability is not None}
    dimensions = {
        component: dimension
        for one in built.values()
        for component, dimension in zip(one.model.state, one.dimensions, strict=True)
    }
    entry = {}
    for component, dimension in dimensions.items():
        if any(component not in one.model.state for one in built.values()):
            given = description.prior.get(component)
            if not isinstance(given, dict) or set(given) != {"mean", "std"}:
                raise InputError(f"prior.{component} must be {{ mean = …, std = … }}: so it comes into a mode, too")
            mean, std = (quantity(given[key], dimension, f"prior.{component}.{key}") for key in ("mean", "std"))
            entry[component] = mean, std**2
    for name in built:
        if f"probability_{name}" in dimensions:
            raise InputError(f"modes.{name}: a component is called probability_{name}; name one of them otherwise")
    try:
        model = imm(
            {name: (one.model, _filter(parts[name].filter, one)) for name, one in built.items()},
            sojourn=sojourn,
            initial=initial or None,
            entry=entry,
        )
    except InputError as error:
        raise InputError(f"modes: {error}") from error
    return first._replace(model=model, dimensions=tuple(dimensions[name] for name in model.state))


def _filter(name: str | None, built: DescribedModel) -> Filter | None:
    """A mode's own filter, with the updates of the sensors."""
    return None if name is None else with_updates(parse_trial(name).filter, built.updates)
