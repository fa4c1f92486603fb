"""What a live filter is given, step by step: checked, and in its type."""

from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.functions.functions import check_functions, counted
from sigmax.modelling.checks import by_name, finite, numbers
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model, check_added
from sigmax.modelling.noise import noise_once
from sigmax.preparation.fusing import Members, with_members_live
from sigmax.preparation.prepare import cast
from sigmax.rewriting.fusion import Fused, inputs_behind
from sigmax.steps.step import Innovation

# Intervals are known when they come; noises are looked at over one that no integration finds long.
_SHORT = 1e-3


class Observation(NamedTuple):
    """A measurement as the engine takes it.

    Attributes:
        sensor: its name.
        z: (m,) or (B, m).
        R: its noise, None for the model's.
        u: inputs of the sensor and of the motion before it, None without.
        fused: what it was put together to, where sensors are fused.
    """

    sensor: str
    z: np.ndarray
    R: Any = None
    u: np.ndarray | None = None
    fused: Fused | None = None

    def missing(self, model: Model) -> Innovation:
        """What a measurement says that is not taken: what a missing one would."""
        dim, tracks, kind = model.measured_space(self.sensor, self.z.shape[-1]).dim, self.z.shape[:-1], self.z.dtype
        missing, none = np.full((*tracks, dim), np.nan, kind), np.zeros(tracks, kind)
        return Innovation(missing, np.zeros((*tracks, dim, dim), kind), missing.sum(-1), none, none.astype(int))

    def with_members(self, said: Innovation) -> Innovation:
        """What it said, as of all sensors that were fused."""
        return said if self.fused is None else with_members_live(said, self.fused)


class LiveArguments:
    """Measurements, noises and inputs of one live filter.

    Args:
        model: as the engine has it.
        dtype: of all numbers.
        tracks: (B,) for a batch, else ().
        asked: the model as the user has it.
        prior: of its state.
        members: the sensors that are fused, if there are any.

    Raises:
        InputError: where a function of the model that takes no inputs gives a shape that does not fit.
    """

    def __init__(
        self,
        model: Model,
        dtype: Any,
        tracks: tuple[int, ...],
        asked: Model,
        prior: Gaussian,
        members: Members | None = None,
    ) -> None:
        self._model, self._dtype, self._tracks, self._members = model, dtype, tracks, members
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
        value = np.array(numbers("z", z, missing=True), self._dtype)  # people fill one buffer again and again
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

    @property
    def fused(self) -> bool:
        """Whether sensors are fused."""
        return self._members is not None

    def observation(self, z: Any, sensor: str | None, R: Any, u: Any, moved: bool) -> Observation:
        """A measurement with its noise and inputs; `moved`: the motion before it takes the inputs, too."""
        if self._members is not None:
            if moved and u is None and self._asked.motion_driven:
                raise InputError("the motion takes inputs; give u=")
            return self.together(self._members.together(z, sensor, R, u, self._tracks), moved)
        name, value = self.measurement(z, sensor)
        return Observation(name, value, self.noise(name, R), self.inputs(u, "motion" if moved else "sensor", name))

    def together(self, fused: Fused, moved: bool = False) -> Observation:
        """What fused sensors made of their measurements."""
        name, value = self.measurement(fused.z, next(iter(self._model.sensors)))
        return Observation(name, value, None, self.inputs(fused.u, "motion" if moved else "sensor", name), fused)

    def moving(self, u: Any) -> np.ndarray | None:
        """The inputs of a motion that nothing is measured after."""
        return self.inputs(u if self._members is None else self._members.inputs(u), "motion")

    def noise(self, sensor: str, R: Any) -> Any:
        """The noise of one measurement, None where it is the model's."""
        if R is None:
            return None
        check_added(self._model, "R of one measurement")
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
        value = np.array(numbers("u", by_name("u", u, self._asked.inputs)), self._dtype)
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
        check_functions(self._asked, self._prior, _SHORT, u, counted(self._asked), self._dtype)
