"""A random bias of motion and sensors: constants that nobody knows, or that wander slowly."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import finite, is_traced, numbers, own, strings
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, noise, takes
from sigmax.tracing import traceable


class Bias:
    """A bias b (p,) of every motion and of sensors: x⁺ = f(x) + B b, z = h(x) + F b, b⁺ = b + w.

    The filter estimates it beside the state (Zhang et al., (14)); no state is put together by hand. In curved parts B b
    and F b are deviations (d rows): a turn of an attitude about the axes of the body, applied behind the motion.

    Args:
        prior: of the bias, N(b0, P_b0), (p,) or (B, p) for a batch.
        motion: B (n, p), added at every prediction as it stands, or a function `B(dt)`, `B(x, dt)` or
            `B(x, dt, u)` that gives it for the interval; None where the motion has no bias.
        sensor: F (m, p), or a function `F(x)` or `F(x, u)`; by name where there are several sensors, those
            that are not named having no bias. What depends on time takes it from the inputs u. With F = range b is
            an unknown scale of the range: F(x) b is a function of both, which filters treat as they do h.
        Q: noise of the bias as in `Model`: variances (p,) or a covariance per second, or a function of dt;
            None for a constant.
        names: of the components; counted where they are not given.

    Raises:
        InputError: for shapes or numbers that do not fit.
    """

    def __init__(
        self,
        *,
        prior: Gaussian,
        motion: Any = None,
        sensor: Any = None,
        Q: Any = None,
        names: Sequence[str] | None = None,
    ) -> None:
        if not isinstance(prior, Gaussian):
            raise InputError(f"the prior of a bias must be a sigmax.Gaussian, it is {type(prior).__name__}")
        p = prior.size
        self.prior = prior
        self.names = tuple(f"bias{i}" for i in range(p)) if names is None else strings("names", names)
        if not len(self.names) == len(set(self.names)) == p:
            raise InputError(
                f"names must be {p} different names, one a component of the bias; given {list(self.names)}"
            )
        acting = list(sensor.values()) if isinstance(sensor, Mapping) else [sensor]
        if motion is None and all(F is None for F in acting):
            raise InputError("a bias must act on something: give motion=, sensor= or both")
        self.motion = coefficients("the motion's bias B", motion, p, OF_MOTION)
        given = sensor if isinstance(sensor, Mapping) else {"": sensor}
        self.by_name = isinstance(sensor, Mapping)
        self.sensor = {
            s: coefficients(f"the bias F of the sensor {s!r}" if s else "the sensor's bias F", F, p, OF_SENSOR)
            for s, F in given.items()
            if F is not None
        }
        self.Q = noise("the bias's Q", np.zeros(p) if Q is None else Q, self.names, OF_MOTION)

    @property
    def size(self) -> int:
        """p, the number of components."""
        return len(self.names)

    def fitted(
        self,
        state: Sequence[str],
        deviations: Sequence[str],
        sensors: Mapping[str, Sequence[str] | None],
        several: bool,
    ) -> "Bias":
        """The bias, checked against the model it belongs to, by the names of its numbers and deviations.

        Raises:
            InputError: where it does not fit.
        """
        if several != self.by_name and self.sensor:
            kind = "several sensors: give sensor= as a dict by name" if several else "one sensor: give sensor=F itself"
            raise InputError(f"the model has {kind} in Bias")
        for s in self.sensor:
            if s not in sensors:
                raise unknown("sensor", s, sensors)
        same = {*state, *deviations} & set(self.names)
        if same:
            raise InputError(f"state and bias have components of the same name: {sorted(same)}; give Bias(names=…)")
        _check_rows("the motion's bias B", self.motion, deviations)
        for s, F in self.sensor.items():
            _check_rows(f"the bias F of the sensor {s!r}" if s else "the sensor's bias F", F, sensors[s])
        return self

    def __repr__(self) -> str:
        return f"Bias({', '.join(self.names)})"


def coefficients(what: str, given: Any, p: int, allowed: tuple[int, ...]) -> Any:
    """A matrix with a column for each component of the bias, or the function that gives it."""
    if given is None:
        return None
    if callable(given):
        takes(given, what, allowed)
        return traceable(given)
    value = own(numbers(what, given))
    if value.ndim == 1 and p == 1:
        value = value[:, None]
    if value.ndim != 2 or value.shape[1] != p:
        raise InputError(f"{what} must have a column for each of the {p} components of the bias; it has {value.shape}")
    finite(what, value)
    return value


def _check_rows(what: str, value: Any, names: Sequence[str] | None) -> None:
    if value is None or callable(value) or names is None:
        return
    if value.shape[0] != len(names):
        named = list(map(str, names))
        raise InputError(f"{what} must have {len(names)} rows, one for each of {named}; it has {value.shape[0]}")


def joint(prior: Gaussian, bias: Gaussian, first: bool) -> Gaussian:
    """The prior of state and bias together, (a,) or (B, a), the two independent of each other.

    Raises:
        InputError: where both have a batch, of different size.
    """
    parts = (bias, prior) if first else (prior, bias)
    array: Any = jnp if is_traced(parts) else np
    batches = {len(p.mean) for p in parts if p.mean.ndim == 2} | {len(p.cov) for p in parts if p.cov.ndim == 3}
    if len(batches) > 1:
        raise InputError(f"the priors of state and bias have batches of different size: {sorted(batches)}")
    of_mean, of_cov = (array.broadcast_shapes(*shapes) for shapes in zip(*_batches(parts), strict=True))
    mean = array.concatenate([array.broadcast_to(p.mean, (*of_mean, p.size)) for p in parts], -1)
    n, m = (p.dim for p in parts)
    P, Q = (array.broadcast_to(p.cov, (*of_cov, p.dim, p.dim)) for p in parts)
    zero = array.zeros((*of_cov, n, m))
    upper, lower = (array.concatenate(row, -1) for row in ((P, zero), (array.swapaxes(zero, -1, -2), Q)))
    return Gaussian.unchecked(mean, array.concatenate([upper, lower], -2))


def _batches(parts: Sequence[Gaussian]) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    return [(p.mean.shape[:-1], p.cov.shape[:-2]) for p in parts]
