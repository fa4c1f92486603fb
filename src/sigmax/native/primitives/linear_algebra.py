"""Rules of factorisations and of triangular solutions."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from sigmax.native.graph import Array, Graph
from sigmax.native.primitives.elementwise import each
from sigmax.native.primitives.interpret import rule


@rule("cholesky", integers=False)
def _cholesky(g: Graph, equation: Any, a: Array) -> Array:
    return _over_batch(partial(_factor, g), a)


def _over_batch(function: Callable[..., Array], *arrays: Array) -> Array:
    """A function of matrices on the last two axes."""
    out = np.empty(arrays[-1].shape, dtype=object)
    for place in np.ndindex(*out.shape[:-2]):
        out[place] = function(*(a[place] for a in arrays))
    return out


def _factor(g: Graph, a: Array) -> Array:
    n = len(a)
    out = np.full((n, n), g.constant(0.0), dtype=object)
    positive = g.constant(True)
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot = g.apply("-", pivot, g.apply("*", out[j, k], out[j, k]))
        positive = g.apply("and", positive, g.apply(">", pivot, g.constant(0.0)))
        out[j, j] = g.apply("sqrt", pivot)
        for i in range(j + 1, n):
            rest = a[i, j]
            for k in range(j):
                rest = g.apply("-", rest, g.apply("*", out[i, k], out[j, k]))
            out[i, j] = g.apply("/", rest, out[j, j])
    # What has no factor has none in any place.
    lower, nothing = np.tril_indices(n), g.constant(np.nan)
    out[lower] = [g.apply("select", positive, x, nothing) for x in out[lower]]
    return out


@rule("triangular_solve", parameters="left_side lower transpose_a conjugate_a unit_diagonal", integers=False)
def _triangular_solve(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    return _over_batch(partial(_solved, g, equation.params), a, b)


def _solved(g: Graph, p: Mapping[str, Any], a: Array, b: Array) -> Array:
    lower = bool(p["lower"])
    if p["transpose_a"]:
        a, lower = a.T, not lower
    if not p["left_side"]:
        a, b, lower = a.T, b.T, not lower
    n, x = len(a), np.empty(b.shape, dtype=object)
    order = range(n) if lower else range(n - 1, -1, -1)
    minus, times, over = each(g, "-"), each(g, "*"), each(g, "/")
    for i in order:
        rest = b[i]
        for j in range(i) if lower else range(n - 1, i, -1):
            rest = minus(rest, times(a[i, j], x[j]))
        x[i] = rest if p["unit_diagonal"] else over(rest, a[i, i])
    return x if p["left_side"] else x.T
