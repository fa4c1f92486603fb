"""The order of the state in which a function is evaluated at the fewest points, weighted by cost."""

from collections.abc import Iterable, Sequence

from sigmax.dependence.reads import Part


def total_cost(parts: Iterable[Part], order: Sequence[int], counts: Sequence[int]) -> float:
    """The cost of all evaluations: each part as often as the last of its components, in this order, has it.

    Args:
        parts: what is evaluated.
        order: the components as they are drawn; all that a part reads must be among them.
        counts: distinct points by their first 0, 1, … coordinates.
    """
    position = {component: p for p, component in enumerate(order, 1)}
    return sum(part.cost * counts[max((position[c] for c in part.reads), default=0)] for part in parts)


def best_order(parts: Sequence[Part], counts: Sequence[int]) -> tuple[int, ...]:
    """The components that the parts read, in the order of least `total_cost`: exact.

    Only the order in which parts become complete matters, so that the search is over unions of what parts
    read, not over permutations: at most 2^(number of parts) and 2^n unions, in practice a few dozen. Sorting
    by weight, as in the paper, is not always optimal: it counts elements of points, not evaluations.
    """
    wanted = [(frozenset(part.reads), part.cost) for part in parts if part.reads]
    best: dict[frozenset[int], tuple[float, tuple[int, ...]]] = {frozenset(): (0.0, ())}
    waiting: list[set[frozenset[int]]] = [set() for _ in range(len(frozenset().union(*(r for r, _ in wanted))) + 1)]
    waiting[0].add(frozenset())
    for size in range(len(waiting)):
        for done in sorted(waiting[size], key=sorted):
            cost, order = best[done]
            for reads in {r for r, _ in wanted if not r <= done}:
                after = done | reads
                new = sum(c for r, c in wanted if r <= after and not r <= done) * counts[len(after)]
                offer = (cost + new, (*order, *sorted(reads - done)))
                if after not in best or offer < best[after]:
                    best[after] = offer
                    waiting[len(after)].add(after)
    return best[max(best, key=len)][1]
