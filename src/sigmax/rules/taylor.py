"""Taylor rules: derivatives along the columns of the factor; no Jacobian or Hessian is ever formed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from math import factorial, prod
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import combine, wrap
from sigmax.errors import InputError
from sigmax.rules.linearization import Function, Linearization, slope_of


@dataclass(frozen=True)
class Taylor1:
    """First order: the rule of the extended Kalman filter. One evaluation and n derivatives."""

    # The line is that at x̂, however far S reaches.
    local: ClassVar[bool] = True

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """ŷ = g(x̂), E_j = dg[s_j], nothing left over."""
        y, slope = slope_of(g, x, S)
        return Linearization(wrap(y, angular), slope, slope[:, :0], slope[:, :0])


@dataclass(frozen=True)
class Taylor2:
    """Second order: the rule of the polynomial filter (Stepanov et al., (18)-(22)).

    Exact for quadratic g. With h_ij = d²g[s_i, s_j] the mean gains ½ Σ h_jj, the covariance
    ½ Σ_ij h_ij h_ijᵀ. n(n+1)/2 second derivatives.

    Attributes:
        mean: keep the term of the mean (d in the paper).
        covariance: keep the term of the covariance (D in the paper); without it at the prediction
            the filter is the second-order filter SOKF.
    """

    mean: bool = True
    covariance: bool = True

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """ŷ = g(x̂) + ½ Σ h_jj, E_j = dg[s_j], N = (h_ij for i < j, h_jj / √2)."""
        y, slope = slope_of(g, x, S)
        n = S.shape[1]
        i, j = (np.concatenate(pair) for pair in zip(np.triu_indices(n, 1), (np.arange(n),) * 2, strict=True))

        def along(v: jax.Array) -> jax.Array:
            def first(at: jax.Array) -> jax.Array:
                return jax.jvp(g, (at,), (v[0],))[1]

            return jax.jvp(first, (x,), (v[1],))[1]

        pairs = jnp.stack([S[:, i], S[:, j]])
        h = jax.vmap(along, in_axes=2, out_axes=1)(pairs)
        mixed, pure = h[:, : len(i) - n], h[:, len(i) - n :]
        mean = y + 0.5 * pure.sum(1) if self.mean else y
        residual = jnp.concatenate([mixed, pure * np.sqrt(0.5).astype(h.dtype)], axis=1)
        if not self.covariance:
            residual = residual[:, :0]
        return Linearization(wrap(mean, angular), slope, residual, slope[:, :0])


@dataclass(frozen=True)
class Taylor:
    """Any order: exact for polynomials of that degree, mean, slope and covariance (order 1 is Taylor1, 2 is Taylor2).

    With d_a = ∂^a g along the columns of S, y = Σ_a d_a ξ^a / a! = Σ_b c_b He_b(ξ) / b! in Hermite polynomials, which
    are orthogonal with E[He_b²] = b!: c_b = Σ_j d_{b+2j} / (2^|j| j!). So ŷ = c_0, E_i = c_{e_i} and Cov(y) is a sum of
    squares at every order. C(n + order, order) derivatives; no tensor is formed. The slope of order 3 and more is that
    of a regression, no longer the Jacobian.

    Not for functions whose series does not converge within some standard deviations, such as a range seen from
    nearer than two of them: there the variance grows with the order.

    Attributes:
        order: the degree of the polynomial that stands for the function.

    Raises:
        InputError: for an order below 1.
    """

    order: int = 3

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or isinstance(self.order, bool) or self.order < 1:
            raise InputError(f"the order of a Taylor rule is a number such as 3; it is {self.order!r}")

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """ŷ, E and N = (c_b / √b! for |b| ≥ 2) from the derivatives of each order."""
        n = S.shape[1]
        derivatives = [g(x)[:, None]]
        for order in range(1, self.order + 1):
            places = np.array(list(combinations_with_replacement(range(n), order)))
            directions = jnp.stack([S[:, column] for column in places.T])
            derivatives.append(jax.vmap(lambda v: _along(g, x, v), in_axes=2, out_axes=1)(directions))
        made = combine(jnp.concatenate(derivatives, axis=1), _hermite(n, self.order).astype(x.dtype))
        return Linearization(wrap(made[:, 0], angular), made[:, 1 : 1 + n], made[:, 1 + n :], made[:, :0])


def _along(g: Function, x: jax.Array, directions: jax.Array) -> jax.Array:
    """The derivative of g at x along one direction after the other."""
    for v in directions:
        g = _derivative(g, v)
    return g(x)


def _derivative(g: Function, v: jax.Array) -> Function:
    return lambda at: jax.jvp(g, (at,), (v,))[1]


@lru_cache(maxsize=64)
def _hermite(n: int, order: int) -> np.ndarray:
    """What derivatives of all orders, by the columns they are along, make ŷ, the columns of E and those of N."""
    columns = [a for k in range(order + 1) for a in combinations_with_replacement(range(n), k)]
    C = np.zeros((len(columns), len(columns)))
    for row, a in enumerate(columns):
        for column, b in enumerate(columns):
            rest = Counter(a)
            rest.subtract(b)
            if all(count >= 0 and count % 2 == 0 for count in rest.values()):
                halves = [count // 2 for count in rest.values()]
                factorials = prod(factorial(h) for h in halves)
                within = prod(factorial(count) for count in Counter(b).values())
                C[row, column] = 1 / (2 ** sum(halves) * factorials * within**0.5)
    return C


def order_of(rule: object) -> int | None:
    """The order of a Taylor rule, which takes C(n + order, order) values and derivatives; None of another rule."""
    if isinstance(rule, Taylor):
        return rule.order
    return {Taylor1: 1, Taylor2: 2}.get(type(rule))
