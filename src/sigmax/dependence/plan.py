"""How a function is evaluated over a sigma set: what is sampled, in which order, and what is exact without."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sigmax.dependence.order import best_order, total_cost
from sigmax.dependence.reads import Part, Reading, components


class Plan(NamedTuple):
    """What a sigma rule does with a function.

    Attributes:
        rows: of the result, those that are sampled; the others are linear, so that their moments are exact.
        order: the components whose points are drawn, in this order: those that have to vary, and more where the
            set asks for it. Behind them those that vary with the same coordinates, of a factor with fewer columns.
        turned: whether that is another order than the state's, for which the factor's rows are made triangular.
        parts: what is evaluated at the points.
        size: how many coordinates of the points matter.
        levels: how many coordinates it takes to tell the values of a component, 0 for one that is held at its mean.
    """

    rows: tuple[int, ...]
    order: tuple[int, ...]
    turned: bool
    parts: tuple[Part, ...]
    size: int
    levels: tuple[int, ...]

    def level(self, reads: Sequence[int]) -> int:
        """How many coordinates of a point tell the value of what reads these components."""
        return max((self.levels[c] for c in reads), default=0)

    def places(self, read: Reading) -> Mapping[int, int]:
        """The level of each place of a function's line."""
        return {place: self.level(components(masks.reads)) for place, masks in read.places.items()}


def planned(read: Reading, angular: Sequence[bool], counts: Sequence[int], sizes: Sequence[int], permute: bool) -> Plan:
    """The plan for a sigma set with `counts` distinct points by their first 0, 1, … n coordinates.

    In the order of the state, or with `permute` in the best one where that saves more than the turning of the
    factor costs. `sizes` are the numbers of coordinates by which the set can be projected.
    """
    varying = components(read.nonlinear)
    rows = read.sampled_rows(angular)
    parts = read.parts(rows)
    everything, columns = tuple(range(read.size)), len(counts) - 1

    def plan(order: tuple[int, ...]) -> Plan:
        """Drawn in the order of all components."""
        levels = tuple(min(order.index(c) + 1, columns) if c in varying else 0 for c in everything)
        size = next((k for k in sizes if k >= max(levels)), 0) if varying else 0
        turned = order[:size] != everything[:size]
        return Plan(rows, (*order[:size], *(c for c in order[size:] if levels[c])), turned, parts, size, levels)

    given = plan(everything)
    # Of a factor with fewer columns than rows no other order is triangular.
    if not permute or not varying or max(varying) >= columns:
        return given
    first = best_order(parts, counts)
    first += tuple(c for c in varying if c not in first)
    best = plan(first + tuple(c for c in everything if c not in first))
    saved = total_cost(parts, everything, counts) - total_cost(parts, first, counts)
    return best if saved > _turning(best.size, read.size, len(rows)) * best.turned else given


def _turning(k: int, n: int, m: int) -> float:
    """Operations to make k rows of n columns triangular and to turn m rows of a slope back."""
    return 2 * k * k * n + 12 * k + 4 * m * n * k
