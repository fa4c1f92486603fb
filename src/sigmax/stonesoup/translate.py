"""Models of Stone Soup as functions that sigmax can compile; more are added by registering a function."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import singledispatch
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantNthDerivative,
    LinearGaussianTimeInvariantTransitionModel,
)
from stonesoup.models.transition.nonlinear import ConstantTurn

from sigmax.errors import InputError
from sigmax.models import Model, angle
from sigmax.models.smooth import cosc, sinc
from sigmax.tracing import traceable


class Moved(NamedTuple):
    """A transition model: `function(x, dt)` gives the state (n,), `Q(dt)` the noise of the interval (n, n)."""

    function: Callable[[Any, Any], Any]
    Q: Callable[[Any], Any]
    size: int


class Seen(NamedTuple):
    """A measurement model.

    Attributes:
        function: `function(x)`, or `function(x, u)` where there are numbers u; equal structures share one function,
            so that a sensor that moves is compiled once.
        u: where the sensor stands, how it is turned, how fast it is; None where nothing of this matters.
        R: covariance (m, m).
        angles: the type of Stone Soup that each component has, None for plain numbers.
        size: n.
    """

    function: Callable[..., Any]
    u: np.ndarray | None
    R: np.ndarray
    angles: tuple[type | None, ...]
    size: int


@singledispatch
def motion_of(model: Any) -> Moved:
    """The motion of a transition model of Stone Soup.

    Raises:
        InputError: for a class that has no translation yet.
    """
    raise _untranslated(model, "motion_of", "Moved")


@singledispatch
def sensor_of(model: Any) -> Seen:
    """The sensor of a measurement model of Stone Soup.

    Raises:
        InputError: for a class that has no translation yet.
    """
    raise _untranslated(model, "sensor_of", "Seen")


def model_of(transition: Any, measurement: Any, state: Sequence[str] | None = None) -> Model:
    """Stone Soup's models as a model of sigmax: for `run`, `smooth`, `Live`, studies and the tracker.

    Args:
        transition: a transition model.
        measurement: a measurement model, or several by name.
        state: names of the components.

    Raises:
        InputError: for a class that has no translation yet, and where the components differ in number.
    """
    moved = motion_of(transition)
    several = isinstance(measurement, Mapping)
    seen = {s: sensor_of(m) for s, m in (measurement if several else {"": measurement}).items()}
    hear = {s: _standing(one) for s, one in seen.items()}
    for one in seen.values():
        if one.size != moved.size:
            raise InputError(f"the transition model has {moved.size} components, a measurement model {one.size}")
    if state is not None and len(state) != moved.size:
        raise InputError(f"the transition model has {moved.size} components, state names {len(state)}")
    names = {s: tuple(_name(k, a) for k, a in enumerate(one.angles)) for s, one in seen.items()}
    noises = {s: one.R for s, one in seen.items()}
    return Model(
        motion=moved.function,
        Q=moved.Q,
        sensor=hear if several else hear[""],
        R=noises if several else noises[""],
        state=state or tuple(f"x{k}" for k in range(moved.size)),
        measurement=names if several else names[""],
    )


def _name(k: int, kind: type | None) -> str:
    return f"z{k}" if kind is None else angle(f"z{k}")


def _standing(seen: Seen) -> Callable[[Any], Any]:
    if seen.u is None:
        return seen.function
    u = jnp.asarray(seen.u)
    function = traceable(seen.function)
    return lambda x: function(x, u)


def _untranslated(model: Any, function: str, gives: str) -> InputError:
    name = f"{type(model).__module__}.{type(model).__qualname__}"
    return InputError(
        f"{name} has no translation yet; register one: @sigmax.stonesoup.{function}.register on a function that takes "
        f"the model and gives sigmax.stonesoup.{gives}"
    )


def _derivatives(orders: tuple[int, ...], q: np.ndarray) -> Moved:
    """Blocks of a position and its derivatives, the highest one driven by white noise of density q."""
    starts = np.cumsum([0, *(n + 1 for n in orders)])
    size = int(starts[-1])

    def function(x: Any, dt: Any) -> Any:
        moved = []
        for start, N in zip(starts, orders, strict=False):
            for i in range(N + 1):
                moved.append(sum(x[start + j] * dt ** (j - i) / math.factorial(j - i) for j in range(i, N + 1)))
        return jnp.stack(moved)

    def Q(dt: Any) -> Any:
        entries = [[0.0 * dt] * size for _ in range(size)]
        for start, N, density in zip(starts, orders, q, strict=False):
            for i in range(N + 1):
                for j in range(N + 1):
                    scale = math.factorial(N - i) * math.factorial(N - j) * (2 * N + 1 - i - j)
                    entries[start + i][start + j] = float(density) / scale * dt ** (2 * N + 1 - i - j)
        return jnp.stack([jnp.stack([jnp.asarray(e) for e in row]) for row in entries])

    return Moved(function, Q, size)


@motion_of.register
def _(model: ConstantNthDerivative) -> Moved:
    return _derivatives((model.constant_derivative,), np.array([model.noise_diff_coeff]))


@motion_of.register
def _(model: CombinedLinearGaussianTransitionModel) -> Moved:
    parts = model.model_list
    if all(isinstance(p, ConstantNthDerivative) for p in parts):
        orders = tuple(p.constant_derivative for p in parts)
        return _derivatives(orders, np.array([p.noise_diff_coeff for p in parts]))
    moved = [motion_of(p) for p in parts]
    starts = np.cumsum([0, *(m.size for m in moved)])

    def function(x: Any, dt: Any) -> Any:
        return jnp.concatenate(
            [traceable(m.function)(x[a : a + m.size], dt) for m, a in zip(moved, starts, strict=False)]
        )

    def Q(dt: Any) -> Any:
        rows = []
        for i, m in enumerate(moved):
            blocks = [m.Q(dt) if i == j else jnp.zeros((m.size, other.size)) for j, other in enumerate(moved)]
            rows.append(jnp.concatenate(blocks, axis=1))
        return jnp.concatenate(rows)

    return Moved(function, Q, int(starts[-1]))


@motion_of.register
def _(model: LinearGaussianTimeInvariantTransitionModel) -> Moved:
    F, Q = np.asarray(model.matrix(), float), np.asarray(model.covar(), float)
    return Moved(lambda x, dt: jnp.asarray(F) @ x, lambda dt: jnp.asarray(Q) + 0.0 * dt, len(F))


@motion_of.register
def _(model: ConstantTurn) -> Moved:
    q = np.asarray(model.linear_noise_coeffs, float).ravel()
    straight = _derivatives((1, 1, 0), np.array([*q, float(model.turn_noise_coeff)]))

    def function(x: Any, dt: Any) -> Any:
        a = x[4] * dt
        along, across = dt * sinc(a), dt * cosc(a)
        c, s = jnp.cos(a), jnp.sin(a)
        return jnp.stack(
            [
                x[0] + along * x[1] - across * x[3],
                c * x[1] - s * x[3],
                x[2] + across * x[1] + along * x[3],
                s * x[1] + c * x[3],
                x[4],
            ]
        )

    return Moved(function, straight.Q, 5)
