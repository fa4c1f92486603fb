"""Fewer points for a page, without losing what stands out."""

import itertools

import numpy as np


def thin(y: np.ndarray, limit: int) -> np.ndarray:
    """Indices of at most `limit` points of y (N,): the least and the largest of equal stretches; all if few."""
    n = len(y)
    if n <= limit:
        return np.arange(n)
    filled = np.nan_to_num(y, nan=0.0)
    edges = np.linspace(0, n, limit // 2 + 1).astype(int)
    found = [
        index
        for a, b in itertools.pairwise(edges)
        for index in sorted({a + int(filled[a:b].argmin()), a + int(filled[a:b].argmax())})
    ]
    return np.array(found)


def stride(n: int, limit: int) -> np.ndarray:
    """At most `limit` indices of n, evenly, with both ends."""
    return np.unique(np.linspace(0, n - 1, min(n, limit)).round().astype(int))
