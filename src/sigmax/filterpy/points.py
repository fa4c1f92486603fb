"""Sigma points with FilterPy's parameters, order and weights, drawn from a factor where one is known."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy.steps import factor


class _Points:
    """Points x + S ξ for the rows ξ of `unit` (N, n); `Wm`, `Wc` (N,) are the weights of mean and covariance.

    Args:
        sqrt_method: P -> an upper triangle (or any matrix) U with UᵀU = P, in place of the Cholesky factor.
        subtract: (x, y) -> x − y, where states do not simply subtract.
    """

    unit: np.ndarray
    Wm: np.ndarray
    Wc: np.ndarray

    def __init__(self, n: int, sqrt_method: Callable[[Any], Any] | None, subtract: Callable[[Any, Any], Any] | None):
        self.n = n
        self.sqrt = sqrt_method
        self.subtract = np.subtract if subtract is None else subtract

    def num_sigmas(self) -> int:
        """The number of points."""
        return len(self.unit)

    def sigma_points(self, x: Any, P: Any) -> np.ndarray:
        """The points (N, n) for mean x (n,) and covariance P (n, n), or a variance.

        Raises:
            InputError: where x has not n components.
        """
        P = np.asarray(P, float)
        P = np.eye(self.n) * P if P.ndim == 0 else np.atleast_2d(P)
        return self.around(x, factor(P))

    def around(self, x: Any, S: np.ndarray) -> np.ndarray:
        """The points (N, n) for mean x (n,) and the factor S (n, n) of its covariance."""
        x = np.ravel(np.asarray(x, float))
        if len(x) != self.n:
            raise InputError(f"these points are for {self.n} components, x has {len(x)}")
        if self.sqrt is not None:
            S = np.asarray(self.sqrt(S @ S.T)).T
        spread = self.unit @ S.T
        if self.subtract is np.subtract:
            return x + spread
        return np.array([self.subtract(x, -row) for row in spread])


def _axes(n: int, squared: float) -> np.ndarray:
    """The centre, then ±√squared along each axis."""
    if not squared > 0:
        raise InputError(f"the spread of the points must be above 0: it is √{squared} for {n} components")
    reach = np.eye(n) * np.sqrt(squared)
    return np.concatenate([np.zeros((1, n)), reach, -reach])


class MerweScaledSigmaPoints(_Points):
    """The scaled set of 2n + 1 points: λ = α²(n + κ) − n (van der Merwe 2004).

    Take alpha = 1 unless you know better: alpha = 1e-3 makes weights of 1e6 and loses as many digits.
    """

    def __init__(
        self, n: int, alpha: float, beta: float, kappa: float, sqrt_method: Any = None, subtract: Any = None
    ) -> None:
        super().__init__(n, sqrt_method, subtract)
        self.alpha, self.beta, self.kappa = alpha, beta, kappa
        squared = alpha**2 * (n + kappa)
        self.unit = _axes(n, squared)
        self.Wm = np.full(2 * n + 1, 0.5 / squared)
        self.Wm[0] = 1 - n / squared
        self.Wc = self.Wm.copy()
        self.Wc[0] += 1 - alpha**2 + beta


class JulierSigmaPoints(_Points):
    """The general set of 2n + 1 points with a centre of weight κ/(n + κ) (Julier and Uhlmann 1997)."""

    def __init__(self, n: int, kappa: float = 0.0, sqrt_method: Any = None, subtract: Any = None) -> None:
        super().__init__(n, sqrt_method, subtract)
        self.kappa = kappa
        self.unit = _axes(n, n + kappa)
        self.Wm = np.full(2 * n + 1, 0.5 / (n + kappa))
        self.Wm[0] = kappa / (n + kappa)
        self.Wc = self.Wm


class SimplexSigmaPoints(_Points):
    """N + 1 points of equal weight; `alpha` is kept as an attribute and changes nothing, as in FilterPy."""

    def __init__(self, n: int, alpha: float = 1, sqrt_method: Any = None, subtract: Any = None) -> None:
        super().__init__(n, sqrt_method, subtract)
        self.alpha = alpha
        self.unit = np.zeros((n + 1, n))
        for d in range(1, n + 1):
            size = np.sqrt((n + 1) / (d * (d + 1)))
            self.unit[:d, d - 1] = size if d > 1 else -size
            self.unit[d, d - 1] = -d * size if d > 1 else size
        self.Wm = np.full(n + 1, 1 / (n + 1))
        self.Wc = self.Wm


def plain(points: Any) -> bool:
    """Whether points are drawn as here, from a factor: a class of the user's may draw them otherwise."""
    return isinstance(points, _Points) and type(points).sigma_points is _Points.sigma_points


class Cubature(_Points):
    """The 2n points of the third degree, without a centre (Arasaratnam and Haykin 2009)."""

    def __init__(self, n: int) -> None:
        super().__init__(n, None, None)
        self.unit = _axes(n, n)[1:]
        self.Wm = np.full(2 * n, 0.5 / n)
        self.Wc = self.Wm
