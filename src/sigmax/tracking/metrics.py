"""How good tracks are, where the truth is known."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from sigmax.tracking.state import Told


class Truth(NamedTuple):
    """Where a target really was: its name, times (T,) ascending, positions (T, d)."""

    name: str
    time: np.ndarray
    position: np.ndarray

    def at(self, time: float) -> np.ndarray | None:
        """The position (d,) at a time, on a straight line between the known ones; None outside of them."""
        if not self.time[0] <= time <= self.time[-1]:
            return None
        return np.array([np.interp(time, self.time, column) for column in self.position.T])


class Gospa(NamedTuple):
    """GOSPA and its parts: `distance`ᵖ = `localisation` + `missed` + `false`."""

    distance: float
    localisation: float
    missed: float
    false: float


def gospa(tracks: np.ndarray, truth: np.ndarray, cutoff: float, p: float = 2.0) -> Gospa:
    """The generalised OSPA distance, α = 2 (Rahmathullah, García-Fernández and Svensson 2017, proposition 1).

    Args:
        tracks: positions (a, d).
        truth: positions (b, d).
        cutoff: c, m: what a missed or false target costs is cᵖ/2.
        p: the order.
    """
    cost = _distances(tracks, truth) ** p
    i, j = linear_sum_assignment(np.minimum(cost, cutoff**p))
    matched = cost[i, j] < cutoff**p
    near = float(cost[i, j][matched].sum())
    half = cutoff**p / 2
    missed, false = half * (len(truth) - matched.sum()), half * (len(tracks) - matched.sum())
    return Gospa(float((near + missed + false) ** (1 / p)), near, float(missed), float(false))


def ospa(tracks: np.ndarray, truth: np.ndarray, cutoff: float, p: float = 2.0) -> float:
    """The OSPA distance (Schuhmacher, Vo and Vo 2008, (3)); the arguments of `gospa`, 0 for two empty sets."""
    n = max(len(tracks), len(truth))
    if not n:
        return 0.0
    cost = np.minimum(_distances(tracks, truth), cutoff) ** p
    i, j = linear_sum_assignment(cost)
    return float(((cost[i, j].sum() + cutoff**p * (n - len(i))) / n) ** (1 / p))


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, None] - b[None], axis=2)


class Quality(NamedTuple):
    """How well confirmed tracks follow targets.

    Attributes:
        rmse: by target, of the positions of its matched track; NaN where it never had one.
        held: by target, share of the times at which it had one.
        breaks: how often a target went on under another number.
        switches: how often a track went over from one target to another.
        false_tracks: confirmed tracks that were matched less than half of their life.
        minutes: how long the record is.
        ospa: mean over the times.
        gospa: the same.
        matched: by target, (time, id of the track, error) of each time it had one.
    """

    rmse: dict[str, float]
    held: dict[str, float]
    breaks: int
    switches: int
    false_tracks: int
    minutes: float
    ospa: float
    gospa: float
    matched: dict[str, list[tuple[float, int, float]]]

    @property
    def false_per_minute(self) -> float:
        """False tracks per minute of the record."""
        return self.false_tracks / max(self.minutes, 1e-9)


def quality(history: Sequence[Told], truths: Sequence[Truth], position: Sequence[int], cutoff: float) -> Quality:
    """Match confirmed tracks with targets, scan by scan, and count.

    A target keeps its track as long as that is within `cutoff` (m), as in CLEAR MOT (Bernardin and Stiefelhagen
    2008); the others are matched by least distance. Only times at which a target's truth is known count for it.
    """
    matched: dict[str, list[tuple[float, int, float]]] = {t.name: [] for t in truths}
    known = dict.fromkeys(matched, 0)
    last: dict[str, int] = {}
    owner: dict[int, str] = {}
    life: dict[int, list[int]] = {}
    breaks = switches = 0
    distances: list[tuple[float, float]] = []
    for told in history:
        where = {t.name: p for t in truths if (p := t.at(told.time)) is not None}
        if truths and not where:
            continue
        ids = told.id[told.confirmed].tolist()
        place = told.mean[told.confirmed][:, list(position)]
        names, points = list(where), np.array(list(where.values())).reshape(len(where), len(position))
        for name in names:
            known[name] += 1
        for i in ids:
            life.setdefault(i, [0, 0])[1] += 1
        cost = _distances(points, place)
        kept = np.array([[last.get(name) == i for i in ids] for name in names], bool).reshape(cost.shape)
        rows, columns = linear_sum_assignment(np.where(cost <= cutoff, cost - 2 * cutoff * kept, 1e9))
        for r, c in zip(rows, columns, strict=True):
            if cost[r, c] <= cutoff:
                name, i = names[r], ids[c]
                breaks += last.get(name, i) != i
                switches += owner.get(i, name) != name
                last[name] = i
                owner[i] = name
                life[i][0] += 1
                matched[name].append((told.time, i, float(cost[r, c])))
        distances.append((ospa(place, points, cutoff), gospa(place, points, cutoff).distance))
    span = history[-1].time - history[0].time if history else 0.0
    means = np.mean(distances, axis=0) if distances else np.full(2, np.nan)
    return Quality(
        rmse={n: float(np.sqrt(np.mean([e**2 for _, _, e in m]))) if m else float("nan") for n, m in matched.items()},
        held={n: len(m) / max(known[n], 1) for n, m in matched.items()},
        breaks=breaks,
        switches=switches,
        false_tracks=sum(2 * hits < scans for hits, scans in life.values()),
        minutes=span / 60,
        ospa=float(means[0]),
        gospa=float(means[1]),
        matched=matched,
    )
