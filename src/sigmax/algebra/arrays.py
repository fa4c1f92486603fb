"""Component-first arrays: a state is (n, ...), a matrix (n, k, ...), and everything behind is batch.

Small products are written as broadcast multiplications and sums, so that a compiler can fuse them
over the batch; a library call per 5 x 5 matrix would cost more than the arithmetic.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.kernel import kernel, like

# Filters subtract nearly equal numbers for a living: double precision is the default of the library.
jax.config.update("jax_enable_x64", True)
# Handing a step of microseconds to another thread costs more than the step.
jax.config.update("jax_cpu_enable_async_dispatch", False)

TWO_PI = 2.0 * np.pi
# Above this many non-zero coefficients a static contraction is left to a matrix product.
_UNROLLED_COEFFICIENTS = 96


def static(coefficients: Any, like: jax.Array, axis: int = 0) -> np.ndarray:
    """Known `coefficients`, shaped to multiply `like` along `axis` and of its type."""
    c = np.asarray(coefficients)
    return c.reshape((1,) * axis + c.shape + (1,) * (like.ndim - axis - c.ndim)).astype(like.dtype)


def spread(a: jax.Array, core: int, batch: tuple[int, ...]) -> jax.Array:
    """`a` with `core` leading axes, repeated over `batch` unless it has the batch already."""
    if a.ndim > core or not batch:
        return a
    return jnp.broadcast_to(a.reshape(a.shape + (1,) * len(batch)), a.shape + batch)


def total(terms: Sequence[jax.Array]) -> jax.Array:
    """The sum of a few arrays: written out, it fuses and vectorises where a reduction would not."""
    return sum(terms[1:], start=terms[0])


@kernel(lambda M, v: like(M.shape[0], of=(M, v), core=(2, 1)))
def times(M: jax.Array, v: jax.Array) -> jax.Array:
    """M v for M (r, k, ...) and v (k, ...): (r, ...)."""
    return total([M[:, k] * v[k] for k in range(M.shape[1])])


@kernel(lambda A, B: like(A.shape[0], B.shape[1], of=(A, B), core=(2, 2)))
def product(A: jax.Array, B: jax.Array) -> jax.Array:
    """A B for A (r, k, ...) and B (k, s, ...): (r, s, ...)."""
    return total([A[:, k, None] * B[None, k] for k in range(A.shape[1])])


@kernel(lambda A, B: like(A.shape[0], B.shape[0], of=(A, B), core=(2, 2)))
def outer(A: jax.Array, B: jax.Array) -> jax.Array:
    """A Bᵀ for A (r, k, ...) and B (s, k, ...): (r, s, ...); exactly symmetric when A is B."""
    return total([A[:, None, k] * B[None, :, k] for k in range(A.shape[1])])


@kernel(lambda A, B: like(A.shape[1], B.shape[1], of=(A, B), core=(2, 2)))
def inner(A: jax.Array, B: jax.Array) -> jax.Array:
    """Aᵀ B for A (k, r, ...) and B (k, s, ...): (r, s, ...); exactly symmetric when A is B."""
    return total([A[k, :, None] * B[k, None] for k in range(A.shape[0])])


def combine(A: jax.Array, coefficients: np.ndarray) -> jax.Array:
    """A C for A (r, k, ...) and a known C (k, s): (r, s, ...), zeros of C costing nothing."""
    k, s = coefficients.shape
    if np.count_nonzero(coefficients) > _UNROLLED_COEFFICIENTS:
        return jnp.moveaxis(jnp.tensordot(A, coefficients.astype(A.dtype), axes=(1, 0)), -1, 1)
    columns = []
    for j in range(s):
        terms = [A[:, i] * float(coefficients[i, j]) for i in range(k) if coefficients[i, j] != 0.0]
        columns.append(sum(terms[1:], start=terms[0]) if terms else jnp.zeros_like(A[:, 0]))
    return jnp.stack(columns, axis=1)


def wrap(difference: jax.Array, angular: Sequence[bool]) -> jax.Array:
    """`difference` (m, ...) with the rows that are angles brought into [-π, π]."""
    if not any(angular):
        return difference
    period = static(np.where(angular, TWO_PI, 0.0), difference)
    turns = static(np.where(angular, 1.0 / TWO_PI, 0.0), difference)
    return difference - period * jnp.round(difference * turns)


def wrapped(difference: np.ndarray, angular: Sequence[bool] | np.ndarray) -> np.ndarray:
    """NumPy differences (…, m), the batch first, with the components that are angles brought into [-π, π]."""
    if not any(angular):
        return difference
    turns = np.where(angular, np.round(difference / TWO_PI), 0.0)
    return difference - TWO_PI * turns


class Lifted:
    """A function written for one x (n,), for x (n, ..., B), that still tells what it was made of.

    Attributes:
        function: `function(x, *arguments)` -> (m,).
        arguments: each with the number of axes it has for one member of the batch; one that has the
            batch behind them is dealt out, one that has not is shared.
        batched: whether x has a batch behind its other axes.
    """

    def __init__(
        self, function: Callable[..., jax.Array], arguments: Sequence[tuple[jax.Array, int]], batched: bool
    ) -> None:
        self.function, self.arguments, self.batched = function, tuple(arguments), batched

    def __call__(self, x: jax.Array) -> jax.Array:
        """The function of x (n, ..., B): (m, ..., B)."""

        def columns(x: jax.Array, *rest: jax.Array) -> jax.Array:
            if x.ndim == 1:
                return jnp.asarray(self.function(x, *rest)).astype(x.dtype)
            return jax.vmap(columns, in_axes=(-1, *(None,) * len(rest)), out_axes=-1)(x, *rest)

        return self.over_batch(columns, x)

    def over_batch(self, function: Callable[..., jax.Array], x: jax.Array) -> jax.Array:
        """Another function of x (n, ...) and of the same arguments, over the batch."""
        values = [value for value, _ in self.arguments]
        if not self.batched:
            return function(x, *values)
        axes = [-1 if value.ndim > core else None for value, core in self.arguments]
        return jax.vmap(function, in_axes=(-1, *axes), out_axes=-1)(x, *values)

    def instead(self, function: Callable[..., jax.Array]) -> "Lifted":
        """Another function of the same arguments."""
        return Lifted(function, self.arguments, self.batched)

    @property
    def single(self) -> list[jax.ShapeDtypeStruct]:
        """Shapes and types of the arguments for one member of the batch."""
        return [jax.ShapeDtypeStruct(jnp.shape(v)[:core], jnp.result_type(v)) for v, core in self.arguments]


def diagonal(M: jax.Array) -> jax.Array:
    """The diagonal (n, ...) of M (n, n, ...)."""
    return jnp.stack([M[i, i] for i in range(len(M))])
