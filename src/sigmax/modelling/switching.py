"""A target that does one thing or another: models that take turns as a Markov chain does."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.components import Components
from sigmax.modelling.model import Model
from sigmax.modelling.noise import Noise
from sigmax.spaces import Flat, Space, product

Entries = tuple[tuple[str, Any, Any], ...]


class Rates(NamedTuple):
    """Rates of change A of a chain that may run backwards, A = left diag(values) right: exp(A dt) at any dt."""

    left: Any
    values: Any
    right: Any


@jax.tree_util.register_pytree_node_class
class SwitchingModel(Model):
    """Models by name that take turns: see `imm`, which makes one.

    Its state has the components of all modes, each once, in the order in which they first come.

    Attributes:
        names: of the modes.
        models: one for each mode.
        filters: of each mode; None where it takes the filter of the run.
        transition: probabilities (M, M) from row to column at each step, or a function of dt that gives them.
        rates: of the chain in continuous time, in the place of a transition.
        initial: probabilities (M,) at the prior.
        entry: component, mean and variance with which what a mode does not have comes into one that has it.
    """

    names: tuple[str, ...]
    models: tuple[Model, ...]
    filters: tuple[Any, ...]
    transition: Any
    rates: Rates | None
    initial: Any
    entry: Entries

    def __init__(
        self,
        modes: Mapping[str, tuple[Model, Any]],
        transition: Any,
        rates: Rates | None,
        initial: Any,
        entry: Entries,
    ) -> None:
        self.names, self.models = tuple(modes), tuple(model for model, _ in modes.values())
        self.filters = tuple(filter for _, filter in modes.values())
        self.transition, self.rates, self.initial, self.entry = transition, rates, initial, entry
        first = self.models[0]
        self.components = united([m.components for m in self.models])
        self.units = tuple(dict(pair for m in reversed(self.models) for pair in m.units).items())
        self.several, self.measured = first.several, first.measured
        self.domain = self.bias = self.fusion = None
        self.constraints = self.inside = ()
        inputs = {m.inputs for m in self.models} - {None}
        self.inputs = inputs.pop() if len(inputs) == 1 else None
        self.motion_inputs = any(m.motion_inputs for m in self.models)
        self.sensor_inputs = {s: any(m.sensor_inputs[s] for m in self.models) for s in first.sensors}
        self.motion, self.sensors = _no_function("motion"), {s: _no_function("sensor") for s in first.sensors}
        self.Q, self.R = self.motion, dict.fromkeys(first.sensors, self.motion)

    @property
    def modes(self) -> dict[str, Model]:
        """The models by name."""
        return dict(zip(self.names, self.models, strict=True))

    @property
    def sojourn(self) -> np.ndarray | None:
        """Seconds in each mode on average (M,), where the chain is in continuous time."""
        if self.rates is None:
            return None
        left, values, right = (np.asarray(a) for a in self.rates)
        return -1 / np.einsum("ik,k,ki->i", left, values, right)

    @property
    def motion_driven(self) -> bool:
        """Whether a mode's motion takes inputs."""
        return any(m.motion_driven for m in self.models)

    def sensor_driven(self, sensor: str) -> bool:
        """Whether a sensor takes inputs in some mode."""
        return any(m.sensor_driven(sensor) for m in self.models)

    @property
    def curved(self) -> bool:
        """Whether a mode is."""
        return any(m.curved for m in self.models)

    def with_noise(self, sensor: str, R: Noise) -> "SwitchingModel":
        """The model with another noise of a sensor, in all modes."""
        return self.with_models([m.with_noise(sensor, R) for m in self.models])

    def with_models(self, models: Sequence[Model]) -> "SwitchingModel":
        """The model with others of the same components in the place of its own."""
        return self.with_parts(models=tuple(models))

    def transitions(self, dt: Any) -> Any:
        """Probabilities (M, M, ...) that a target in one mode (row) is in another (column) dt later; at 0 it stays."""
        M = len(self.models)
        dt = jnp.asarray(dt)
        stay = jnp.eye(M, dtype=dt.dtype).reshape(M, M, *(1,) * dt.ndim)
        if self.rates is not None:
            left, values, right = (jnp.asarray(a, dt.dtype) for a in self.rates)
            grown = jnp.exp(values.reshape(M, *(1,) * dt.ndim) * dt)
            P = sum(
                left[:, k].reshape(M, 1, *(1,) * dt.ndim) * right[k].reshape(1, M, *(1,) * dt.ndim) * grown[k]
                for k in range(M)
            )
            P = jnp.maximum(P, 0)
        elif callable(self.transition):
            given = self.transition if dt.ndim == 0 else jax.vmap(self.transition, in_axes=-1, out_axes=-1)
            P = jnp.asarray(given(dt)).astype(dt.dtype)
        else:
            P = jnp.asarray(self.transition, dt.dtype).reshape(stay.shape)
        return jnp.where(dt > 0, P / P.sum(1)[:, None], stay)

    def __repr__(self) -> str:
        return f"imm({'; '.join(f'{name}: {model!r}' for name, model in self.modes.items())})"

    def tree_flatten(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """For JAX: the models' noises, probabilities and entries are data."""
        fixed = callable(self.transition)
        leaves = (
            self.models,
            None if fixed else self.transition,
            self.rates,
            self.initial,
            [e[1:] for e in self.entry],
        )
        kept = self.names, self.filters, self.transition if fixed else None, tuple(e[0] for e in self.entry)
        return leaves, kept

    @classmethod
    def tree_unflatten(cls, aux: tuple[Any, ...], leaves: tuple[Any, ...]) -> "SwitchingModel":
        """For JAX: values pass unchecked."""
        (names, filters, function, entered), (models, transition, rates, initial, entry) = aux, leaves
        modes = {n: (m, f) for n, m, f in zip(names, models, filters, strict=True)}
        pairs = tuple((name, *pair) for name, pair in zip(entered, entry, strict=True))
        return cls(modes, function or transition, rates, initial, pairs)


def united(several: Sequence[Components]) -> Components:
    """The components of all, each once."""
    found: dict[str, tuple[tuple[str, ...], tuple[str, ...], Space]] = {}
    for own in several:
        for label, part in parts_by_name(own).items():
            if found.setdefault(label, part)[2] != part[2]:
                raise InputError(f"{label} must be the same in all modes; it is {found[label][2]} and {part[2]}")
    points, deviations, spaces = zip(*found.values(), strict=True)
    return Components(sum(points, ()), sum(deviations, ()), product(*spaces))


def parts_by_name(own: Components) -> dict[str, tuple[tuple[str, ...], tuple[str, ...], Space]]:
    """Numbers one by one and curved parts whole: names of numbers and deviations, and the space, by the first name."""
    found: dict[str, tuple[tuple[str, ...], tuple[str, ...], Space]] = {}
    for space, at, to in own.space.parts():
        points, deviations = own.numbers[at], own.deviations[to]
        if space.flat:
            for name, turns in zip(points, space.periodic, strict=True):
                found[name] = (name,), (name,), Flat((turns,))
        else:
            found[points[0]] = points, deviations, space
    return found


def check_one_mode(model: Model, what: str) -> None:
    """Refuse a model of several modes where only one is known.

    Raises:
        InputError: naming what does not know it.
    """
    if isinstance(model, SwitchingModel):
        raise InputError(
            f"{what} knows models of one mode alone so far, and this one has {list(model.names)}: take "
            "model.modes[NAME]; run, smooth, fit and Live take it as a whole"
        )


def _no_function(what: str) -> Callable[..., Any]:
    def ask_the_modes(*_: Any) -> Any:
        raise InputError(f"a model of several modes has no one {what}: take model.modes[NAME]")

    return ask_the_modes
