"""The paper's own quantities, corrected: the weight matrix W, the element counts ξ, the cost Q, the permutation p."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sigmax.dependence.reads import cost_of, reading
from sigmax.errors import InputError
from sigmax.native.pieces import needed


def weight_matrix(function: Callable[..., Any], n: int, *rest: Any) -> np.ndarray:
    """W (m, n): what it costs to compute component i again when component j of the state changes (Belov, (6)).

    Args:
        function: of the state (n,) and of `rest`, giving (m,).
        n: components of the state.
        rest: arguments that are the same for all points.

    Returns:
        Scalar operations, an addition or multiplication being 1.
    """
    read = reading(function, n, rest)
    W = np.zeros((len(read.results), n))
    for i, result in enumerate(read.results):
        for node in needed([result]):
            masks = read.masks[node.index]
            for j in range(n):
                if masks.reads >> j & 1:
                    W[i, j] += cost_of(node, read.opaque)
    return W


def complexity(W: ArrayLike, elements: Sequence[int], order: Sequence[int] | None = None) -> float:
    """Q = e₁ W ξᵀ (Belov, (6) with ξ transposed), the state being drawn in an order.

    Args:
        W: (m, n), or (n,) for its sum over the rows.
        elements: ξ (n,), how many different values each component takes among the points: `SigmaSet.elements`.
        order: the components as they are drawn; without it as they stand.

    Raises:
        InputError: where the sizes do not fit, or the order is none.
    """
    weights = np.atleast_2d(np.asarray(W, float)).sum(0)
    n = len(weights)
    chosen = list(range(n)) if order is None else list(order)
    if len(elements) != n or sorted(chosen) != list(range(n)):
        raise InputError(
            f"W has {n} columns: it needs {n} element counts, not {len(elements)}, "
            f"and an order of 0 … {n - 1}, not {chosen}"
        )
    return float(weights[chosen] @ np.asarray(elements, float))


def permutation(W: ArrayLike) -> tuple[int, ...]:
    """The paper's p, counted from 0: components by falling e₁ W, ties as they stand.

    It minimises Q, which counts elements of points; evaluations are minimised by `best_order`.
    """
    weights = np.atleast_2d(np.asarray(W, float)).sum(0)
    return tuple(int(i) for i in np.argsort(-weights, kind="stable"))
