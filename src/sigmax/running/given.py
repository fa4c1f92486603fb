"""What a live filter is given, step by step: checked, and in its type."""

from typing import Any

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.models.checks import by_name, finite, numbers
from sigmax.models.fusion import inputs_behind
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.models.noise import noise_once
from sigmax.running.functions import check_functions, counted
from sigmax.running.prepare import cast


class Given:
    """Measurements, noises and inputs of one live filter.

    Args:
        model: as the engine has it.
        dtype: of all numbers.
        tracks: (B,) for a batch, else ().
        asked: the model as the user has it.
        prior: of its state.

    Raises:
        InputError: where a function of the model that takes no inputs gives a shape that does not fit.
    """

    def __init__(self, model: Model, dtype: Any, tracks: tuple[int, ...], asked: Model, prior: Gaussian) -> None:
        self._model, self._dtype, self._tracks = model, dtype, tracks
        self._names = model.measurement
        self._asked, self._prior = asked, prior
        # Of the only sensor, where its components are named: what most measurements look like.
        named = self._names.get("")
        self._shape = None if named is None else (*tracks, len(named))
        self._driven = model.motion_driven or any(map(model.sensor_driven, model.sensors))
        # How many inputs the functions have been checked with; they are known when the first come.
        self._checked = -1
        self._check(None)

    def sensor(self, sensor: str | None) -> str:
        """The name of a sensor, which need not be given where there is one."""
        if sensor is None and self._model.several:
            raise InputError(f"say which sensor measured: update(z, sensor=…), one of {sorted(self._model.sensors)}")
        if sensor is not None and (not isinstance(sensor, str) or sensor not in self._model.sensors):
            raise unknown("sensor", sensor, self._model.sensors)
        return sensor or ""

    def measurement(self, z: Any, sensor: str | None) -> tuple[str, np.ndarray]:
        """The sensor and what it measured (m,) or (B, m)."""
        if type(z) is not np.ndarray:
            z = by_name("z", z, self._names.get(sensor if isinstance(sensor, str) else ""))
        value = np.asarray(numbers("z", z, missing=True), self._dtype)
        if sensor is None and value.shape == self._shape:
            return "", value
        sensor = self.sensor(sensor)
        names = self._names[sensor]
        if names is None:
            expected: tuple[Any, ...] = (*self._tracks, "m")
            fits = value.ndim == len(expected) and value.shape[:-1] == self._tracks
        else:
            expected = (*self._tracks, len(names))
            fits = value.shape == expected
        if not fits:
            raise InputError(
                f"z must have the shape {expected}{f' for {list(names)}' if names else ''}; it has {value.shape}"
            )
        return sensor, value

    def noise(self, sensor: str, R: Any) -> Any:
        """The noise of one measurement, None where it is the model's."""
        if R is None:
            return None
        return cast(noise_once(R, self._model.measured_deviations(sensor)), self._dtype)

    def inputs(self, u: Any, what: str, sensor: str | None = None) -> np.ndarray | None:
        """The inputs of a motion or a sensor, None where neither takes any."""
        if not self._driven:
            if u is not None:
                raise InputError("u= is given, and nothing in this model takes inputs u: leave it out")
            return None
        wanted = what == "motion" and self._model.motion_driven
        wanted = wanted or (sensor is not None and self._model.sensor_driven(sensor))
        if not wanted:
            return None
        if u is None:
            raise InputError(f"the {what} takes inputs; give u=")
        value = np.asarray(numbers("u", by_name("u", u, self._asked.inputs)), self._dtype)
        if value.ndim != 1 and not (value.ndim == 2 and value.shape[:1] == self._tracks):
            batch = f", or {(*self._tracks, 'k')} of each track" if self._tracks else ""
            raise InputError(f"u must have the shape (k,){batch}; it has {value.shape}")
        finite("u", value)
        own = value.shape[-1] - inputs_behind(self._asked)
        if own != self._checked:
            self._check(value[..., :own])
            self._checked = own
        return value

    def _check(self, u: np.ndarray | None) -> None:
        check_functions(self._asked, self._prior, 1.0, u, counted(self._asked), self._dtype)
