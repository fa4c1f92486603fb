"""Weights of a measurement by its innovation: how much of it is taken where noise has heavy tails."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError


class Weighed(NamedTuple):
    """What a weight says of one innovation.

    Attributes:
        weights: ω (m, ...) of its components, their variances are divided by them; a sensor with 0 in it is refused.
        log_density: of e (...), what a likelihood needs; over the components seen.
        growth: what S is multiplied by where the measurement is refused (...), at least 1.
    """

    weights: jax.Array
    log_density: jax.Array
    growth: jax.Array | float = 1.0


class Weight(Protocol):
    """A hashable function of e = S_y⁻¹ ν (m, ...), 0 where a component is missing, and of how many are seen (...).

    Where it has a method `chi_square(e)` besides, reports judge a filter by it: see `Student.chi_square`.
    """

    def __call__(self, e: jax.Array, seen: jax.Array) -> Weighed:
        """The weights of one measurement, before it is used."""
        ...


@dataclass(frozen=True)
class Student:
    """ω = (ν + m) / (ν + |e|²), at most 1, of a sensor as a whole: its innovation has the tails of Student's t.

    Attributes:
        dof: ν, above 0; the smaller, the more outliers it expects.
    """

    dof: float = 4.0

    def __post_init__(self) -> None:
        _positive("dof of the student update", self.dof)

    def __call__(self, e: jax.Array, seen: jax.Array) -> Weighed:
        """The weight of the expectation step of a scale mixture (Huang et al. 2017), by the innovation."""
        from scipy.special import gammaln  # a fifth of the time of importing this package

        squared, nu = (e * e).sum(0), self.dof
        weight = jnp.minimum(1, (nu + seen) / (nu + squared))
        m = np.arange(e.shape[0] + 1)
        volume = gammaln((nu + m) / 2) - gammaln(nu / 2) - m / 2 * math.log(nu * math.pi)
        density = _of(volume, seen, e) - (nu + seen) / 2 * jnp.log1p(squared / nu)
        return Weighed(jnp.broadcast_to(weight, e.shape), density)

    def chi_square(self, e: np.ndarray) -> np.ndarray:
        """|e|² (...) of e (m, ...), NaN where missing, as the chi-square variable that is exceeded as seldom.

        With S_y for its scale e is Student's t, and |e|²/m is F(m, ν).
        """
        from scipy.special import chdtri, fdtrc

        seen = np.maximum((~np.isnan(e)).sum(0), 1)
        return chdtri(seen, fdtrc(seen, self.dof, np.nansum(e * e, 0) / seen))


@dataclass(frozen=True)
class Huber:
    """ω_j = c / |e_j|, at most 1, of each component by itself: quadratic near 0, straight beyond c.

    Attributes:
        threshold: c, above 0; 1.345 keeps 95 % of the efficiency where the noise is Gaussian.
    """

    threshold: float = 1.345

    def __post_init__(self) -> None:
        _positive("threshold of the huber update", self.threshold)

    def __call__(self, e: jax.Array, seen: jax.Array) -> Weighed:
        """Huber's weight (Robust Estimation of a Location Parameter, 1964) and the density that it belongs to."""
        c, size = self.threshold, jnp.abs(e)
        far = size > c
        weights = jnp.where(far, c / jnp.where(far, size, 1), 1)
        loss = jnp.where(far, c * size - c * c / 2, e * e / 2)
        return Weighed(weights, -loss.sum(0) - seen * math.log(self._mass))

    def chi_square(self, e: np.ndarray) -> np.ndarray:
        """|e|² (...) of e (m, ...), NaN where missing, as the chi-square variable that is exceeded as seldom."""
        from scipy.special import chdtri, ndtr

        c, size = self.threshold, np.abs(e)
        beyond = 2 / c * np.exp(c * c / 2 - c * np.maximum(size, c))
        within = 2 * math.sqrt(2 * math.pi) * (ndtr(c) - ndtr(np.minimum(size, c)))
        return np.nansum(chdtri(1, np.minimum((beyond + within) / self._mass, 1)), 0)

    @property
    def _mass(self) -> float:
        """What the density of a component has to be divided by."""
        from scipy.special import ndtr

        c = self.threshold
        return float(math.sqrt(2 * math.pi) * (2 * ndtr(c) - 1) + 2 / c * math.exp(-c * c / 2))


@dataclass(frozen=True)
class Gate:
    """A measurement with |e|² beyond the quantile p of χ² is not used; each refusal widens the covariance.

    A gate alone locks itself out: a filter that is wrong and sure of itself refuses all that could tell it. So S grows
    with every refusal, and what is refused again and again is taken at last.

    Attributes:
        probability: p, with which a measurement passes if the filter is right.
        growth: what a refusal multiplies standard deviations by, at least 1; 1 for no way back.
    """

    probability: float = 0.999
    growth: float = 1.5

    def __post_init__(self) -> None:
        if not 0 < _number("probability of the gate", self.probability) < 1:
            raise InputError(f"probability of the gate must lie between 0 and 1; it is {self.probability!r}")
        if not _number("growth of the gate", self.growth) >= 1:
            raise InputError(f"growth of the gate must be at least 1; it is {self.growth!r}")

    def __call__(self, e: jax.Array, seen: jax.Array) -> Weighed:
        """1 or 0; the density is that of a measurement of which only the refusal is known beyond the gate."""
        from scipy.special import gammaincinv

        squared = (e * e).sum(0)
        limit = np.append(0, 2 * gammaincinv(np.arange(1, e.shape[0] + 1) / 2, self.probability))
        inside = squared <= _of(limit, seen, e)
        density = -0.5 * (squared + seen * math.log(2 * math.pi))
        told = jnp.where(inside, density, math.log1p(-self.probability))
        return Weighed(jnp.broadcast_to(jnp.where(inside, 1.0, 0.0).astype(e.dtype), e.shape), told, self.growth)


# Every weight by its name; laws, texts and tables take them from here.
WEIGHTS: dict[str, Callable[..., Weight]] = {"student": Student, "huber": Huber, "gate": Gate}


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{what} must be a finite number; it is {value!r}")
    return float(value)


def _positive(what: str, value: Any) -> None:
    if not _number(what, value) > 0:
        raise InputError(f"{what} must be above 0; it is {value!r}")


def _of(table: np.ndarray, count: jax.Array, like: jax.Array) -> jax.Array:
    """The entry of a table by the number of components seen (...)."""
    numbers = table.astype(like.dtype)
    return sum((jnp.where(count == k, n, 0) for k, n in enumerate(numbers)), start=jnp.zeros_like(like[0]))
