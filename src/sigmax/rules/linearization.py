"""What every rule gives and every form takes."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import jax

Function = Callable[[jax.Array], jax.Array]


class Linearization(NamedTuple):
    """y = g(x), x ~ N(x̂, S Sᵀ), as a straight line and what the line misses; noise not yet added.

    Cov(x, y) = S Eᵀ and Cov(y) = E Eᵀ + N Nᵀ − D Dᵀ.

    Attributes:
        mean: ŷ (m, ...), angles in [-π, π].
        slope: E (m, n, ...), the regression matrix times S.
        residual: N (m, r, ...), r ≥ 0, what the line misses.
        deficit: D (m, q, ...), q ≥ 0, columns that a negative weight takes away.
    """

    mean: jax.Array
    slope: jax.Array
    residual: jax.Array
    deficit: jax.Array


class Rule(Protocol):
    """A hashable object that linearises g about N(x, S Sᵀ); `angular` marks the outputs that are angles."""

    def __call__(self, g: Function, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
        """Linearise g: (n, ..., B) -> (m, ..., B), given x (n, B) and S (n, n, B), B possibly absent."""
        ...


def slope_of(g: Function, x: jax.Array, S: jax.Array) -> tuple[jax.Array, jax.Array]:
    """g(x̂), and its derivative along each column of S (n, k, ...): (m, k, ...); no Jacobian is formed."""
    y, derivative = jax.linearize(g, x)
    return y, jax.vmap(derivative, in_axes=1, out_axes=1)(S)
