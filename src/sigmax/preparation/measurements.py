"""The measurements of a record, checked against its model."""

from collections.abc import Mapping
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import by_name, numbers
from sigmax.modelling.model import Model


def measurements_of(model: Model, z: Any) -> dict[str, Any]:
    """Measurements by sensor, (T, m) or (B, T, m), checked against the model."""
    if model.several != isinstance(z, Mapping):
        wanted = f"a dict by sensor name, {sorted(model.sensors)}" if model.several else "an array (T, m) or (B, T, m)"
        raise InputError(f"z must be {wanted}; it is {type(z).__name__}")
    measured: Mapping[str, Any] = z if isinstance(z, Mapping) else {"": z}
    if not measured:
        raise InputError("z has no measurements: the dict is empty")
    for s in measured:
        if s not in model.sensors:
            raise unknown("sensor", s, model.sensors)
    result = {}
    for s in model.sensors:
        if s not in measured:
            continue
        label = f"z[{s!r}]" if s else "z"
        value = numbers(label, by_name(label, measured[s], model.measurement[s]), missing=True)
        if value.ndim not in (2, 3):
            hint = "; for a scalar measurement use z[:, None]" if value.ndim == 1 else ""
            raise InputError(f"{label} must have the shape (T, m) or (B, T, m); it has {value.shape}{hint}")
        names = model.measurement[s]
        if names is not None and value.shape[-1] != len(names):
            raise InputError(f"{label} has {value.shape[-1]} columns, the sensor {len(names)}: {list(names)}")
        if value.shape[-2] == 0:
            raise InputError(f"{label} has no time steps: its shape is {value.shape}")
        if value.shape[0] == 0:
            raise InputError(f"{label} has no tracks: its shape is {value.shape}")
        result[s] = value
    return result


def steps_of(measured: Mapping[str, Any]) -> int:
    """The number of time steps of measurements by sensor.

    Raises:
        InputError: where it is not the same for all.
    """
    steps = {s: v.shape[-2] for s, v in measured.items()}
    if len(set(steps.values())) > 1:
        raise InputError(f"all sensors need the same number of time steps, NaN where one did not report; got {steps}")
    return int(next(iter(steps.values())))
