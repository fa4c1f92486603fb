"""Names beside the points of a chart, none over another."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sigmax.reports.comparison.standing import FAR, Standing

# A line of text, and a letter, in parts of the height and of the width of a chart.
_LINE, _LETTER = 0.037, 0.0125


class Place(NamedTuple):
    """A filter that has a place in the chart of cost and accuracy."""

    standing: Standing
    cost: float
    distance: float


def placed(found: Sequence[Standing]) -> list[tuple[Place, int]]:
    """The filters with a place, and how many lines the name of each is lifted, the distance being logarithmic."""
    places = [
        Place(s, s.cost, s.distance)
        for s in found
        if s.cost is not None and s.distance is not None and s.distance <= FAR
    ]
    height = [float(np.log(p.distance)) for p in places]
    return list(zip(places, lifted([p.cost for p in places], height, [p.standing.name for p in places]), strict=True))


def lifted(x: Sequence[float], y: Sequence[float], names: Sequence[str]) -> list[int]:
    """By how many lines each name must stand higher than beside its point, for points x, y in any units."""
    across, up = (_from_0_to_1(np.asarray(v, float)) for v in (x, y))
    lines = [0] * len(names)
    taken: list[tuple[float, float, float]] = []
    for k in sorted(range(len(names)), key=lambda k: (across[k], up[k])):
        left, right = across[k], across[k] + _LETTER * (len(names[k]) + 1)
        while any(
            left < end and begin < right and abs(up[k] + _LINE * lines[k] - at) < _LINE for begin, end, at in taken
        ):
            lines[k] += 1
        taken.append((left, right, up[k] + _LINE * lines[k]))
    return lines


def _from_0_to_1(v: np.ndarray) -> np.ndarray:
    span = np.ptp(v) if len(v) else 0.0
    return (v - v.min()) / span if span > 0 else np.zeros(len(v))
