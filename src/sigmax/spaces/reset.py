"""A covariance seen from another point: what belongs to the tangent at x is turned into that at x ⊞ δ."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from sigmax.algebra.factor import Mirror, reflected, turned_back
from sigmax.spaces.space import Space


class Reset(NamedTuple):
    """A lower factor of J S Sᵀ Jᵀ, S' = J S U, and the reflections of U by the columns where they stand.

    Attributes:
        factor: S' (d, d, ...).
        mirrors: of each curved part, its columns and their reflections.
    """

    factor: Any
    mirrors: list[tuple[slice, list[Mirror]]]

    def unturned(self, E: Any) -> Any:
        """E Uᵀ (m, d, ...) of E (m, d, ...): by the columns of J S what E is by those of S'."""
        for to, mirrors in self.mirrors:
            E = jnp.concatenate([E[:, : to.start], turned_back(E[:, to], mirrors), E[:, to.stop :]], axis=1)
        return E


def reset(space: Space, x: Any, delta: Any, S: Any) -> Reset:
    """The lower factor (d, d, ...) of J S Sᵀ Jᵀ of a lower S (d, d, ...), J = J(x, δ).

    A curved part at the coordinates [k, k + p) turns its own rows, and its own p columns are triangularised again
    in all rows from k on; everything else of S stays (Markley, Attitude error representations for Kalman filtering).
    """
    found = []
    for p, at, to in space.parts():
        if p.flat:
            continue
        k, end = to.start, to.stop
        # What is right of the block is known to be zero; J would not see it.
        rows = p.turned(x[at], delta[to], S[to, :end])
        L, mirrors = reflected(jnp.concatenate([rows[:, k:], S[end:, k:end]]), p.dim)
        beside = jnp.concatenate([rows[:, :k], L[: p.dim], S[to, end:]], axis=1)
        below = jnp.concatenate([S[end:, :k], L[p.dim :], S[end:, end:]], axis=1)
        S = jnp.concatenate([S[:k], beside, below])
        found.append((to, mirrors))
    return Reset(S, found)
