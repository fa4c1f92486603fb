"""Statistical linear regression over a sigma set."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import combine, static, wrap
from sigmax.rules.linearization import Linearization
from sigmax.rules.sigma_set import SigmaSet

# A function of points (n, d, ...), a column each, and of the unit points (d, q) that they are made from.
Sampled = Callable[[jax.Array, np.ndarray], jax.Array]


def regressed(unit: SigmaSet, g: Sampled, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
    """Evaluate g at the points x̂ + S ξ and regress; angles are differences about a reference.

    S is (n, q, ...) for a set of q dimensions; the slope is by its columns.
    """
    return (_symmetric if len(unit.pairs) else _general)(unit, g, x, S, angular)


def _reference(g: Sampled, x: jax.Array, first: jax.Array, angular: Sequence[bool], size: int) -> jax.Array:
    """A value near all g(points), by component: g(x̂) for angles, any of the values for the others."""
    if not any(angular):
        return first
    middle = g(x[:, None], np.zeros((1, size)))[:, 0]
    return jnp.stack([middle[i] if turning else first[i] for i, turning in enumerate(angular)])


def _symmetric(unit: SigmaSet, g: Sampled, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
    """Fold each pair: the odd part is the slope, the even part what the line misses."""
    k, w = len(unit.pairs), unit.pair_weights
    axes = k == unit.dimension and np.count_nonzero(unit.pairs) == k
    spread = S * static(np.diag(unit.pairs), S, axis=1) if axes else combine(S, unit.pairs.T)
    at = [x[:, None] + spread, x[:, None] - spread]
    if unit.centre is not None:
        at.append(x[:, None])
    y = g(jnp.concatenate(at, axis=1), unit.points)
    reference = y[:, 2 * k] if unit.centre is not None else _reference(g, x, y[:, 0], angular, unit.dimension)
    delta = wrap(y[:, : 2 * k] - reference[:, None], angular)
    odd, both = delta[:, :k] - delta[:, k:], delta[:, :k] + delta[:, k:]
    shift = (both * static(w, both, axis=1)).sum(1)
    slope = odd * static(w * np.diag(unit.pairs), odd, axis=1) if axes else combine(odd, w[:, None] * unit.pairs)
    # Weights with a root: columns of what the line misses, kept where w > 0, taken away where w < 0.
    columns = [(both - 2 * shift[:, None], w / 2)]
    if k > unit.dimension:
        columns.append((odd - 2 * combine(slope, unit.pairs.T), w / 2))
    if unit.centre is not None:
        columns.append((-shift[:, None], np.array([unit.centre_covariance])))
    return Linearization(wrap(reference + shift, angular), slope, *_signed(columns))


def _general(unit: SigmaSet, g: Sampled, x: jax.Array, S: jax.Array, angular: Sequence[bool]) -> Linearization:
    xi, w = unit.singles, unit.single_weights
    y = g(x[:, None] + combine(S, xi.T), xi)
    reference = _reference(g, x, y[:, 0], angular, unit.dimension)
    delta = wrap(y - reference[:, None], angular)
    shift = (delta * static(w, delta, axis=1)).sum(1)
    slope = combine(delta, w[:, None] * xi)
    mean = wrap(reference + shift, angular)
    if (w < 0).any():
        missed = delta - shift[:, None] - combine(slope, xi.T)
        return Linearization(mean, slope, *_signed([(missed, w)]))
    # Deviations from a straight line live in the complement of 1 and ξ: for a simplex there is none.
    root = np.sqrt(w)
    span, _ = np.linalg.qr(np.column_stack([root, root[:, None] * xi]), mode="complete")
    complement = root[:, None] * span[:, unit.dimension + 1 :]
    residual = combine(delta, complement) if complement.shape[1] else slope[:, :0]
    return Linearization(mean, slope, residual, slope[:, :0])


def _signed(columns: list[tuple[jax.Array, np.ndarray]]) -> tuple[jax.Array, jax.Array]:
    kept: list[jax.Array] = []
    taken: list[jax.Array] = []
    for values, weights in columns:
        for chosen, bag in ((weights > 0, kept), (weights < 0, taken)):
            if chosen.all():
                bag.append(values * static(np.sqrt(np.abs(weights)), values, axis=1))
            elif chosen.any():
                root = np.sqrt(np.abs(weights[chosen]))
                bag.append(values[:, np.flatnonzero(chosen)] * static(root, values, axis=1))
    empty = columns[0][0][:, :0]
    return (
        jnp.concatenate(kept, axis=1) if kept else empty,
        jnp.concatenate(taken, axis=1) if taken else empty,
    )
