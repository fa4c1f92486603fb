"""A covariance seen from another point: what belongs to the tangent at x is turned into that at x ⊞ δ."""

from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import reflected
from sigmax.spaces.space import Space


def reset(space: Space, x: Any, delta: Any, S: Any) -> Any:
    """The lower factor (d, d, ...) of J S Sᵀ Jᵀ of a lower S (d, d, ...), J = J(x, δ).

    A curved part at the coordinates [k, k + p) turns its own rows, and its own p columns are triangularised again
    in all rows from k on; everything else of S stays (Markley, Attitude error representations for Kalman filtering).
    """
    for p, at, to in space.parts():
        if p.flat:
            continue
        k, end = to.start, to.stop
        # What is right of the block is known to be zero; J would not see it.
        rows = p.turned(x[at], delta[to], S[to, :end])
        L, _ = reflected(jnp.concatenate([rows[:, k:], S[end:, k:end]]), p.dim)
        beside = jnp.concatenate([rows[:, :k], L[: p.dim], S[to, end:]], axis=1)
        below = jnp.concatenate([S[end:, :k], L[p.dim :], S[end:, end:]], axis=1)
        S = jnp.concatenate([S[:k], beside, below])
    return S
