"""Components of one mode found in another: by name, what comes in by its declared entry."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import pivoted, tria
from sigmax.errors import InputError
from sigmax.modelling.model import Model
from sigmax.modelling.switching import Entries
from sigmax.spaces import Flat
from sigmax.steps.step import Belief
from sigmax.steps.updating import right_solve


class Way(NamedTuple):
    """How the components of one state are found in another.

    Attributes:
        straight: whether nothing is added, left out or moved.
        points: for each number, its place in the other state; None for what comes in.
        deviations: the same for each deviation.
        mean: with which each number comes in.
        deviation: the same of each deviation.
    """

    straight: bool
    points: list[int | None]
    deviations: list[int | None]
    mean: list[Any]
    deviation: list[Any]


def way(source: Model, onto: Model, entry: Entries = ()) -> Way:
    """How the components of one model are found in another's."""
    enter = {name: (mean, jnp.sqrt(variance)) for name, mean, variance in entry}
    have, deviate = list(source.state), list(source.deviations)
    return Way(
        source.state == onto.state,
        [have.index(n) if n in have else None for n in onto.state],
        [deviate.index(n) if n in deviate else None for n in onto.deviations],
        [enter[n][0] if n not in have else 0.0 for n in onto.state],
        [enter[n][1] if n not in deviate else 0.0 for n in onto.deviations],
    )


def entered(belief: Belief, along: Way) -> tuple[Any, Any]:
    """Mean and root (n, k, ...) of a belief with other components: a row and a column more for what comes in."""
    mean, root = belief
    if along.straight:
        return mean, root
    zero = jnp.zeros_like(mean[0])
    entering = [k for k, p in enumerate(along.deviations) if p is None]
    rows = []
    for k, p in enumerate(along.deviations):
        own = jnp.zeros_like(root[0]) if p is None else root[p]
        extra = ((zero + (along.deviation[k] if k == e else 0))[None] for e in entering)
        rows.append(jnp.concatenate([own, *extra]))
    points = [zero + along.mean[k] if p is None else mean[p] for k, p in enumerate(along.points)]
    return jnp.stack(points), jnp.stack(rows)


def returned(source: Model, other: Model, filtered: Belief, smoothed: Belief) -> Belief:
    """What is known of a mode's components once those that another mode has too are smoothed.

    Those of its own follow by their regression on the common ones: what comes later knows nothing else of them.

    Raises:
        InputError: where the states differ and a part of them turns or points.
    """
    found = way(other, source, tuple((n, 0.0, 0.0) for n in source.state))
    if found.straight:
        return smoothed
    if not (source.space.flat and other.space.flat):
        raise InputError("smoothing needs the same components in all modes where one of them turns or points")
    common = [(k, p) for k, p in enumerate(found.deviations) if p is not None]
    rest = [k for k, p in enumerate(found.deviations) if p is None]
    known = jnp.stack([smoothed.mean[p] for _, p in common])
    shared = jnp.stack([smoothed.factor[p] for _, p in common])
    if not rest:
        return Belief(known, tria(shared))
    # Common first: [[S_cc, 0], [S_ec, S_ee]]; what comes after is e + S_ec S_cc⁻¹ (c_s − c).
    order = [k for k, _ in common] + rest
    c = len(common)
    root = tria(jnp.stack([filtered.factor[k] for k in order]))
    # A common component known exactly tells nothing of the rest.
    exact = jnp.stack([root[k, k] <= 0 for k in range(c)])
    tells = jnp.where(exact[None], 0, root[c:, :c])
    slope = right_solve(tells, pivoted(root[:c, :c]))
    shift = Flat(tuple(source.space.periodic[k] for k in order[:c])).difference(
        known, jnp.stack([filtered.mean[k] for k in order[:c]])
    )
    ahead = jnp.stack([filtered.mean[k] for k in rest]) + times(slope, shift)
    apart = jnp.concatenate([root[c:, c:], root[c:, :c] - tells], axis=1)
    above = jnp.concatenate([shared, jnp.zeros((c, *apart.shape[1:]), shared.dtype)], axis=1)
    wide = jnp.concatenate([above, jnp.concatenate([product(slope, shared), apart], axis=1)])
    back = np.argsort(order)
    return Belief(jnp.concatenate([known, ahead])[back], tria(wide[back]))
