"""What a record does not tell of its parameters: numbers that it says nothing of, and such as only their mixture."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sigmax.fitting.maximum import Many, Summit
from sigmax.fitting.result import INTERVAL
from sigmax.fitting.search import Search

# What a log-likelihood has to lose before a number counts as told.
_TOLD = 0.5
# How far logarithms are looked at: a factor of 20; and a mixture, in deviations of its numbers by themselves.
_WIDE, _MIXED = 3.0, 3000.0
# Curvature, of 1 where numbers are independent, below which a direction is followed.
_FLAT = 0.02
# Logits beyond this are at a bound.
_AT_BOUND = 5.5


class Untold(NamedTuple):
    """Numbers that are not determined.

    Attributes:
        which: of the p numbers.
        said: why, in words.
    """

    which: tuple[int, ...]
    said: str


def untold(f: Many, summit: Summit, search: Search, names: Sequence[str]) -> tuple[tuple[Untold, ...], Summit]:
    """What a record leaves open at its maximum, and the maximum with the curvature of its flattest directions.

    Args:
        f: the log-likelihood of what is searched.
        summit: its maximum.
        search: the parameters.
        names: what each of them is called.
    """
    found = _alone(f, summit, search, names)
    out = {i for one in found for i in one.which}
    kept = [i for i in range(search.size) if i not in out]
    more, summit = _mixed(f, summit, kept, search, names)
    return (*found, *more), summit


def covariance(summit: Summit, search: Search, found: Sequence[Untold]) -> np.ndarray:
    """Of the parameters (p, p), those that are not determined held where they are and NaN."""
    out = {i for one in found for i in one.which}
    kept = np.array([i for i in range(search.size) if i not in out], int)
    made = np.full((search.size, search.size), np.nan)
    if not len(kept):
        return made
    slope = search.slope(summit.y)[kept]
    try:
        inverse = np.linalg.inv(summit.curvature[np.ix_(kept, kept)])
    except np.linalg.LinAlgError:
        return made
    positive = np.linalg.eigvalsh(inverse).min() > 0
    made[np.ix_(kept, kept)] = inverse * np.outer(slope, slope) if positive else np.nan
    return made


def _alone(f: Many, summit: Summit, search: Search, names: Sequence[str]) -> list[Untold]:
    y, A = summit.y, np.diag(summit.curvature)
    wide = np.where(search.logarithmic, _WIDE, 10 * summit.steps)
    at = f(y + np.array([*np.diag(-wide), *np.diag(wide)])).reshape(2, -1)
    lost = summit.value - at
    found = []
    theta = search.outside(y)
    for i, name in enumerate(names):
        low, high = lost[:, i] < _TOLD
        if search.boxed[i]:
            if abs(y[i]) > _AT_BOUND:
                bound = search.high[i] if y[i] > 0 else search.low[i]
                found.append(Untold((i,), f"{name} runs into its bound {bound:g}"))
            elif low and high and A[i] * summit.steps[i] ** 2 < 1e-6:
                found.append(Untold((i,), _nothing(name)))
        elif search.logarithmic[i]:
            edge = {side: _edge(f, summit, i, side) for side, needed in ((1, low), (-1, high)) if needed}
            if low and high:
                low, high = np.isnan(edge[-1]), np.isnan(edge[1])
            if low and high:
                span = f"from {theta[i] / np.exp(_WIDE):.2g} to {theta[i] * np.exp(_WIDE):.2g}"
                found.append(Untold((i,), f"{_nothing(name)}: {span} the log-likelihood loses less than {_TOLD}"))
            elif low or high:
                end = edge[1 if low else -1]
                limit = f"{np.exp(end):.2g}" if np.isfinite(end) else "any number"
                where, also = ("below", "0 would do as well") if low else ("above", "the larger the better")
                found.append(Untold((i,), f"of {name} the record tells only that it is {where} {limit}: {also}"))
        elif low and high and A[i] * summit.steps[i] ** 2 < 1e-9 * max(1.0, abs(summit.value)):
            found.append(Untold((i,), _nothing(name)))
    return found


def _nothing(name: str) -> str:
    return f"the record says nothing of {name}"


def _edge(f: Many, summit: Summit, i: int, sign: int) -> float:
    """Where the log-likelihood has lost what a 95 % interval loses, along one number."""
    far = np.linspace(0, 16, 65)
    points = np.tile(summit.y, (len(far), 1))
    points[:, i] += sign * far
    beyond = np.flatnonzero(summit.value - f(points) > INTERVAL)
    return float(points[beyond[0], i]) if len(beyond) else float("nan")


def _mixed(
    f: Many, summit: Summit, kept: list[int], search: Search, names: Sequence[str]
) -> tuple[list[Untold], Summit]:
    """Directions along which the log-likelihood stays the same, though each number by itself is told.

    Small differences do not see a curvature that is a thousandth of others: along such a direction the likelihood is
    followed until it has lost enough to tell.
    """
    if len(kept) < 2:
        return [], summit
    at = np.ix_(kept, kept)
    scale = 1 / np.sqrt(np.maximum(np.diag(summit.curvature[at]), 1e-300))
    w, V = np.linalg.eigh(summit.curvature[at] * np.outer(scale, scale))
    bounded = ~search.straight[kept]
    found = []
    for k, v in enumerate(V.T):
        if w[k] > _FLAT:
            continue
        longest = _WIDE / np.maximum(np.abs(v * scale), 1e-300)
        far = np.geomspace(3.0, max(4.0, float(min(_MIXED, longest[bounded].min(initial=np.inf)))), 9)
        points = np.tile(summit.y, (2 * len(far), 1))
        points[:, kept] += np.concatenate([far, -far])[:, None] * v * scale
        lost = (summit.value - f(points)).reshape(2, -1).mean(0)
        enough = np.flatnonzero(lost > _TOLD)
        if len(enough) and np.isfinite(lost[enough[0]]):
            w[k] = 2 * lost[enough[0]] / far[enough[0]] ** 2
            continue
        which = tuple(kept[i] for i in np.flatnonzero(np.abs(v) > 0.2))
        listed = " and ".join(names[i] for i in which)
        found.append(Untold(which, f"the record determines {listed} only together: fix one of them"))
    curvature = summit.curvature.copy()
    curvature[at] = (V * w) @ V.T / np.outer(scale, scale)
    return found, summit._replace(curvature=curvature)
