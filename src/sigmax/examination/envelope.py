"""A model inside a family of models: a parameter for each thing that can be wrong with it, read from the inputs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import Diagonal
from sigmax.modelling.model import Model, check_added
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of


@dataclass(frozen=True)
class Parameter:
    """One number that is 0 in the model as it stands.

    Attributes:
        kind: "bias", "scale", "R", "Q", "drift", "delay", "skew", "rotation", "input offset", "input gain",
            "input delay", "input rotation", "clock" or "prior".
        where: the component, sensor or input that it belongs to.
        at: its place there: of the deviation in the sensor, of the state, of the input; of Q the components of a group.
        sensor: the sensor it belongs to, None for what is not of one.
    """

    kind: str
    where: str
    at: tuple[int, ...] = ()
    sensor: str | None = None


@dataclass(frozen=True)
class Envelope:
    """The family.

    Attributes:
        model: reads its parameters from the inputs: u as it was, by how much a delay changes it, θ, in the place of a
            skew the delay that it has come to, what is added to R of each component, a factor of Q; `prior` alone is no
            matter of the model.
        plain: the model as it stands.
        parameters: θ, in the order of the inputs.
        given: how many inputs the model had, R by row included.
        driven: how many of these are the user's.
        sizes: deviations of each sensor: of numbers and angles as many as it has numbers.
    """

    model: Model
    plain: Model
    parameters: tuple[Parameter, ...]
    given: int
    driven: int
    sizes: tuple[tuple[str, int], ...]

    @property
    def measured(self) -> int:
        """Components of all sensors together."""
        return sum(m for _, m in self.sizes)


def parameters_of(
    model: Model,
    sizes: dict[str, int],
    driven: int,
    groups: list[tuple[int, ...]],
    axes: list[tuple[int, int]],
    returns: bool,
) -> tuple[Parameter, ...]:
    """The parameters of a model.

    Args:
        model: the model.
        sizes: how many deviations each sensor has.
        driven: how many inputs the user has.
        groups: components of the motion's noise that hang together.
        axes: pairs of inputs that are components of one vector.
        returns: whether the motion can go back, without which there are no delays.
    """
    found: list[Parameter] = []
    for s, m in sizes.items():
        names, angular = component_names(model, s, m), model.measured_angular(s, m)
        plain = [] if curved(model, s) else [j for j in range(m) if not angular[j]]
        found += [Parameter("bias", names[j], (j,), s) for j in range(m)]
        found += [Parameter("scale", names[j], (j,), s) for j in plain]
        found += [Parameter("R", names[j], (j,), s) for j in range(m)]
        found += [Parameter("rotation", f"{names[j]}, {names[j + 1]}", (j, j + 1), s) for j in plain if j + 1 in plain]
        if len(sizes) > 1 and returns:
            found += [Parameter("delay", s, (), s), Parameter("skew", s, (), s)]
    states = [str(name) for name in model.deviations]
    found += [Parameter("Q", ", ".join(states[i] for i in group), group) for group in groups]
    found += [Parameter("drift", name, (i,)) for i, name in enumerate(states)]
    found += [Parameter("prior", name, (i,)) for i, name in enumerate(states)]
    inputs = input_names(model, driven)
    for kind in ("input offset", "input gain"):
        found += [Parameter(kind, name, (i,)) for i, name in enumerate(inputs)]
    found += [Parameter("input rotation", f"{inputs[i]}, {inputs[j]}", (i, j)) for i, j in axes]
    found += [Parameter("input delay", "inputs")] if driven and model.motion_inputs else []
    return (*found, Parameter("clock", "dt"))


def component_names(model: Model, sensor: str, size: int) -> list[str]:
    """What the deviations of a sensor are called, the sensor in front where there are several."""
    names = model.measured_deviations(sensor) or tuple(f"z{j}" for j in range(size))
    return [f"{sensor}.{name}" if sensor else str(name) for name in names]


def curved(model: Model, sensor: str) -> bool:
    """Whether a sensor measures more than numbers and angles."""
    own = model.measured[sensor]
    return own is not None and not own.space.flat


def input_names(model: Model, driven: int) -> list[str]:
    """What the inputs are called, or which they are."""
    named = model.inputs
    return list(named) if named is not None and len(named) == driven else [f"input {i}" for i in range(driven)]


def envelope(
    model: Model, parameters: tuple[Parameter, ...], given: int, driven: int, sizes: tuple[tuple[str, int], ...]
) -> Envelope:
    """The family of a model that has no bias and is not fused."""
    check_added(model, "the doctor")
    at = _Places(parameters, given, driven, sum(m for _, m in sizes))
    sensors, noises, before = {}, {}, 0
    for s, m in sizes:
        sensors[s] = _sensor(model, s, m, at)
        noises[s] = _sensor_noise(model.R[s], s, m, before, at)
        before += m
    made = model.with_parts(
        motion=_motion(model, at),
        motion_inputs=True,
        sensors=sensors,
        sensor_inputs=dict.fromkeys(sensors, True),
        Q=_motion_noise(model.Q, at),
        R=noises,
        inputs=None,
    )
    return Envelope(made, model, parameters, given, driven, sizes)


class _Places:
    """Where things stand in the inputs of the envelope."""

    def __init__(self, parameters: tuple[Parameter, ...], given: int, driven: int, measured: int) -> None:
        self.parameters, self.given, self.driven = parameters, given, driven
        self.theta = given + driven
        self.extra = self.theta + len(parameters)
        self.q_factor = self.extra + measured

    def value(self, u: Any, kind: str, at: tuple[int, ...] | None = None, sensor: str | None = None) -> Any:
        """The value of a parameter, None where there is none."""
        for i, p in enumerate(self.parameters):
            if p.kind == kind and (at is None or p.at == at) and p.sensor == sensor:
                return u[self.theta + i]
        return None

    def inputs(self, u: Any, delayed: bool = False) -> Any:
        """The inputs of the model: of the motion late, then stretched, offset and turned."""
        if not self.given:
            return u[:0]
        parts = []
        for i in range(self.given):
            value = u[i]
            if i < self.driven:
                value = value + u[self.given + i] if delayed else value
                value = value * (1 + self.value(u, "input gain", (i,))) + self.value(u, "input offset", (i,))
            parts.append(value)
        for i, j in (p.at for p in self.parameters if p.kind == "input rotation"):
            parts[i], parts[j] = _turned(parts[i], parts[j], self.value(u, "input rotation", (i, j)))
        return jnp.stack(parts)


def _turned(a: Any, b: Any, angle: Any) -> tuple[Any, Any]:
    return jnp.cos(angle) * a - jnp.sin(angle) * b, jnp.sin(angle) * a + jnp.cos(angle) * b


def _motion(model: Model, at: _Places) -> Callable[..., Any]:
    def moved(x: Any, dt: Any, u: Any) -> Any:
        own = (at.inputs(u, True),) if model.motion_inputs else ()
        y = jnp.asarray(model.motion(x, dt * (1 + at.value(u, "clock")), *own))
        off = dt * jnp.stack([at.value(u, "drift", (i,)) for i in range(model.dim)])
        return model.space.add(y, off) if model.curved else y + off

    return moved


def _motion_noise(Q: Any, at: _Places) -> Callable[..., Any]:
    def noise(x: Any, dt: Any, u: Any) -> Any:
        if callable(Q):
            value = jnp.asarray(Q(*arguments_of(Q, "Q", OF_MOTION, x, dt, (at.inputs(u, True),))))
        else:
            value = jnp.asarray(Q.entries if isinstance(Q, Diagonal) else Q) * dt
        groups = {i: at.value(u, "Q", p.at) for p in at.parameters if p.kind == "Q" for i in p.at}
        return _stretched(value, [groups.get(i, 0.0) for i in range(value.shape[0])]) * u[at.q_factor]

    return noise


def _stretched(value: Any, logs: list[Any]) -> Any:
    """D V D with D² = diag(eˡ), of variances or a covariance."""
    root = jnp.exp(jnp.stack([jnp.asarray(log, value.dtype) for log in logs]) / 2)
    return value * root * root if value.ndim == 1 else value * root[:, None] * root[None, :]


def _sensor(model: Model, s: str, m: int, at: _Places) -> Callable[..., Any]:
    h, driven, motion, moving = model.sensors[s], model.sensor_inputs[s], model.motion, model.motion_inputs

    def seen(x: Any, u: Any) -> Any:
        late, inputs = at.value(u, "delay", sensor=s), at.inputs(u)
        if late is not None:
            x = jnp.asarray(motion(x, -(late + at.value(u, "skew", sensor=s)), *((inputs,) if moving else ())))
        y = jnp.asarray(h(x, *((inputs,) if driven else ())))
        if curved(model, s):
            return model.measured_space(s, m).add(y, jnp.stack([at.value(u, "bias", (j,), s) for j in range(m)]))
        parts = [y[j] for j in range(m)]
        for j in range(m - 1):
            turn = at.value(u, "rotation", (j, j + 1), s)
            if turn is not None:
                parts[j], parts[j + 1] = _turned(parts[j], parts[j + 1], turn)
        for j in range(m):
            scale = at.value(u, "scale", (j,), s)
            parts[j] = (parts[j] if scale is None else parts[j] * (1 + scale)) + at.value(u, "bias", (j,), s)
        return jnp.stack(parts)

    return seen


def _sensor_noise(R: Any, s: str, m: int, before: int, at: _Places) -> Callable[..., Any]:
    def noise(x: Any, u: Any) -> Any:
        if callable(R):
            value = jnp.asarray(R(*arguments_of(R, "R", OF_SENSOR, x, None, (at.inputs(u),))))
        else:
            value = jnp.asarray(R.entries if isinstance(R, Diagonal) else R)
        value = _stretched(value, [at.value(u, "R", (j,), s) for j in range(m)])
        extra = u[at.extra + before : at.extra + before + m]
        return value + extra if value.ndim == 1 else value + jnp.diag(extra)

    return noise
