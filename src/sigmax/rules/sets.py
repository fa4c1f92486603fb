"""Families of sigma sets: each is a function of n."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sigmax.errors import InputError
from sigmax.rules.sigma_set import SigmaSet, sigma_set

_LARGEST = 20_000


Family = Callable[..., SigmaSet]


def _symmetric(
    points: np.ndarray, weights: ArrayLike, centre: float, centre_covariance: float | None = None
) -> SigmaSet:
    """A symmetric set from one of each pair; the centre is left out where it has no weight at all."""
    w = np.broadcast_to(np.asarray(weights, float), len(points))
    kept = w != 0
    covariance = centre if centre_covariance is None else centre_covariance
    n = points.shape[1]
    evaluated = None if centre == 0.0 and covariance == 0.0 else centre
    return SigmaSet(points[kept], w[kept], np.empty((0, n)), np.empty(0), evaluated, covariance)


def unscented(n: int, w0: float = 0.0) -> SigmaSet:
    """The general unscented transform: 2n points and a centre of weight w0 < 1; w0 = 0 is the basic one."""
    if not w0 < 1:
        raise InputError(f"w0 must be below 1, it is {w0}")
    return _symmetric(np.eye(n) * math.sqrt(n / (1 - w0)), (1 - w0) / (2 * n), w0)


def scaled(n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> SigmaSet:
    """The scaled unscented transform; γ² = α²(n + κ), W0 = 1 − n/γ² (+ 1 − α² + β in covariances).

    The default α = 1 keeps all digits; α = 1e-3 loses four of them at an offset of 1e6.
    """
    squared = alpha**2 * (n + kappa)
    if not squared > 0:
        raise InputError(f"alpha²(n + kappa) must be above 0; it is {squared} for n = {n}, {alpha=}, {kappa=}")
    w0 = 1 - n / squared
    return _symmetric(np.eye(n) * math.sqrt(squared), 1 / (2 * squared), w0, w0 + 1 - alpha**2 + beta)


def cubature(n: int, degree: int = 3) -> SigmaSet:
    """Spherical-radial cubature: degree 3 with 2n points, degree 5 with 2n² + 1 (Zhang et al., (7)-(9)).

    The weights of degree 5 are negative on the axes for n > 4, and zero there for n = 4.
    """
    if degree == 3:
        return unscented(n)
    if degree != 5:
        raise InputError(f"cubature is known to degree 3 and 5, not {degree}; see gauss_hermite for more")
    radius = math.sqrt(n + 2)
    pairs = [(j, k) for j in range(n) for k in range(j + 1, n)]
    plus = np.array([np.eye(n)[j] + np.eye(n)[k] for j, k in pairs]).reshape(-1, n)
    minus = np.array([np.eye(n)[j] - np.eye(n)[k] for j, k in pairs]).reshape(-1, n)
    points = radius * np.concatenate([plus / math.sqrt(2), minus / math.sqrt(2), np.eye(n)])
    weights = np.r_[np.full(2 * len(pairs), 1 / (n + 2) ** 2), np.full(n, (4 - n) / (2 * (n + 2) ** 2))]
    return _symmetric(points, weights, 2 / (n + 2))


def simplex(n: int, moireau: bool = False) -> SigmaSet:
    """N + 1 points of equal weight, exact to degree 2; the first component takes two values only.

    With `moireau` the last one does, the order in which Moireau and Chapelle write the rows: a function that reads
    the first components alone then has one more different point to be evaluated at.
    """
    points = np.zeros((n + 1, n))
    for i in range(n):
        head = n - i
        points[head, i] = math.sqrt((n + 1) * head / (head + 1))
        points[:head, i] = -points[head, i] / head
    return sigma_set(points[:, ::-1] if moireau else points, np.full(n + 1, 1 / (n + 1)))


def gauss_hermite(n: int, order: int = 3) -> SigmaSet:
    """The product rule of `order` points an axis, exact to degree 2·order − 1 in each: orderⁿ points."""
    if order < 2:
        raise InputError(f"Gauss–Hermite needs at least 2 points an axis, not {order}")
    if order**n > _LARGEST:
        raise InputError(f"{order} points an axis are {order**n} points in {n} dimensions; take cubature degree 5")
    x, w = np.polynomial.hermite_e.hermegauss(order)
    x, w = (x - x[::-1]) / 2, (w + w[::-1]) / (2 * w.sum())
    points = np.stack(np.meshgrid(*[x] * n, indexing="ij"), -1).reshape(-1, n)
    weights = np.prod(np.stack(np.meshgrid(*[w] * n, indexing="ij"), -1), -1).ravel()
    half = len(points) // 2
    centre = float(weights[half]) if order % 2 else 0.0
    return _symmetric(points[:half], weights[:half], centre)


def projected(n: int, of: Family, biases: int, **parameters: Any) -> SigmaSet:
    """What the set of a family in n + biases dimensions leaves on the first n, equal points merged.

    The integral of a function of the first n components alone is the same by both sets; cubature of
    degree 5 leaves 2n² + 2n + 1 points for any number of biases, degree 3 leaves 2n + 1.

    Raises:
        InputError: for a set that is not symmetric.
    """
    whole = of(n + biases, **parameters)
    if len(whole.singles):
        raise InputError(f"only a symmetric set can be projected; {of.__name__} gives one that is not")
    return whole.projected(n)


@lru_cache(maxsize=256)
def unit_set(family: Family, parameters: tuple[tuple[str, Any], ...], n: int) -> SigmaSet:
    """The set of a family in n dimensions, made once."""
    made = family(n, **dict(parameters))
    if made.dimension != n:
        raise InputError(f"the sigma set {family.__name__} has {made.dimension} dimensions, the state has {n}")
    return made


@lru_cache(maxsize=256)
def unit_counts(
    family: Family, parameters: tuple[tuple[str, Any], ...], n: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Its `counts` and `sizes`, found once."""
    unit = unit_set(family, parameters, n)
    return unit.counts, unit.sizes
