"""A triangle corrected by rotations: it stays one, and its diagonal is only ever multiplied."""

import jax
import jax.numpy as jnp

from sigmax.algebra.factor import Absorbed, Matrix, absorb, dense, reciprocal, safe_sqrt, tria, triangle

# XLA takes minutes over the m n rotations of more columns than this; reflections are m, and n for the triangle.
_ROTATED = 20


def rotate(L: Matrix, A: jax.Array, B: jax.Array) -> Absorbed:
    """`absorb` for a lower triangle B (n, n, ...): [[L, A], [0, B]] → [[factor, 0], [cross, rest]], rest lower too.

    Each row of A (m, n, ...) is turned into its pivot from the last column on: what the pivot's column has taken up
    of B lies below the column that comes next (Carlson's triangular correction, as rotations). The diagonal of
    B is multiplied by cosines, so that nothing that cancels can be left in it.
    """
    n = A.shape[1]
    if n > _ROTATED:
        factor, cross, rest = absorb(L, A, B)
        return Absorbed(factor, cross, tria(rest))
    L = dense(L)
    columns, crosses = [], []
    for i in range(A.shape[0]):
        pivot, below = L[i, i], L[i + 1 :, i]
        cross = jnp.zeros_like(B[:0, 0])
        rows, parts = [], []
        for j in range(n - 1, -1, -1):
            norm, positive = safe_sqrt(pivot * pivot + A[0, j] * A[0, j])
            scale = reciprocal(norm, positive)
            cosine, sine = jnp.where(positive, pivot * scale, 1), A[0, j] * scale
            rows.append(cosine * A[1:, j] - sine * below)
            below = cosine * below + sine * A[1:, j]
            head, tail = B[j : j + 1, j], B[j + 1 :, j]
            parts.append(jnp.concatenate([cosine * head, cosine * tail - sine * cross]))
            cross = jnp.concatenate([sine * head, cosine * cross + sine * tail])
            pivot = norm
        columns.append(jnp.concatenate([pivot[None], below]))
        crosses.append(cross)
        A, B = jnp.stack(rows[::-1], axis=1), triangle(parts[::-1])
    return Absorbed(triangle(columns), jnp.stack(crosses, axis=1), B)
