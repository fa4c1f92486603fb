"""A model: motion, sensors, their noise, and which components are angles."""

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import jax

from sigmax.errors import InputError
from sigmax.modelling.bias import Bias
from sigmax.modelling.components import Components, by_sensor, components, measured_components
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.inside import Inside, noises_apart
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, Noise, noise, takes
from sigmax.modelling.parts import Motion, Sensor
from sigmax.modelling.units import Units, named, units_of
from sigmax.spaces import Flat, Space
from sigmax.tracing import traceable


@jax.tree_util.register_pytree_node_class
class Model:
    """What moves and what is seen. Functions are written for one state x (n,); the library batches them.

    Args:
        motion: `motion(x, dt)` or `motion(x, dt, u)` with inputs u (k,): the state dt seconds later, (n,);
            or a ready-made `Motion`, which names the state too; or one with its noise `inside`.
        sensor: `sensor(x)` or `sensor(x, u)`: the measurement without noise, (m,); or a ready-made
            `Sensor`, which names the measurement too; or several by name, `{"radar": h1, "camera": h2}`.
        Q: noise of the motion: a covariance per second (d, d) that is multiplied by dt, d variances per second, or a
            function `Q(dt)`, `Q(x, dt)` or `Q(x, dt, u)` that gives the covariance of the whole interval. It is that
            of the deviations of the state: d = n, but for curved parts.
        R: noise of the sensor: a covariance (m, m), m variances, or a function `R(x)` or `R(x, u)`;
            a dict by name where there are several sensors.
        state: names of the components, `angle("…")` for those that are angles, `rotation("…")` and the like for
            parts of several numbers. Without it the components are counted from Q.
        measurement: the same of the measurement, a dict by name where there are several sensors.
        domain: a function x -> x that brings a state back to where it makes sense, such as
            `mirrored_speed`; the covariance follows its derivative.
        bias: a random bias of motion and sensors, which filters estimate beside the state.
        units: of components of state and bias, by name, for tables and pictures: `{"speed": "m/s"}`. Angles are in
            radians, ready-made motions know theirs; nothing is converted.

    Raises:
        InputError: for shapes, names or matrices that do not fit.
    """

    def __init__(
        self,
        *,
        motion: Callable[..., Any] | Motion | Inside,
        sensor: Callable[..., Any] | Sensor | Inside | Mapping[str, Callable[..., Any] | Sensor | Inside],
        Q: Any = None,
        R: Any = None,
        state: Sequence[str] | None = None,
        measurement: Sequence[str] | Mapping[str, Sequence[str]] | None = None,
        domain: Callable[[Any], Any] | None = None,
        bias: Bias | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        known: Mapping[str, str] = {}
        motion, sensor, Q, R, within = noises_apart(motion, sensor, Q, R)
        # Noises that stand inside the motion (None) and sensors, as functions of [ξ; x]: see `inside`.
        self.inside: tuple[tuple[str | None, Callable[..., Any], int], ...] = within
        if isinstance(motion, Motion):
            state = motion.state if state is None else state
            known = dict(zip(motion.state, motion.units, strict=False))
        self.motion: Callable[..., Any] = traceable(motion.function if isinstance(motion, Motion) else motion)
        self.domain = traceable(domain)
        self.several = isinstance(sensor, Mapping)
        parts = dict(sensor) if isinstance(sensor, Mapping) else {"": sensor}
        inputs = {part.inputs for part in (motion, *parts.values()) if isinstance(part, Motion | Sensor)} - {()}
        # Names of the inputs u, where the parts that take them agree on them.
        self.inputs: tuple[str, ...] | None = inputs.pop() if len(inputs) == 1 else None
        if not parts:
            raise InputError("a model needs at least one sensor; the dict given is empty")
        self.sensors: dict[str, Callable[..., Any]] = {
            s: traceable(part.function if isinstance(part, Sensor) else part) for s, part in parts.items()
        }
        for what, function in (("motion", self.motion), *self.sensors.items()):
            if not callable(function):
                raise InputError(f"{what or 'sensor'} must be a function, it is {type(function).__name__}")
        if domain is not None and not callable(domain):
            raise InputError(f"domain must be a function x -> x, it is {type(domain).__name__}")
        self.motion_inputs = takes(self.motion, "motion", (2, 3)) == 3
        self.sensor_inputs = {s: takes(h, s or "sensor", (1, 2)) == 2 for s, h in self.sensors.items()}
        self.components: Components = components("state", state, Q, "Q")
        self.Q = noise("Q", Q, self.deviations, OF_MOTION)
        by_name = {s: by_sensor(R, s, self.several, "R") for s in self.sensors}
        named = {s: by_sensor(measurement, s, self.several, "measurement") for s in self.sensors}
        named |= {s: p.measurement for s, p in parts.items() if isinstance(p, Sensor) and named[s] is None}
        self.R: dict[str, Noise] = {}
        self.measured: dict[str, Components | None] = {}
        for s in self.sensors:
            label = f"R[{s!r}]" if self.several else "R"
            self.measured[s] = seen = measured_components(named[s], by_name[s], label)
            self.R[s] = noise(label, by_name[s], None if seen is None else seen.deviations, OF_SENSOR)
        if self.several:
            for what, given in (("R", R), ("measurement", measurement)):
                extra = set(given) - set(self.sensors) if isinstance(given, Mapping) else set()
                if extra:
                    raise InputError(f"{what} names {sorted(extra)}, the sensors are {sorted(self.sensors)}")
        if bias is not None and not isinstance(bias, Bias):
            raise InputError(f"bias must be a sigmax.Bias, it is {type(bias).__name__}")
        # What is known of every state: see `constrain`.
        self.constraints: tuple[Any, ...] = ()
        # The blocks of sensors that are corrected together: see `fused`.
        self.fusion: tuple[Any, ...] | None = None
        seen_by = {s: self.measured_deviations(s) for s in self.sensors}
        if within and (bias is not None or self.curved):
            raise InputError("noises inside go with states and measurements of numbers and angles, without a Bias")
        self.bias = None if bias is None else bias.fitted(self.state, self.deviations, seen_by, self.several)
        names = () if self.bias is None else self.bias.names
        self.units: Units = units_of(units, known, self.components, names)

    @property
    def state(self) -> tuple[str, ...]:
        """Names of the numbers of a state."""
        return self.components.numbers

    @property
    def deviations(self) -> tuple[str, ...]:
        """Names of its deviations, those of the numbers but for curved parts."""
        return self.components.deviations

    @property
    def space(self) -> Space:
        """Where a state lives."""
        return self.components.space

    @property
    def measurement(self) -> dict[str, tuple[str, ...] | None]:
        """Names of what each sensor measures, None where nothing tells."""
        return {s: None if own is None else own.numbers for s, own in self.measured.items()}

    @property
    def curved(self) -> bool:
        """Whether a part of state or measurement is neither a number nor an angle."""
        return not all(space.flat for space in (self.space, *(m.space for m in self.measured.values() if m)))

    @property
    def size(self) -> int:
        """n, the numbers of a state."""
        return len(self.state)

    @property
    def dim(self) -> int:
        """d, the numbers of a deviation: n, but for curved parts."""
        return len(self.deviations)

    @property
    def angular(self) -> tuple[bool, ...]:
        """Which deviations of the state are angles that turn."""
        return self.space.periodic

    @property
    def biases(self) -> int:
        """p, the number of components of the bias; 0 without one."""
        return 0 if self.bias is None else self.bias.size

    @property
    def motion_driven(self) -> bool:
        """Whether motion, its noise or its bias takes inputs."""
        others = (self.Q,) if self.bias is None else (self.Q, self.bias.Q, self.bias.motion)
        return self.motion_inputs or any(callable(f) and takes(f, "Q", OF_MOTION) == 3 for f in others)

    def sensor_driven(self, sensor: str) -> bool:
        """Whether a sensor, its noise or its bias takes inputs."""
        others = (self.R[sensor], None if self.bias is None else self.bias.sensor.get(sensor))
        return self.sensor_inputs[sensor] or any(callable(f) and takes(f, "R", OF_SENSOR) == 2 for f in others)

    def noise_inside(self, of: str | None) -> tuple[Callable[..., Any], int] | None:
        """The motion (None) or a sensor as a function of [ξ; x] and the size of ξ; None where its noise is added."""
        return next(((joint, size) for name, joint, size in self.inside if name == of), None)

    def with_bias_prior(self, prior: Gaussian) -> "Model":
        """The model with another prior of its bias, (p,) or (B, p); one without a bias is itself."""
        if self.bias is None:
            return self
        bias = copy.copy(self.bias)
        bias.prior = prior
        return self.with_parts(bias=bias)

    def with_noise(self, sensor: str, R: Noise) -> "Model":
        """The model with another noise of a sensor."""
        return self.with_parts(R={**self.R, sensor: R})

    def with_parts(self, **parts: Any) -> Self:
        """The model with other attributes, which are not checked."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__, **parts)
        return made

    def measured_space(self, sensor: str, size: int) -> Space:
        """Where what a sensor measures lives, which gives `size` numbers."""
        own = self.measured[sensor]
        return Flat((False,) * size) if own is None else own.space

    def measured_deviations(self, sensor: str) -> tuple[str, ...] | None:
        """Names of the deviations of what a sensor measures, None where nothing tells."""
        own = self.measured[sensor]
        return None if own is None else own.deviations

    def measured_angular(self, sensor: str, size: int) -> tuple[bool, ...]:
        """Which deviations of what a sensor measures, `size` numbers, are angles that turn."""
        return self.measured_space(sensor, size).periodic

    def __repr__(self) -> str:
        parts = [f"state {named(self.components.numbers, self.units)}"]
        parts += [
            f"{s or 'sensor'} {'of unnamed components' if names is None else named(names)}"
            for s, names in self.measurement.items()
        ]
        parts += [] if self.bias is None else [f"bias {named(self.bias.names, self.units)}"]
        return f"Model({'; '.join(parts)})"

    def tree_flatten(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """For JAX: noises given as numbers are data, everything else tells one model from another."""
        # What is only shown makes no other model of it: nothing is compiled again for a unit.
        kept = {k: v for k, v in vars(self).items() if k not in ("Q", "R", "units")}
        fixed = tuple((k, tuple(v.items()) if isinstance(v, dict) else v) for k, v in kept.items())
        # A noise that is a function belongs to the model's identity, not to its numbers.
        leaves = tuple(None if callable(v) else v for v in (self.Q, *self.R.values()))
        functions = tuple(v if callable(v) else None for v in (self.Q, *self.R.values()))
        return leaves, (fixed, functions, tuple(self.R))

    @classmethod
    def tree_unflatten(cls, aux: tuple[Any, ...], leaves: tuple[Any, ...]) -> "Model":
        """For JAX: values pass unchecked."""
        fixed, functions, sensors = aux
        made = object.__new__(cls)
        made.units = ()
        for key, value in fixed:
            setattr(made, key, dict(value) if key in ("sensors", "sensor_inputs", "measured") else value)
        noises = [f if leaf is None else leaf for leaf, f in zip(leaves, functions, strict=True)]
        made.Q, made.R = noises[0], dict(zip(sensors, noises[1:], strict=True))
        return made


def check_added(model: Model, what: str) -> None:
    """Refuse a model with noises inside its functions where only those that are added are known.

    Raises:
        InputError: naming what does not know them.
    """
    if any(one.inside for one in getattr(model, "models", (model,))):
        raise InputError(f"{what} knows noises that are added alone, and this model has some inside its functions")


def check_flat(model: Model, what: str) -> None:
    """Refuse a model with a curved part where only numbers and angles are known.

    Raises:
        InputError: naming what does not know it.
    """
    if model.curved:
        raise InputError(
            f"{what} knows numbers and angles alone so far, and this model has parts that turn or point: {model!r}; "
            "run, smooth, Live, studies and exported C take it"
        )
