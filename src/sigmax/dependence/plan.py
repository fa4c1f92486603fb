"""How a function is evaluated over a sigma set: what is sampled, in which order, and what is exact without."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sigmax.dependence.order import best_order, total_cost
from sigmax.dependence.reads import Part, Reading, components


class Plan(NamedTuple):
    """What a sigma rule does with a function.

    Attributes:
        bent: rows of the result that are sampled; the others are straight, so that their moments are exact.
        order: the components that have to vary, as their points are drawn.
        turned: whether that is another order than the state's, for which the factor's rows are made triangular.
        parts: what is evaluated at the points.
        size: how many coordinates of the points matter.
        levels: how many coordinates it takes to tell the values of a component, 0 for one that is held at its mean.
    """

    bent: tuple[int, ...]
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


def planned(read: Reading, counts: Sequence[int], permute: bool) -> Plan:
    """The plan for a sigma set with `counts` distinct points by their first 0, 1, … n coordinates.

    In the order of the state, or with `permute` in the best one where that saves more than the turning of the
    factor costs.
    """
    varying = components(read.bent)
    parts = read.parts()
    given = tuple(c + 1 if c in varying else 0 for c in range(read.size))
    plan = Plan(read.bent_rows, varying, False, parts, max(given, default=0), given)
    if not permute or not varying:
        return plan
    order = best_order(parts, counts)
    order += tuple(c for c in varying if c not in order)
    saved = total_cost(parts, range(read.size), counts) - total_cost(parts, order, counts)
    if saved <= _turning(len(order), read.size, len(plan.bent)):
        return plan
    levels = tuple(order.index(c) + 1 if c in varying else 0 for c in range(read.size))
    leading = order == tuple(range(len(order)))
    return Plan(read.bent_rows, order, not leading, parts, len(order), levels)


def _turning(k: int, n: int, m: int) -> float:
    """Operations to make k rows of n columns triangular and to turn m rows of a slope back."""
    return 4 * k * k * n / 2 + 12 * k + 4 * m * n * k
