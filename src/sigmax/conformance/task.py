"""What an implementation is told, and what it has to offer."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from sigmax.errors import InputError, unknown

OFFERS = frozenset({"angles", "missing", "partly missing", "second update"})


# A task is itself and no other: adapters may keep what they compile for it.
@dataclass(frozen=True, eq=False)
class Task:
    """A model for one kind of step; nothing but x changes from step to step.

    Attributes:
        motion: x, xp -> the next state, for x (n,) or many (n, N), by the functions of the module `xp`, which is
            NumPy or `jax.numpy`.
        sensor: x, xp -> the measurement (m,) or (m, N).
        Q: covariance of the motion's noise over a step (n, n).
        R: covariance of the sensor's noise (m, m).
        state_angles: which components of the state are angles, n flags.
        angles: which components of the measurement are angles, m flags.
    """

    motion: Callable[[Any, Any], Any]
    sensor: Callable[[Any, Any], Any]
    Q: np.ndarray
    R: np.ndarray
    state_angles: tuple[bool, ...] = ()
    angles: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "state_angles", self.state_angles or (False,) * len(self.Q))
        object.__setattr__(self, "angles", self.angles or (False,) * len(self.R))

    def f(self, x: Any, *_: Any) -> np.ndarray:
        """The motion in NumPy, with whatever else a library passes ignored."""
        return self.motion(np.asarray(x), np)

    def h(self, x: Any, *_: Any) -> np.ndarray:
        """The sensor in NumPy."""
        return self.sensor(np.asarray(x), np)

    @cached_property
    def jacobians(self) -> tuple[Callable[[Any], np.ndarray], Callable[[Any], np.ndarray]]:
        """Derivatives of motion and sensor, x (n,) -> (n, n) and (m, n), for filters that ask for them."""
        import jax
        import jax.numpy as jnp

        import sigmax.algebra.arrays  # noqa: F401  double precision

        made = [jax.jit(jax.jacfwd(lambda x, g=g: g(x, jnp))) for g in (self.motion, self.sensor)]
        first, second = (lambda x, d=d: np.asarray(d(np.ravel(np.asarray(x, float)))) for d in made)
        return first, second

    def wrapped(self, difference: Any) -> np.ndarray:
        """A difference of measurements (m,) or (..., m), its angles brought into [-π, π)."""
        return wrapped(difference, self.angles)

    def state_wrapped(self, difference: Any) -> np.ndarray:
        """A difference of states (n,) or (..., n), its angles brought into [-π, π)."""
        return wrapped(difference, self.state_angles)


def wrapped(difference: Any, angles: tuple[bool, ...]) -> np.ndarray:
    """A difference (..., k), its angles brought into [-π, π)."""
    d = np.array(difference, float)
    return np.where(angles, (d + np.pi) % (2 * np.pi) - np.pi, d) if any(angles) else d


class Running(Protocol):
    """A filter under way: what an adapter gives back."""

    @property
    def mean(self) -> Any:
        """The estimate (n,)."""

    @property
    def cov(self) -> Any:
        """Its covariance (n, n)."""

    def predict(self) -> None:
        """One step on."""

    def update(self, z: np.ndarray) -> None:
        """Correct with z (m,); all NaN, or where that is offered some NaN, is missing."""


def estimate(running: Running, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of a filter under way; a mean may be a column.

    Raises:
        InputError: for other shapes, which might be broadcast to an answer.
    """
    mean, cov = np.array(running.mean, float), np.array(running.cov, float)
    if mean.shape not in ((n,), (n, 1)) or cov.shape != (n, n):
        raise InputError(
            f"mean and cov must have the shapes {(n,)} and {(n, n)}; they have {mean.shape} and {cov.shape}"
        )
    return mean.ravel(), cov


@dataclass(frozen=True)
class Adapter:
    """An implementation to be tested.

    Attributes:
        name: as it stands in tables.
        start: task, mean (n,), covariance (n, n) -> a filter under way.
        degree: polynomials to this degree have exact means: 1 for an extended filter, 3 for most sigma points.
        offers: what beyond the plain filter it has: "angles", "missing", "partly missing",
            and "second update", a correction that follows another without a prediction between.
        version: of the library.

    Raises:
        InputError: for an offer that no law asks for.
    """

    name: str
    start: Callable[[Task, np.ndarray, np.ndarray], Running]
    degree: int = 3
    offers: frozenset[str] = OFFERS
    version: str = ""

    def __post_init__(self) -> None:
        offers = frozenset([self.offers] if isinstance(self.offers, str) else self.offers)
        for name in offers - OFFERS:
            raise unknown("offer", name, OFFERS)
        object.__setattr__(self, "offers", offers)
