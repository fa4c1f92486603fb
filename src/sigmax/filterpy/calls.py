"""User's functions on many points: all at once where a function gives the same that way, else one by one."""

from collections.abc import Callable
from typing import Any

import numpy as np


class Pointwise:
    """Calls function(x, *arguments), written for x (n,), on the rows of points (N, n) -> (N, m).

    It is tried with x (n, N), a point in each column. As long as one point, another in each call, comes out the same
    alone, that answer is taken; from the first difference or exception on, the function is called for each point.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.together = True
        self._next = 0

    def __call__(self, points: np.ndarray, *arguments: Any, **named: Any) -> np.ndarray:
        """The value at each point, a row each."""

        def alone(k: int) -> np.ndarray:
            return np.ravel(np.asarray(self.function(points[k].copy(), *arguments, **named), float))

        if self.together:
            k = self._next = (self._next + 1) % len(points)
            want = alone(k)
            try:
                values = np.asarray(self.function(points.T.copy(), *arguments, **named), float)
            except Exception:  # whatever a function written for one point does with many
                values = np.empty(0)
            if values.ndim == 1 and len(want) == 1:
                values = values[None]
            if values.shape == (len(want), len(points)) and _same(values[:, k], want):
                return values.T
            self.together = False
        return np.array([alone(k) for k in range(len(points))])


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two results differ by no more than two versions of the same functions do."""
    return a.tobytes() == b.tobytes() or np.allclose(
        a, b, rtol=1e-12, atol=1e-14 * np.abs(b).max(initial=0), equal_nan=True
    )
