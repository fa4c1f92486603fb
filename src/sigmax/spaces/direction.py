"""Directions in space: the sphere S²."""

from dataclasses import dataclass
from typing import Any

from sigmax.spaces.quaternions import arc, of_unit_length, squared, stumpff
from sigmax.spaces.space import Space, arrays

# How far the opposite direction is taken to be from where no axis leads to it.
_NEARLY_NOTHING = 1e-12


@dataclass(frozen=True)
class Direction(Space):
    """S²: a unit vector x, y, z; a difference is the arc between two of them, in two axes across the first."""

    numbers = ("x", "y", "z")
    deviations = ("across", "beside")
    turns = 2

    def add(self, x: Any, delta: Any) -> Any:
        """The point x cos |δ| + B(x) δ sin |δ|/|δ|."""
        c = stumpff(squared(delta))
        first, second = _across(x)
        return of_unit_length(c[0] * x + c[1] * (delta[0] * first + delta[1] * second))

    def difference(self, a: Any, b: Any) -> Any:
        """The arc from b to a in the axes B(b); to the opposite direction along the first of them."""
        xp = arrays(a, b)
        v = xp.stack([(axis * a).sum(0) for axis in _across(b)])
        w = (a * b).sum(0)
        opposite = (squared(v) == 0) & (w < 0)
        v = xp.stack([xp.where(opposite, _NEARLY_NOTHING, v[0]).astype(v.dtype), v[1]])
        return arc(v, w) * v

    def nearest(self, x: Any) -> Any:
        """The unit vector x / |x|."""
        return x / squared(x) ** 0.5


def _across(x: Any) -> tuple[Any, Any]:
    """Two unit vectors across a third, without a branch (Duff et al., Building an orthonormal basis, revisited)."""
    xp = arrays(x)
    s = xp.where(x[2] < 0, -1.0, 1.0).astype(x.dtype)
    a = -1.0 / (s + x[2])
    b = x[0] * x[1] * a
    first = xp.stack([1.0 + s * x[0] * x[0] * a, s * b, -s * x[0]])
    return first, xp.stack([b, s + x[1] * x[1] * a, -x[1]])
