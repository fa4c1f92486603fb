"""A random bias from its description: offsets and scales of sensors, drifts of the motion, by name."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.descriptions.sensor import Sensing
from sigmax.errors import InputError, unknown
from sigmax.files.description import BiasPart
from sigmax.files.units import ANGLE, NUMBER, Dimension, is_below, quantity
from sigmax.modelling.noise import arrays_of, sensor_of, takes
from sigmax.models import Bias, Gaussian


class Effect(NamedTuple):
    """What a bias b does to a measurement: z = h + (added + scaled h) b.

    Attributes:
        added: (m, p), 1 where a component of the bias is an offset.
        scaled: (m, p), 1 where it is the relative error of a scale.
    """

    added: np.ndarray
    scaled: np.ndarray

    def on(self, z: np.ndarray) -> np.ndarray:
        """F at measurements (B, m): (B, m, p)."""
        return self.added + self.scaled * z[..., None]


class Biased(NamedTuple):
    """A bias with what the edges know of it.

    Attributes:
        bias: the bias.
        dimensions: of its components.
        effects: on the measurement, by sensor.
    """

    bias: Bias
    dimensions: tuple[Dimension, ...]
    effects: dict[str, Effect]


def read_bias(
    parts: Mapping[str, BiasPart],
    state: tuple[str, ...],
    dimensions: tuple[Dimension, ...],
    sensings: Mapping[str, Sensing],
    hear: Mapping[str, Callable[..., Any]],
) -> Biased:
    """The bias of a description, for a state and sensors that are known.

    Args:
        parts: by the name of its component.
        state: names of the components of the state.
        dimensions: of those.
        sensings: the sensors.
        hear: their functions as the model has them.

    Raises:
        InputError: for names and units that do not fit, or a component that acts on nothing or on unlike things.
    """
    names = list(parts)
    taken = [name for name in names if name in state]
    if taken:
        raise InputError(f"bias.{taken[0]}: the state has a component of this name; choose another")
    rates = np.zeros((len(state), len(names)))
    effects = {s: Effect(*np.zeros((2, len(one.dimensions), len(names)))) for s, one in sensings.items()}
    found: list[Dimension] = []
    for k, (name, part) in enumerate(parts.items()):
        where = f"bias.{name}"
        kinds: dict[str, Dimension] = {}
        for s, component, place in _places(part.offset, sensings, f"{where}.offset"):
            effects[s].added[place, k] = 1
            kinds[f"the offset of {s}.{component}"] = sensings[s].dimensions[component]
        for s, component, place in _places(part.scale, sensings, f"{where}.scale"):
            if sensings[s].dimensions[component] == ANGLE:
                raise InputError(f"{where}.scale: {s}.{component} is an angle, which has no scale; take offset")
            effects[s].scaled[place, k] = 1
            kinds[f"the scale of {s}.{component}"] = NUMBER
        for component in part.drift:
            if component not in state:
                raise InputError(f"{where}.drift: {unknown('component', component, state)}")
            place = state.index(component)
            rates[place, k] = 1
            kinds[f"the drift of {component}"] = dimensions[place]._replace(time=dimensions[place].time - 1)
        if not kinds:
            raise InputError(
                f'{where} acts on nothing; give offset = {{ SENSOR = "component" }}, '
                'scale = { SENSOR = "component" } or drift = ["component of the state"]'
            )
        if len(set(kinds.values())) > 1:
            said = ", ".join(f"{what} is {d.what}" for what, d in kinds.items())
            raise InputError(f"{where}: one component of a bias is one quantity, but {said}; make one of each")
        found.append(next(iter(kinds.values())))
    given = [(f"bias.{name}", part, d) for (name, part), d in zip(parts.items(), found, strict=True)]
    mean = _together([quantity(part.mean, d, f"{where}.mean") for where, part, d in given])
    deviation, noise = (
        _together([_not_negative(getattr(part, key), d, f"{where}.{key}") for where, part, d in given])
        for key in ("std", "noise")
    )
    used = {s: e for s, e in effects.items() if e.added.any() or e.scaled.any()}
    bias = Bias(
        prior=Gaussian(mean, deviation**2),
        motion=_drift(rates) if rates.any() else None,
        sensor={s: _coefficients(e, hear[s]) for s, e in used.items()},
        Q=noise**2,
        names=names,
    )
    return Biased(bias, tuple(found), used)


def _places(given: Mapping[str, list[str]], sensings: Mapping[str, Sensing], where: str) -> list[tuple[str, str, int]]:
    """Sensor, component and its place, for each that is named."""
    made = []
    for s, components in given.items():
        if s not in sensings:
            raise InputError(f"{where}: {unknown('sensor', s, sensings)}")
        known = list(sensings[s].dimensions)
        for component in components:
            if component not in known:
                raise InputError(f"{where}.{s}: {unknown('component', component, known)}")
            made.append((s, component, known.index(component)))
    return made


def _together(values: list[Any]) -> Any:
    """Numbers as an array, of JAX where one of them is fitted."""
    return arrays_of(values).asarray(values)


def _not_negative(given: Any, dimension: Dimension, where: str) -> Any:
    value = quantity(given, dimension, where)
    if is_below(value, 0):
        raise InputError(f"{where}: a standard deviation must not be negative; it is {given!r}")
    return value


def _drift(rates: np.ndarray) -> Callable[..., Any]:
    """B(dt): what drifts is added up over the interval."""
    return lambda dt: rates * dt


def _coefficients(effect: Effect, h: Callable[..., Any]) -> Any:
    """F of a sensor: numbers, or a function of the state where a scale is among it."""
    added, scaled = effect
    if not scaled.any():
        return added

    def F(x: Any, *u: Any) -> Any:
        return added + scaled * jnp.asarray(h(x, *u))[:, None]

    return sensor_of(F, takes(h, "the sensor", (1, 2)) == 2)
