"""What a space is: a point is `size` numbers, a difference of two points is `dim` numbers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import wrap, wrapped


def arrays(*given: Any) -> Any:
    """NumPy for NumPy's arrays, JAX for all others: spaces work on both."""
    return np if all(isinstance(a, np.ndarray | np.generic | float) for a in given) else jnp


class Space(ABC):
    """Where a state or a measurement lives: an immutable, hashable value with x ⊞ δ and a ⊟ b.

    Arrays are component first: points (size, ...), differences (dim, ...), equal batches behind. With these two
    functions x ⊞ 0 = x, (x ⊞ δ) ⊟ x = δ where δ is not too long, x ⊞ (y ⊟ x) = y, and the derivative of
    (x ⊞ δ) ⊟ x at δ = 0 is the identity (Hertzberg et al., Integrating generic sensor fusion algorithms
    with sound state representations through encapsulation of manifolds, definition 1).

    Attributes:
        dim: numbers of a difference.
        size: numbers of a point.
        numbers: names of the numbers of a point.
        deviations: names of the numbers of a difference.
        turns: how many of the first deviations are turns: beyond π they lead back.
    """

    numbers: tuple[str, ...]
    deviations: tuple[str, ...]
    turns: int = 0

    @property
    def size(self) -> int:
        """Numbers of a point."""
        return len(self.numbers)

    @property
    def dim(self) -> int:
        """Numbers of a difference."""
        return len(self.deviations)

    @property
    def flat(self) -> bool:
        """Whether ⊞ is + and ⊟ is − but for a period: then a point is its own coordinates."""
        return False

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Of each coordinate (dim), whether it is an angle that turns."""
        return (False,) * self.dim

    @abstractmethod
    def add(self, x: Any, delta: Any) -> Any:
        """The point x ⊞ δ (size, ...), which is δ (dim, ...) away from x."""

    @abstractmethod
    def difference(self, a: Any, b: Any) -> Any:
        """The difference a ⊟ b (dim, ...): a seen from b."""

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """J M, J = ∂((x ⊞ (δ + ε)) ⊟ (x ⊞ δ))/∂ε at ε = 0: columns M (dim, k, ...) at x, seen from x ⊞ δ."""
        there = self.add(x, delta)
        return _along(lambda e: self.difference(self.add(x, delta + e), there), delta, M)

    def turned_back(self, x: Any, delta: Any, M: Any) -> Any:
        """J⁻¹ M: columns M (dim, k, ...) at x ⊞ δ, seen from x."""
        there = self.add(x, delta)
        return _along(lambda e: self.difference(self.add(there, e), x), delta, M)

    def point(self, base: Any, c: Any) -> Any:
        """The point (size, ...) of coordinates c (dim, ...) about a base."""
        return self.add(base, c)

    def chart(self, base: Any, y: Any) -> Any:
        """The coordinates (dim, ...) of a point about a base: flat parts as they are, curved ones as differences."""
        return self.difference(y, base)

    def shift(self, c: Any) -> Any:
        """How far coordinates (dim, ...) are from their base; of flat parts 0, as nothing turns there."""
        return c

    def whole(self, there: Any) -> Any:
        """Which numbers of a difference (dim, ...) are known, of which numbers of a point (size, ...) are there."""
        return arrays(there).broadcast_to(there.all(0), (self.dim, *there.shape[1:]))

    def nearest(self, x: Any) -> Any:
        """The point of the space nearest to numbers (size, ...): of four numbers the unit quaternion along them."""
        return x

    def magnitude(self, x: Any) -> Any:
        """How large the numbers are that a difference at x is made of (dim, ...): they say what rounding leaves."""
        return arrays(x).broadcast_to(abs(x).max(0), (self.dim, *x.shape[1:]))

    def parts(self) -> Iterator[tuple["Space", slice, slice]]:
        """The spaces of a product, each with where it stands in a point and in a difference."""
        yield self, slice(0, self.size), slice(0, self.dim)


def _along(function: Callable[[Any], Any], delta: Any, M: Any) -> Any:
    _, derivative = jax.linearize(function, jnp.zeros_like(delta))
    made = jax.vmap(derivative, in_axes=1, out_axes=1)(jnp.asarray(M))
    return np.asarray(made) if arrays(delta, M) is np else made


@dataclass(frozen=True)
class Flat(Space):
    """Real numbers and angles side by side: ⊞ is + and ⊟ is −, angles brought into [−π, π].

    Attributes:
        periodic: of each number, whether it is an angle.
    """

    periodic: tuple[bool, ...] = (False,)

    @property
    def numbers(self) -> tuple[str, ...]:  # type: ignore[override]
        """Nobody names the numbers of a flat space but who puts it together."""
        return ("",) * len(self.periodic)

    @property
    def deviations(self) -> tuple[str, ...]:  # type: ignore[override]
        """As the numbers."""
        return self.numbers

    @property
    def flat(self) -> bool:
        """It is."""
        return True

    def _near(self, d: Any) -> Any:
        if arrays(d) is np:
            return np.moveaxis(wrapped(np.moveaxis(d, 0, -1), self.periodic), -1, 0)
        return wrap(d, self.periodic)

    def add(self, x: Any, delta: Any) -> Any:
        """The sum x + δ."""
        return self._near(x + delta)

    def difference(self, a: Any, b: Any) -> Any:
        """The difference a − b."""
        return self._near(a - b)

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """M itself: nothing turns."""
        return M

    def turned_back(self, x: Any, delta: Any, M: Any) -> Any:
        """M itself: nothing turns."""
        return M

    def point(self, base: Any, c: Any) -> Any:
        """The coordinates themselves."""
        return c

    def chart(self, base: Any, y: Any) -> Any:
        """The point itself."""
        return y

    def shift(self, c: Any) -> Any:
        """Nothing: a flat part has no base."""
        return arrays(c).zeros_like(c)

    def whole(self, there: Any) -> Any:
        """Number by number."""
        return there

    def magnitude(self, x: Any) -> Any:
        """|x|."""
        return abs(x)
