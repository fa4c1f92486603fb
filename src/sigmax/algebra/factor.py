"""Triangular factors: lower, diagonal not negative, P = S Sᵀ. All that can fail says so.

Arrays are component first (see `arrays`); loops run over rows in Python and over columns and batch
in array operations, so that a step of a filter becomes one straight line for the compiler.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer, static
from sigmax.algebra.kernel import kernel, like


class Diagonal(NamedTuple):
    """A diagonal matrix by its entries (n, ...): the zeros beside them are known and cost nothing."""

    entries: Any


Matrix = jax.Array | Diagonal


def dense(M: Matrix) -> jax.Array:
    """M as an array (n, n, ...)."""
    if not isinstance(M, Diagonal):
        return M
    return jnp.where(static(np.eye(len(M.entries)), M.entries[:, None]) > 0, M.entries[:, None], 0)


def identity(like: jax.Array) -> jax.Array:
    """I (k, k, ...) of the type and batch of an array (n, k, ...)."""
    return dense(Diagonal(jnp.ones(like.shape[1:], like.dtype)))


def raised(L: Matrix, least: jax.Array) -> Matrix:
    """A triangle whose diagonal is nowhere below `least` (n, ...); to the last bit as it was where it is above."""
    if isinstance(L, Diagonal):
        return Diagonal(jnp.maximum(L.entries, least))
    return jnp.where(static(np.eye(len(L)), L) > 0, jnp.maximum(L, least[:, None]), L)


def safe_sqrt(a: jax.Array) -> tuple[jax.Array, jax.Array]:
    """√a with the derivative 0 where a ≤ 0, and where a > 0."""
    positive = a > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, a, 1)), 0), positive


def reciprocal(a: jax.Array, where: jax.Array) -> jax.Array:
    """1 / a, and 0 with the derivative 0 elsewhere."""
    return jnp.where(where, 1 / jnp.where(where, a, 1), 0)


def triangle(columns: list[jax.Array]) -> jax.Array:
    """Columns given from the diagonal down, as one lower triangle (n, n, ...)."""
    zero = jnp.zeros_like(columns[0][:1])
    return jnp.stack([jnp.concatenate([zero] * j + [c]) if j else c for j, c in enumerate(columns)], axis=1)


@kernel(lambda P: (like(*P.shape[:2], of=(P,), core=(2,)), like(of=(P,), core=(2,), dtype=bool)))
def cholesky(P: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Factor of a positive semidefinite P (n, n, ...), and whether it is sound (...).

    A pivot within rounding of zero gives a zero column (a component known exactly, or a combination
    of others); one that is clearly negative makes the result unsound, and so does a covariance with a component
    that has no variance left. Rounding in a pivot grows as the pivots before it shrink: only what is beyond that
    counts. n³/3 multiplications.
    """
    n = P.shape[0]
    rounding = 8 * n * float(np.finfo(P.dtype).eps)
    variance = jnp.stack([P[i, i] for i in range(n)])
    sound = jnp.isfinite(variance.sum(0))
    growth = jnp.ones_like(variance[0])
    columns = []
    for j in range(n):
        pivot = P[0, 0]
        sound &= pivot >= -rounding * growth * jnp.abs(variance[j])
        usable = pivot > rounding * variance[j]
        diagonal, _ = safe_sqrt(jnp.where(usable, pivot, 0))
        scale = reciprocal(diagonal, usable)
        growth = jnp.maximum(growth, jnp.where(usable, variance[j] * scale * scale, 1))
        # P_ij² ≤ P_ii P_jj, of what is left.
        most = 4 * rounding * growth * jnp.abs(variance[j] * variance[j + 1 :])
        sound &= usable | (P[1:, 0] * P[1:, 0] <= most).all(0)
        below = P[1:, 0] * scale
        columns.append(jnp.concatenate([diagonal[None], below]))
        P = P[1:, 1:] - below[:, None] * below[None]
    return triangle(columns), sound


class Mirror(NamedTuple):
    """A reflection of the last columns of a matrix, I − weight v vᵀ, and the sign its first column gets."""

    v: jax.Array
    weight: jax.Array
    sign: jax.Array


@kernel(lambda A: like(A.shape[0], A.shape[0], of=(A,), core=(2,)))
def tria(A: jax.Array) -> jax.Array:
    """Lower L (r, r, ...) with L Lᵀ = A Aᵀ for A (r, k, ...), k ≥ r, by Householder reflections.

    The reflection takes the sign that loses no digits and the column is turned afterwards, so that
    the diagonal is not negative; derivatives are right also where A is triangular already.
    """
    return reflected(A)[0]


def reflected(A: jax.Array, rows: int | None = None) -> tuple[jax.Array, list[Mirror]]:
    """`tria(A)` and its reflections, A U = [L, 0]; of k columns and k = `rows` those rows alone, L (r, k, ...)."""
    columns, mirrors = [], []
    for _ in range(A.shape[0] if rows is None else rows):
        row, below = A[0], A[1:]
        squared = (row * row).sum(0)
        norm, nonzero = safe_sqrt(squared)
        turn = jnp.where(row[0] >= 0, 1.0, -1.0).astype(A.dtype)
        head = row[0] + turn * norm
        mirror = jnp.concatenate([head[None], row[1:]])
        scale = reciprocal(squared + jnp.abs(row[0]) * norm, nonzero)
        weight = (below * mirror[None]).sum(1) * scale
        columns.append(jnp.concatenate([norm[None], turn * (weight * head - below[:, 0])]))
        mirrors.append(Mirror(mirror, scale, -turn))
        A = below[:, 1:] - weight[:, None] * mirror[None, 1:]
    return triangle(columns), mirrors


def turned_back(E: jax.Array, mirrors: list[Mirror]) -> jax.Array:
    """[E, 0] Uᵀ (m, k, ...) for E (m, r, ...): what E is by the columns that were reflected; no division."""
    m, r = E.shape[:2]
    k = mirrors[0].v.shape[0]
    E = jnp.concatenate([E, jnp.zeros((m, k - r, *E.shape[2:]), E.dtype)], axis=1) if k > r else E
    for j in range(r - 1, -1, -1):
        v, weight, sign = mirrors[j]
        tail = jnp.concatenate([(E[:, j] * sign)[:, None], E[:, j + 1 :]], axis=1)
        along = (tail * v[None]).sum(1) * weight
        E = jnp.concatenate([E[:, :j], tail - along[:, None] * v[None]], axis=1)
    return E


class Absorbed(NamedTuple):
    """[[factor, 0], [cross, rest]], the pre-array [[L, A], [0, B]] after reflections from the right."""

    factor: jax.Array
    cross: jax.Array
    rest: jax.Array


def _absorbed(L: Matrix, A: jax.Array, B: jax.Array) -> Any:
    (m, k), n, of = A.shape[:2], B.shape[0], (*jax.tree.leaves(L), A, B)
    core = (1 if isinstance(L, Diagonal) else 2, 2, 2)
    parts: Any = [like(*shape, of=of, core=core) for shape in ((m, m), (n, m), (n, k))]
    return Absorbed(*parts)


@kernel(_absorbed)
def absorb(L: Matrix, A: jax.Array, B: jax.Array) -> Absorbed:
    """Reflect A (m, k, ...) into the triangle L, carrying the rows B (n, k, ...) along.

    factor factorᵀ = L Lᵀ + A Aᵀ, cross factorᵀ = B Aᵀ, and rest restᵀ = B Bᵀ − cross crossᵀ:
    a sum of covariances, a gain and a correction in one pass of m reflections over k + 1 columns.
    """
    m = A.shape[0]
    columns, crosses = [], []
    for k in range(m):
        pivot = L.entries[k] if isinstance(L, Diagonal) else L[k, k]
        row, below = A[0], A[1:]
        norm, nonzero = safe_sqrt(pivot * pivot + (row * row).sum(0))
        head = pivot + norm
        scale = reciprocal(norm * head, nonzero)
        weight = (below * row[None]).sum(1)
        beside = None if isinstance(L, Diagonal) else L[k + 1 :, k]
        if beside is not None:
            weight = weight + beside * head
        weight = weight * scale
        turned = weight * head if beside is None else weight * head - beside
        columns.append(jnp.concatenate([norm[None], turned]))
        A = below - weight[:, None] * row[None]
        weight = (B * row[None]).sum(1) * scale
        crosses.append(weight * head)
        B = B - weight[:, None] * row[None]
    return Absorbed(triangle(columns), jnp.stack(crosses, axis=1), B)


def add(L: Matrix, A: jax.Array) -> jax.Array:
    """Factor of L Lᵀ + A Aᵀ for a triangle L (n, n, ...) and any columns A (n, k, ...)."""
    return absorb(L, A, A[:0]).factor if A.shape[1] else dense(L)


def downdate(L: jax.Array, V: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Factor of L Lᵀ − V Vᵀ for V (n, q, ...), and whether it exists (...): O(n² q)."""
    less, sound = release(L, V, L[:0])
    return less.factor, sound


@kernel(lambda L, V, B: (_absorbed(L, V, B), like(of=(L, V, B), core=(2, 2, 2), dtype=bool)))
def release(L: jax.Array, V: jax.Array, B: jax.Array) -> tuple[Absorbed, jax.Array]:
    """The opposite of `absorb`: [[L, V], [B, 0]] → [[factor, 0], [cross, rest]], and whether the factor exists (...).

    factor factorᵀ = L Lᵀ − V Vᵀ, cross factorᵀ = B Lᵀ, cross crossᵀ − rest restᵀ = B Bᵀ. The J-orthogonal
    triangularisation: a hyperbolic rotation a row in mixed form for one column, a hyperbolic reflection a row
    for several. Where the difference is not positive definite there is no real factor: unsound, never silent.
    """
    n, several = L.shape[0], V.shape[1] > 1
    sound = jnp.ones(L.shape[2:], bool)
    L = jnp.concatenate([L, B])
    V = jnp.concatenate([V, jnp.zeros((len(B), *V.shape[1:]), V.dtype)])
    columns = []
    for k in range(n):
        pivot, beside, row, below = L[k, k], L[k + 1 :, k], V[0], V[1:]
        size = safe_sqrt((row * row).sum(0))[0] if several else row[0]
        new, positive = safe_sqrt((pivot - size) * (pivot + size))
        sound &= positive | ((pivot == 0) & (size == 0))
        if several:
            head = pivot + new
            weight = (beside * head - (below * row[None]).sum(1)) * reciprocal(new * head, positive)
            turned = jnp.where(positive, weight * head - beside, beside)
            V = below - weight[:, None] * row[None]
        else:
            cosine = jnp.where(positive, new * reciprocal(pivot, positive), 1)
            sine = size * reciprocal(pivot, positive)
            turned = (beside - sine * below[:, 0]) / cosine
            V = cosine * below - sine * turned[:, None]
        columns.append(jnp.concatenate([new[None], turned]))
    whole = triangle(columns)
    return Absorbed(whole[:n], whole[n:], V), sound


@kernel(lambda L, b: like(*b.shape[: 1 + (b.ndim == L.ndim)], of=(L, b), core=(2, 1 + (b.ndim == L.ndim))))
def solve_lower(L: jax.Array, b: jax.Array) -> jax.Array:
    """L⁻¹ b for a lower triangle L (m, m, ...) and b (m, ...) or (m, k, ...)."""
    wide = b.ndim == L.ndim
    rows: list[jax.Array] = []
    for i in range(L.shape[0]):
        rest = b[i]
        for j in range(i):
            entry = L[i, j][None] if wide else L[i, j]
            rest = rest - entry * rows[j]
        rows.append(rest / (L[i, i][None] if wide else L[i, i]))
    return jnp.stack(rows)


def pivoted(L: jax.Array) -> jax.Array:
    """L with 1 where a pivot is 0, so that it can be solved with: there is a component known exactly."""
    known = jnp.stack([L[i, i] <= 0 for i in range(len(L))])
    return L + dense(Diagonal(jnp.where(known, 1, 0).astype(L.dtype)))


@kernel(lambda L: like(*L.shape[:2], of=(L,), core=(2,)))
def inverse_lower(L: jax.Array) -> jax.Array:
    """L⁻¹ of a lower triangle L (n, n, ...)."""
    one = jnp.ones(L.shape[:1] + L.shape[2:], L.dtype)
    return solve_lower(L, dense(Diagonal(one)))


def square(M: Matrix) -> jax.Array:
    """M Mᵀ, exactly symmetric."""
    return dense(Diagonal(M.entries**2)) if isinstance(M, Diagonal) else outer(M, M)
