"""Small linear systems by Gaussian elimination, in operations that lower to C; large ones by LAPACK, through JAX."""

from typing import Any

import jax.numpy as jnp

# Beyond it so many operations take longer to compile than they save.
_LARGEST = 8


def solve(A: Any, b: Any) -> Any:
    """A⁻¹ b for A (n, n) and b (n,) or (n, k)."""
    A, b = jnp.asarray(A), jnp.asarray(b)
    n = A.shape[-1]
    if A.ndim != 2 or n > _LARGEST or A.shape[0] != n:
        return jnp.linalg.solve(A, b)
    rows, right, _ = _eliminated(list(A), list(b))
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            right[k] = right[k] - rows[k][j] * right[j]
        right[k] = right[k] / rows[k][k]
    return jnp.stack(right)


def inv(A: Any) -> Any:
    """A⁻¹ for A (n, n)."""
    A = jnp.asarray(A)
    small = A.ndim == 2 and A.shape[0] == A.shape[1] <= _LARGEST
    return solve(A, jnp.eye(len(A), dtype=A.dtype)) if small else jnp.linalg.inv(A)


def det(A: Any) -> Any:
    """The determinant of A (n, n)."""
    A = jnp.asarray(A)
    if A.ndim != 2 or not A.shape[0] == A.shape[1] <= _LARGEST:
        return jnp.linalg.det(A)
    rows, _, sign = _eliminated(list(A), list(jnp.zeros((len(A), 1), A.dtype)))
    for k, row in enumerate(rows):
        sign = sign * row[k]
    return sign


def _eliminated(rows: list[Any], right: list[Any]) -> tuple[list[Any], list[Any], Any]:
    """An upper triangle with the same solution, the largest pivots on its diagonal, and the sign of the exchanges."""
    n, sign = len(rows), jnp.ones((), rows[0].dtype)
    for k in range(n):
        for i in range(k + 1, n):
            larger = jnp.abs(rows[i][k]) > jnp.abs(rows[k][k])
            rows[k], rows[i] = jnp.where(larger, rows[i], rows[k]), jnp.where(larger, rows[k], rows[i])
            right[k], right[i] = jnp.where(larger, right[i], right[k]), jnp.where(larger, right[k], right[i])
            sign = jnp.where(larger, -sign, sign)
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i], right[i] = rows[i] - factor * rows[k], right[i] - factor * right[k]
    return rows, right, sign
