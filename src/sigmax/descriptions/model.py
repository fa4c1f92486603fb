"""The model of a description: motions joined, sensors by name, inputs dealt out."""

from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any

import jax

from sigmax.descriptions.bias import read_bias
from sigmax.descriptions.bounds import bounded
from sigmax.descriptions.described_model import DescribedModel, Input
from sigmax.descriptions.modes import in_turns
from sigmax.descriptions.motion import Moving, read_motion
from sigmax.descriptions.sensor import read_sensor
from sigmax.errors import InputError, unknown
from sigmax.files.description import Column, Description, MotionPart
from sigmax.files.units import LENGTH, Dimension
from sigmax.files.userfile import Functions
from sigmax.modelling.noise import takes
from sigmax.models import Model, motions


def build(description: Description, folder: Path) -> DescribedModel:
    """The model of a description whose files lie in `folder`.

    Raises:
        InputError: for names, options, units and functions that do not fit.
    """
    functions = Functions(folder)
    if not description.modes:
        return bounded(_of_one_mode(description, description.motion, "motion", functions), description.bounds)
    if description.bounds:
        raise InputError("bounds: modes would have to be weighed by them; bound a description with one [motion]")
    built = {
        name: _of_one_mode(description, mode.motion, f"modes.{name}.motion", functions)
        for name, mode in description.modes.items()
    }
    return in_turns(description, built)


def _of_one_mode(
    description: Description, motion: list[MotionPart], where: str, functions: Functions
) -> DescribedModel:
    several = len(motion) > 1
    labels = [f"{where}[{i}]" if several else where for i in range(len(motion))]
    parts = [read_motion(p, label, functions) for p, label in zip(motion, labels, strict=True)]
    moving = reduce(_joined, parts)
    state = moving.motion.state
    if len(set(state)) < len(state):
        raise InputError(f"{where}: two parts have a component of the same name: {list(map(str, state))}")
    names = list(moving.position) if description.position is None else description.position
    for name in names:
        if name not in state:
            raise InputError(f"position: {unknown('component', name, state)}")
        if moving.dimensions[state.index(name)] != LENGTH:
            raise InputError(f"position: the component {name!r} is no length")
    sensings = {
        name: read_sensor(part, f"sensors.{name}", state, tuple(names), functions)
        for name, part in description.sensors.items()
    }
    inputs = _inputs(
        {name: column for part in motion for name, column in part.inputs.items()},
        moving.motion.inputs,
        moving.inputs,
        None,
        f"{where}.inputs",
    )
    driven = len(inputs)
    hear: dict[str, Callable[..., Any]] = {}
    noises: dict[str, Any] = {}
    for name, sensing in sensings.items():
        own = _inputs(
            description.sensors[name].inputs, sensing.sensor.inputs, sensing.inputs, name, f"sensors.{name}.inputs"
        )
        part_of_u = slice(len(inputs), len(inputs) + len(own))
        hear[name] = _with_part_of(sensing.sensor.function, part_of_u, 1, f"sensors.{name}.kind")
        where_noise = f"sensors.{name}.noise"
        columns = {} if sensing.deviations is None else sensing.deviations.columns
        known = [Input(v, sensing.dimensions[c], name, f"{where_noise}.{c}", True) for c, v in columns.items()]
        part_of_noise = slice(part_of_u.stop, part_of_u.stop + len(known)) if known else part_of_u
        noises[name] = _with_part_of(sensing.R, part_of_noise, 1, where_noise, must=False)
        inputs += [*own, *known]
    biased = None
    if description.bias:
        biased = read_bias(description.bias, state, moving.dimensions, sensings, hear)
    _check_columns(state, () if biased is None else biased.bias.names)
    try:
        model = Model(
            motion=_with_part_of(moving.motion.function, slice(driven), 2, f"{where}.kind"),
            sensor=hear,
            Q=_with_part_of(moving.Q, slice(driven), 2, f"{where}.noise", must=False),
            R=noises,
            state=state,
            measurement={name: sensing.sensor.measurement for name, sensing in sensings.items()},
            bias=None if biased is None else biased.bias,
        )
    except InputError as error:
        raise InputError(_renamed(str(error), where)) from error
    model.inputs = tuple(item.name for item in inputs) or None
    return DescribedModel(
        model, moving.dimensions, tuple(state.index(n) for n in names), sensings, tuple(inputs), biased
    )


# Columns that stand beside the estimates in what a run leaves behind, with those of their deviations and truth.
_COLUMNS = {"filter", "track", "time", "nis", "dof", "ok", "sensor", "confirmed", "existence", "plot"}


def _check_columns(state: tuple[str, ...], bias: tuple[str, ...]) -> None:
    """Refuse names of which two columns of the estimates would be called the same."""
    names = [*state, *bias]
    taken = _COLUMNS | {f"{name}_{of}" for name in names for of in ("std", "truth")}
    for where, name in [("state", n) for n in state] + [("bias", n) for n in bias]:
        if name in taken:
            raise InputError(f"{where}.{name}: another column of the estimates has this name; choose another")


def _renamed(message: str, where: str) -> str:
    """The engine's Q and R as they are called in a description."""
    head, _, rest = message.partition(" ")
    if head == "Q":
        return f"{where}.noise {rest}"
    return f"sensors.{head[3:-2]}.noise {rest}" if head.startswith("R['") else message


def _joined(first: Moving, second: Moving) -> Moving:
    if second.motion.inputs or (second.inputs is None and second.motion.inputs):
        raise InputError("motion: inputs belong to the first of the motions that are joined")
    motion = motions.join(first.motion, second.motion)
    Q = motion.noise(first.Q, second.Q)
    return Moving(motion, Q, first.dimensions + second.dimensions, first.position or second.position, first.inputs)


def _inputs(
    given: dict[str, Column],
    wanted: tuple[str, ...],
    dimensions: dict[str, Dimension] | None,
    sensor: str | None,
    where: str,
) -> list[Input]:
    for name in given:
        if name not in wanted:
            if not wanted:
                raise InputError(f"{where}: nothing here takes inputs, {name!r} is given")
            raise InputError(f"{where}: {unknown('input', name, wanted)}")
    for name in wanted:
        if name not in given:
            raise InputError(f"{where} needs {name!r}: the column that holds it")
    return [Input(given[n], None if dimensions is None else dimensions[n], sensor, f"{where}.{n}") for n in wanted]


def _with_part_of(function: Any, part: slice, before: int, where: str, must: bool = True) -> Any:
    """A function of `before` arguments and u that is given its part of all the inputs.

    Raises:
        InputError: where it does not take u and `must`, or takes u and there is none.
    """
    if not callable(function):
        return function
    count = takes(function, where, tuple(range(1 if not must else before, before + 2)))
    some = part.stop > (part.start or 0)
    if count <= before:
        if some and must:
            raise InputError(f"{where}: the function takes {before} arguments; with inputs it needs one more, u")
        return function
    if not some:
        raise InputError(f"{where}: the function takes inputs u; name their columns under inputs")
    if before == 2:
        return lambda x, dt, u: function(x, dt, u[part])

    def with_own(x: jax.Array, u: jax.Array) -> Any:
        return function(x, u[part])

    return with_own
