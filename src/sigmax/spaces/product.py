"""Spaces side by side."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sigmax.spaces.space import Flat, Space, arrays


@dataclass(frozen=True)
class Product(Space):
    """Spaces one after the other, in points and in differences."""

    spaces: tuple[Space, ...]

    @property
    def numbers(self) -> tuple[str, ...]:  # type: ignore[override]
        """Of all parts."""
        return tuple(name for p in self.spaces for name in p.numbers)

    @property
    def deviations(self) -> tuple[str, ...]:  # type: ignore[override]
        """Of all parts."""
        return tuple(name for p in self.spaces for name in p.deviations)

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Of all parts."""
        return tuple(turns for p in self.spaces for turns in p.periodic)

    def parts(self) -> Iterator[tuple[Space, slice, slice]]:
        """The spaces, each with where it stands in a point and in a difference."""
        at = to = 0
        for p in self.spaces:
            yield p, slice(at, at + p.size), slice(to, to + p.dim)
            at, to = at + p.size, to + p.dim

    def add(self, x: Any, delta: Any) -> Any:
        """Part by part."""
        return _joined([p.add(x[a], delta[t]) for p, a, t in self.parts()])

    def difference(self, a: Any, b: Any) -> Any:
        """Part by part."""
        return _joined([p.difference(a[s], b[s]) for p, s, _ in self.parts()])

    def turned(self, x: Any, delta: Any, M: Any) -> Any:
        """Part by part, the rows that belong to it."""
        return _joined([p.turned(x[a], delta[t], M[t]) for p, a, t in self.parts()])

    def turned_back(self, x: Any, delta: Any, M: Any) -> Any:
        """Part by part, the rows that belong to it."""
        return _joined([p.turned_back(x[a], delta[t], M[t]) for p, a, t in self.parts()])

    def point(self, base: Any, c: Any) -> Any:
        """Part by part."""
        return _joined([p.point(base[a], c[t]) for p, a, t in self.parts()])

    def chart(self, base: Any, y: Any) -> Any:
        """Part by part."""
        return _joined([p.chart(base[a], y[a]) for p, a, _ in self.parts()])

    def shift(self, c: Any) -> Any:
        """Part by part."""
        return _joined([p.shift(c[t]) for p, _, t in self.parts()])

    def whole(self, there: Any) -> Any:
        """Part by part."""
        return _joined([p.whole(there[a]) for p, a, _ in self.parts()])

    def nearest(self, x: Any) -> Any:
        """Part by part."""
        return _joined([p.nearest(x[a]) for p, a, _ in self.parts()])

    def magnitude(self, x: Any) -> Any:
        """Part by part."""
        return _joined([p.magnitude(x[a]) for p, a, _ in self.parts()])


def _joined(rows: list[Any]) -> Any:
    return arrays(*rows).concatenate(rows)


def product(*spaces: Space) -> Space:
    """Spaces one after the other as one: flat neighbours become one flat space, so that nothing flat is slower."""
    made: list[Space] = []
    for p in (part for space in spaces for part, _, _ in space.parts()):
        if isinstance(p, Flat) and made and isinstance(made[-1], Flat):
            made[-1] = Flat(made[-1].periodic + p.periodic)
        else:
            made.append(p)
    return made[0] if len(made) == 1 else Product(tuple(made))
