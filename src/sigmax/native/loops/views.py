"""Where the numbers of an array lie: positions in a buffer, moved about without moving the numbers."""

import bisect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np


class Memory:
    """A row of numbers, parts of which are taken and given back.

    Attributes:
        size: how long it must be.
    """

    def __init__(self) -> None:
        self.size = 0
        self._free: list[tuple[int, int]] = []  # where and how many, sorted

    def take(self, size: int) -> int:
        """Where so many numbers may lie: the smallest gap that holds them, else the end."""
        fitting = [gap for gap in self._free if gap[1] >= size]
        if not fitting:
            at = self.size
            self.size += size
            return at
        gap = min(fitting, key=lambda gap: gap[1])
        self._free.remove(gap)
        if gap[1] > size:
            bisect.insort(self._free, (gap[0] + size, gap[1] - size))
        return gap[0]

    def give_back(self, at: int, size: int) -> None:
        """Let others have them."""
        bisect.insort(self._free, (at, size))
        merged: list[tuple[int, int]] = []
        for gap in self._free:
            if merged and sum(merged[-1]) == gap[0]:
                merged[-1] = merged[-1][0], merged[-1][1] + gap[1]
            else:
                merged.append(gap)
        self._free = merged


class Buffer:
    """Numbers side by side: a part of the workspace, which is free again when nobody holds the buffer, or an argument.

    Attributes:
        name: of the C array.
        offset: where in it they begin.
        same: whether one number stands for all lanes.
        writers: loops not written yet that fill it.
    """

    def __init__(self, name: str, same: bool = False, memory: Memory | None = None, size: int = 0) -> None:
        self.name, self.same, self._memory, self._size = name, same, memory, size
        self.offset = memory.take(size) if memory is not None else 0
        self.writers: list[Any] = []

    def __del__(self) -> None:
        if self._memory is not None and self._size:
            self._memory.give_back(self.offset, self._size)


class View(NamedTuple):
    """An array.

    Attributes:
        buffer: what its numbers lie in.
        at: the place of each.
        truth: whether they are truth values, kept as 1 and 0.
        zero: which of them are 0 by construction; None if none is.
        bounds: between which numbers they lie, of integers.
    """

    buffer: Buffer
    at: np.ndarray
    truth: bool = False
    zero: np.ndarray | None = None
    bounds: tuple[float, float] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array."""
        return self.at.shape

    def moved(self, move: Callable[[np.ndarray], np.ndarray]) -> "View":
        """The same numbers in other places of an array."""
        return self._replace(at=move(self.at), zero=None if self.zero is None else move(self.zero))

    def spread(self, shape: tuple[int, ...]) -> "View":
        """The same numbers repeated along axes."""
        return self.moved(lambda a: np.broadcast_to(a, shape))


class Walk(NamedTuple):
    """How places follow each other in a loop over each axis.

    Attributes:
        start: the first place.
        axes: along each axis the step, or a table of the distances from the first.
        table: places by number, where they follow no such rule; else the place is the number itself.
    """

    start: int
    axes: tuple[int | tuple[int, ...], ...]
    table: np.ndarray | None = None


def walk(at: np.ndarray) -> Walk:
    """How the places of an array follow each other."""
    if not at.size:
        return Walk(0, (0,) * at.ndim)
    origin = int(at[(0,) * at.ndim])
    axes: list[int | tuple[int, ...]] = []
    found = np.asarray(origin)
    for d, n in enumerate(at.shape):
        line = at[tuple(slice(None) if k == d else 0 for k in range(at.ndim))] - origin
        step = int(line[1]) if n > 1 else 0
        axes.append(step if np.array_equal(line, step * np.arange(n)) else tuple(line.tolist()))
        found = found + line.reshape([-1 if k == d else 1 for k in range(at.ndim)])
    if np.array_equal(found, at):
        return Walk(origin, tuple(axes))
    return Walk(0, row_by_row(at.shape), at.ravel())


def row_by_row(shape: Sequence[int]) -> tuple[int, ...]:
    """The steps along the axes of an array that lies row by row."""
    steps = [1]
    for n in reversed(shape[1:]):
        steps.append(steps[-1] * n)
    return tuple(reversed(steps[: len(shape)]))


def known_walk(values: np.ndarray) -> tuple[np.ndarray, Walk]:
    """Known numbers as a table, without axes along which they repeat, and the walk in it."""
    kept = [n > 1 and bool((values != values.take([0], d)).any()) for d, n in enumerate(values.shape)]
    table = values[tuple(slice(None) if k else slice(0, 1) for k in kept)]
    steps = row_by_row(table.shape)
    return table.ravel(), Walk(0, tuple(s if k else 0 for s, k in zip(steps, kept, strict=True)))


def fused(shape: tuple[int, ...], walks: Sequence[Walk]) -> tuple[tuple[int, ...], list[Walk]]:
    """Loops over neighbouring axes as one wherever all walks go on evenly; without axes of length 1."""
    sizes: list[int] = []
    axes: list[list[Any]] = [[] for _ in walks]
    for d, n in enumerate(shape):
        if n == 1:
            continue
        steps = [w.axes[d] for w in walks]
        joins = bool(sizes) and all(
            isinstance(step, int) and isinstance(known[-1], int) and known[-1] == step * n
            for step, known in zip(steps, axes, strict=True)
        )
        if joins:
            sizes[-1] *= n
        else:
            sizes.append(n)
        for step, known in zip(steps, axes, strict=True):
            if joins:
                known[-1] = step
            else:
                known.append(step)
    return tuple(sizes), [w._replace(axes=tuple(known)) for w, known in zip(walks, axes, strict=True)]
