"""Mean and covariance of a mixture of normal distributions, in square-root form and on any space."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from sigmax.algebra.factor import safe_sqrt, tria
from sigmax.spaces.space import Space


def moments(space: Space, means: Sequence[Any], roots: Sequence[Any], weights: Any) -> tuple[Any, Any]:
    """Mean (size, ...) and lower factor (dim, dim, ...) of Σ weight N(mean, root rootᵀ).

    The mean is taken about that of the heaviest member, on curved spaces once more about itself; roots are turned
    into its tangent. dim² · Σ (columns + 1) multiplications.

    Args:
        space: where the members live.
        means: of each member, (size, ...).
        roots: of each member, (dim, k, ...), k of its own.
        weights: (members, ...), which sum to 1; a member of weight 0 counts nothing whatever it is.
    """
    if len(means) == 1:
        return means[0], tria(roots[0])
    about, most = means[0], weights[0]
    for mean, weight in zip(means[1:], weights[1:], strict=True):
        about, most = jnp.where(weight > most, mean, about), jnp.maximum(weight, most)
    for _ in range(1 if space.flat else 2):
        away = [_counted(w, space.difference(m, about)) for m, w in zip(means, weights, strict=True)]
        about = space.add(about, sum(w * d for w, d in zip(weights, away, strict=True)))
    columns = []
    for mean, root, weight in zip(means, roots, weights, strict=True):
        d = _counted(weight, space.difference(mean, about))
        share = safe_sqrt(weight)[0]
        turned = space.turned_back(about, d, _counted(weight, root))
        columns += [share * turned, (share * d)[:, None]]
    return about, tria(jnp.concatenate(columns, axis=1))


def _counted(weight: Any, a: Any) -> Any:
    """An array, 0 where its member has no weight: 0 · ∞ would be no number."""
    return jnp.where(weight > 0, a, 0)
