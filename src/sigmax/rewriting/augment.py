"""A model with its bias as part of its state: what engines run, and what truth is drawn from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import times
from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.modelling.bias import joint
from sigmax.modelling.checks import is_traced
from sigmax.modelling.components import Components
from sigmax.modelling.constraint import of_part
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import (
    OF_MOTION,
    OF_SENSOR,
    arguments_of,
    arrays_of,
    by_value,
    dense_noise,
    motion_of,
    sensor_of,
    takes,
)
from sigmax.spaces import Flat, Space, product


def augment(model: Model, first: bool = False) -> Model:
    """The same model without a bias: x⁺ = f(x) ⊞ B(x) b, b⁺ = b and z = h(x) ⊞ F(x) b of the state [x; b].

    B and F are functions of the state like any other: a filter sees their slope in x too.

    Args:
        model: one without a bias is itself.
        first: whether the state is [b; x].
    """
    bias = model.bias
    if bias is None:
        return model
    at = _Joint(model.size, bias.size, first)
    return model.with_parts(
        motion=_remembered(_motion, model.motion, model.motion_inputs, at, model.space, _matrix(bias.motion)),
        motion_inputs=model.motion_driven,
        sensors={
            s: _remembered(_sensor, h, model.sensor_inputs[s], at, _space_of(model, s), _matrix(bias.sensor.get(s)))
            for s, h in model.sensors.items()
        },
        sensor_inputs={s: model.sensor_driven(s) for s in model.sensors},
        components=_components(model.components, bias.names, first),
        Q=_noise(model.Q, bias.Q, at),
        R={s: _remembered(_of_state, R, at) if callable(R) else R for s, R in model.R.items()},
        constraints=of_part(model.constraints, bias.size if first else 0, model.size),
        domain=None if model.domain is None else _remembered(_domain, model.domain, at),
        bias=None,
    )


def with_bias(model: Model, prior: Gaussian, first: bool = False) -> tuple[Model, Gaussian]:
    """The augmented model, and the prior of state and bias together; both as they are where there is no bias."""
    if model.bias is None:
        return model, prior
    return augment(model, first), joint(prior, model.bias.prior, first)


@dataclass(frozen=True)
class _Joint:
    """Where the n numbers of a state and the p of its bias stand in the state of both."""

    n: int
    p: int
    first: bool

    def apart(self, X: jax.Array) -> tuple[jax.Array, jax.Array]:
        return (X[self.p :], X[: self.p]) if self.first else (X[: self.n], X[self.n :])

    def state(self, X: jax.Array) -> jax.Array:
        return self.apart(X)[0]

    def order(self, of_state: Any, of_bias: Any) -> tuple[Any, Any]:
        return (of_bias, of_state) if self.first else (of_state, of_bias)


def _remembered(make: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """A function of augmented states, the same one for the same arguments; what is traced is never the same."""
    return (make.__wrapped__ if is_traced(arguments) else make)(*arguments)  # type: ignore[attr-defined]


def _matrix(C: Any) -> Any:
    return C if is_traced(C) else by_value(C)


def _space_of(model: Model, sensor: str) -> Space:
    own = model.measured[sensor]
    return Flat(()) if own is None else own.space


def _components(own: Components, names: tuple[str, ...], first: bool) -> Components:
    numbers, deviations, spaces = (
        (*b, *a) if first else (*a, *b)
        for a, b in (
            (own.numbers, names),
            (own.deviations, names),
            ((own.space,), (Flat((False,) * len(names)),)),
        )
    )
    return Components(numbers, deviations, product(*spaces))


def _added(space: Space, y: Any, C: Any, b: jax.Array) -> jax.Array:
    """Y ⊞ C b, a plain sum on a flat space.

    Raises:
        InputError: for a C that a function gave with another number of columns.
    """
    value = jnp.asarray(y)
    if C is None:
        return value
    C = jnp.asarray(C).astype(b.dtype)
    if C.ndim != 2 or C.shape[1] != b.shape[0]:
        # The product below takes matrices apart by columns and would not notice.
        raise InputError(
            f"B and F must have a column for each of the {b.shape[0]} components of the bias; one has {C.shape}"
        )
    return value + times(C, b) if space.flat else space.add(value, times(C, b))


@lru_cache(maxsize=256)
def _motion(f: Any, driven: bool, at: _Joint, space: Space, B: Any) -> Any:
    def moved(X: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        x, b = at.apart(X)
        C = B(*arguments_of(B, "B", OF_MOTION, x, dt, u)) if callable(B) else B
        return jnp.concatenate(at.order(_added(space, f(x, dt, *u[:driven]), C, b), b))

    return motion_of(moved, driven or (callable(B) and takes(B, "B", OF_MOTION) == 3))


@lru_cache(maxsize=256)
def _sensor(h: Any, driven: bool, at: _Joint, space: Space, F: Any) -> Any:
    def seen(X: jax.Array, *u: jax.Array) -> jax.Array:
        x, b = at.apart(X)
        C = F(*arguments_of(F, "F", OF_SENSOR, x, None, u)) if callable(F) else F
        return _added(space, h(x, *u[:driven]), C, b)

    return sensor_of(seen, driven or (callable(F) and takes(F, "F", OF_SENSOR) == 2))


@lru_cache(maxsize=256)
def _domain(domain: Any, at: _Joint) -> Any:
    def within(X: jax.Array) -> jax.Array:
        x, b = at.apart(X)
        return jnp.concatenate(at.order(jnp.asarray(domain(x)), b))

    return within


@lru_cache(maxsize=256)
def _of_state(R: Any, at: _Joint) -> Any:
    return sensor_of(lambda X, *u: R(at.state(X), *u), takes(R, "R", OF_SENSOR) == 2)


def _noise(Q: Any, Qb: Any, at: _Joint) -> Any:
    """The noise of both: numbers, or a function of as few arguments as it can be."""
    parts = at.order(Q, Qb)
    if not any(map(callable, parts)):
        array = arrays_of([dense_noise(part) for part in parts])
        if all(isinstance(part, Diagonal) for part in parts):
            return Diagonal(array.concatenate([part.entries for part in parts]))
        a, b = map(dense_noise, parts)
        zero = array.zeros((len(a), len(b)))
        return array.block([[a, zero], [zero.T, b]])
    return _remembered(_noise_function, *map(_plain, (Q, Qb)), at)


def _plain(Q: Any) -> Any:
    """A noise as a function, rows of a covariance, or variances: equal ones are the same, but for what is traced."""
    if not isinstance(Q, Diagonal):
        return _matrix(Q)
    return Q.entries if is_traced(Q) else tuple(map(float, Q.entries))


@lru_cache(maxsize=256)
def _noise_function(Q: Any, Qb: Any, at: _Joint) -> Any:
    def over(part: Any, x: Any, dt: jax.Array, u: tuple[jax.Array, ...]) -> jax.Array:
        if callable(part):
            return jnp.asarray(part(*arguments_of(part, "Q", OF_MOTION, x, dt, u)))
        return jnp.asarray(part, dt.dtype) * dt

    def both(X: Any, dt: Any, *u: Any) -> jax.Array:
        x = None if X is None else at.state(X)
        values = at.order(*(over(part, x, jnp.asarray(dt), u) for part in (Q, Qb)))
        if all(value.ndim == 1 for value in values):
            return jnp.concatenate(values)
        return jax.scipy.linalg.block_diag(*(jnp.diag(value) if value.ndim == 1 else value for value in values))

    most = max(takes(part, "Q", OF_MOTION) if callable(part) else 1 for part in (Q, Qb))
    return (lambda dt: both(None, dt)) if most == 1 else motion_of(both, most == 3)
