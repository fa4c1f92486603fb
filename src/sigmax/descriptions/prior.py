"""The prior of a description: by component, the position from the first measurement if wished."""

from typing import Any

import numpy as np

from sigmax.descriptions.described_model import DescribedModel
from sigmax.descriptions.sensor import first_position
from sigmax.errors import InputError, unknown
from sigmax.files.units import quantity

# The key that takes the position from the first measurement, and the one that takes everything from the first ones.
FROM = "position_from"
ALL_FROM = "from"


def read_prior(
    given: dict[str, Any],
    built: DescribedModel,
    measured: dict[str, np.ndarray],
    inputs: np.ndarray | None,
    rows: list[np.ndarray],
    names: tuple[str, ...],
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], tuple[str, ...]]:
    """Means (B, n), covariances (B, n, n), the rows that remain of each track, and notes for the reader.

    `measured` and `inputs` are those of all rows of the table. With `position_from`, a track begins with the first
    whole measurement of that sensor; it gives the position and its covariance, and is taken out of `measured` so that
    it does not count twice.

    Raises:
        InputError: where a component is missing, given twice or not known, or a number does not fit.
    """
    state = built.model.state
    sensor = given.get(FROM)
    if sensor is not None and (not isinstance(sensor, str) or sensor not in built.sensings):
        raise InputError(f"prior.{FROM}: {unknown('sensor', sensor, built.sensings)}")
    at = built.sensings[sensor].at if sensor is not None else ()
    for name in given:
        if name != FROM and name not in state:
            raise InputError(f"prior: {unknown('component', name, [*state, FROM])}")
        if name in [state[i] for i in at]:
            raise InputError(f"prior.{name} is given twice: here and by {FROM} = {sensor!r}; drop one of them")
    n, B = len(state), len(rows)
    mean, cov = np.zeros((B, n)), np.zeros((B, n, n))
    for i, name in enumerate(state):
        if i in at:
            continue
        mean[:, i], deviation = _component(given, name, built, i)
        cov[:, i, i] = deviation**2
    if sensor is None:
        return mean, cov, rows, ()
    used = len(at)
    firsts = []
    for k, r in enumerate(rows):
        whole = np.flatnonzero(~np.isnan(measured[sensor][r][:, :used]).any(1))
        if not len(whole):
            raise InputError(f"prior.{FROM}: the track {names[k]!r} has no whole measurement of the sensor {sensor!r}")
        firsts.append(int(whole[0]))
    begin = np.array([r[first] for r, first in zip(rows, firsts, strict=True)])
    try:
        place, spread = _located(built, sensor, measured[sensor][begin], None if inputs is None else inputs[begin])
    except InputError as error:
        raise InputError(f"prior.{FROM} = {sensor!r}: {error}") from error
    mean[:, at] = place
    cov[:, np.array(at)[:, None], np.array(at)] = spread
    measured[sensor][begin[:, None], np.arange(used)] = np.nan
    notes = [f"The first measurement of {sensor} gives each track its position and is not used again."]
    if built.biased is not None and sensor in built.biased.effects:
        notes.append(f"The bias of {sensor} widens that position.")
    if any(firsts):
        notes.append(f"{sum(firsts)} rows before it are left out.")
    return mean, cov, [r[first:] for r, first in zip(rows, firsts, strict=True)], tuple(notes)


def search(
    given: dict[str, Any], built: DescribedModel, measured: dict[str, np.ndarray], rows: list[np.ndarray]
) -> tuple[np.ndarray, dict[str, float]]:
    """Where the search for the state at the first measurements begins (B, n), and how far from there it may lead.

    A component that is given is near its mean. Else the position is that of the first measurement that tells one, or
    amid the sensors that stand somewhere, and all else is 0.

    Raises:
        InputError: where a component is not known, or a number does not fit.
    """
    state = built.model.state
    if given[ALL_FROM] != "measurements":
        raise InputError(f'prior.{ALL_FROM} is "measurements"; it is {given[ALL_FROM]!r}')
    if FROM in given:
        raise InputError(f"prior: {ALL_FROM} takes the whole state from measurements; drop {FROM}")
    for name in given:
        if name != ALL_FROM and name not in state:
            raise InputError(f"prior: {unknown('component', name, [*state, ALL_FROM])}")
    at, within = np.zeros((len(rows), len(state))), {}
    standing = [s for s in built.sensings.values() if s.origin is not None and len(s.at) == len(s.origin)]
    for i in range(len(state)):
        seen = [s.origin[s.at.index(i)] for s in standing if s.origin is not None and i in s.at]
        at[:, i] = np.mean(seen) if seen else 0.0
    for b, r in enumerate(rows):
        for name, sensing in built.sensings.items():
            whole = r[~np.isnan(measured[name][r]).any(1)]
            if len(whole) and sensing.kind in ("position", "range_azimuth"):
                # Any noise will do: where it is does not hang on it.
                near = sensing._replace(R=np.ones(len(sensing.dimensions)), deviations=None)
                at[b, sensing.at] = first_position(near, measured[name][whole[:1], : len(near.dimensions)])[0][0]
                break
    for i, name in enumerate(state):
        if name in given:
            at[:, i], within[str(name)] = _component(given, name, built, i)
            if not within[str(name)] > 0:
                raise InputError(f"prior.{name}.std must be above 0 with {ALL_FROM}; it is {given[name]['std']!r}")
    return at, within


def _located(built: DescribedModel, sensor: str, z: np.ndarray, u: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The positions of measurements, without the mean of the bias and as uncertain as it leaves them."""
    sensing = built.sensings[sensor]
    own = [k for k, item in enumerate(built.inputs) if item.sensor == sensor and item.deviation]
    deviations = None if u is None or not own else u[:, own]
    if built.biased is None or sensor not in built.biased.effects:
        return first_position(sensing, z, deviations=deviations)
    prior = built.biased.bias.prior
    F = built.biased.effects[sensor].on(z)
    return first_position(sensing, z - F @ prior.mean, F @ prior.cov @ F.swapaxes(1, 2), deviations)


def _component(given: dict[str, Any], name: str, built: DescribedModel, place: int) -> tuple[float, float]:
    if name not in given:
        means = f" (or {FROM} = a sensor)" if place in built.position else ""
        raise InputError(f"prior needs {str(name)!r}: {{ mean = …, std = … }}{means}")
    value = given[name]
    if not isinstance(value, dict) or set(value) != {"mean", "std"}:
        raise InputError(f"prior.{name} must be {{ mean = …, std = … }}; it is {value!r}")
    dimension = built.dimensions[place]
    mean, deviation = (quantity(value[key], dimension, f"prior.{name}.{key}") for key in ("mean", "std"))
    if deviation < 0:
        raise InputError(f"prior.{name}.std must not be negative; it is {value['std']!r}")
    return mean, deviation
