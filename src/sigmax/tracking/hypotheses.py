"""Tracks that begin from one plot with a bank of hypotheses of course and speed."""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sigmax.errors import InputError
from sigmax.modelling.parts import made_once
from sigmax.tracking.detector import Located
from sigmax.tracking.initiate import Births, Free, Initiate, with_velocity
from sigmax.tracking.mixture import merged, summed

# A hypothesis of less than this share of its family is given up.
_LEAST = 1e-3
_GATE = 16.0
_PLANE = (False,) * 4


class _Bank(NamedTuple):
    """Hypotheses (H,): families are the plots they began with.

    Attributes:
        time: seconds.
        mean: position and velocity (H, 4).
        cov: (H, 4, 4).
        family: (H,).
        weight: within the family (H,).
        plot: the last plot of each (H,), -1 for none in this scan.
        born: time of each family's first plot (F,).
        hits: plots of each family (F,).
    """

    time: float
    mean: np.ndarray
    cov: np.ndarray
    family: np.ndarray
    weight: np.ndarray
    plot: np.ndarray
    born: np.ndarray
    hits: np.ndarray


@made_once
def hypotheses(
    max_speed: float,
    *,
    speeds: int = 4,
    courses: int = 12,
    plots: int = 3,
    within: float = 30.0,
    detection: float = 0.9,
    clutter: float = 1e-8,
) -> Initiate:
    """One plot begins `speeds` · `courses` hypotheses in the plane; plots to come say which of them hold.

    The hypotheses cover all velocities up to `max_speed` in cells of equal speed steps and courses; each is a
    straight line with its own Gaussian of position and velocity, all of them moved, gated and weighed in one go. A
    family that has had `plots` plots becomes one track, with the mean and covariance of its hypotheses. Where the
    first plots are far apart this finds tracks that a straight two-point start joins wrongly (the hypotheses are
    weighed by all plots, not by two). A radial velocity leaves few of them at once.

    Args:
        max_speed: m/s.
        speeds: rings of speed.
        courses: directions in each.
        plots: how many plots a family needs.
        within: seconds from the first plot in which it must have had them.
        detection: probability that a target is seen in a scan.
        clutter: false plots per m² and scan.

    Raises:
        InputError: for numbers that make no bank.
    """
    if not max_speed > 0 or speeds < 1 or courses < 3 or plots < 2:
        raise InputError(
            "a bank needs max_speed above 0, a speed, 3 courses and 2 plots; "
            f"got {max_speed}, {speeds}, {courses}, {plots}"
        )
    ring = (np.arange(speeds) + 0.5) * max_speed / speeds
    course = np.arange(courses) * 2 * np.pi / courses
    velocity = (ring[:, None, None] * np.stack([np.cos(course), np.sin(course)], 1)).reshape(-1, 2)
    # Each Gaussian is as wide as its cell, along and across.
    along = np.stack([np.cos(course), np.sin(course)], 1)
    outer = along[:, :, None] * along[:, None, :]
    across = (ring * 2 * np.pi / courses) ** 2 / 12
    spread = (max_speed / speeds) ** 2 / 12 * outer + across[:, None, None, None] * (np.eye(2) - outer)
    spread = spread.reshape(-1, 2, 2)
    # The rings are of unequal size.
    share = np.repeat(ring / ring.sum() / courses, courses)

    def initiate(free: Free, memory: Any) -> tuple[Births, Any]:
        bank = _weighed(memory, free, detection, clutter) if memory is not None else None
        taken = np.zeros(len(free.plot), bool)
        births = Births(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 4, 4)), np.empty(0, int), plots)
        if bank is not None:
            taken[bank.plot[bank.plot >= 0]] = True
            births, bank = _decided(bank, free, plots, within)
        new = np.flatnonzero(~taken)
        return births, _joined(bank, _begun(free, new, velocity, spread, share))

    return initiate


def _begun(free: Free, new: np.ndarray, velocity: np.ndarray, spread: np.ndarray, share: np.ndarray) -> _Bank:
    F, H = len(new), len(velocity)
    family = np.repeat(np.arange(F), H)
    where = free.where.take(new[family])
    cov = np.zeros((F * H, 4, 4))
    cov[:, :2, :2], cov[:, 2:, 2:] = where.cov, np.tile(spread, (F, 1, 1))
    speed = np.tile(velocity, (F, 1))
    weight = np.tile(share, F)
    if where.radial is not None and where.direction is not None:
        miss = where.radial - (where.direction * speed).sum(1)
        variance = np.einsum("ki,kij,kj->k", where.direction, cov[:, 2:, 2:], where.direction) + where.radial_variance
        weight = weight * np.where(np.isnan(miss), 1.0, np.exp(-0.5 * miss**2 / variance) / np.sqrt(variance))
        weight = weight / np.maximum(summed(weight, family, F), 1e-300)[family]
    born = with_velocity(Births(where.position, speed, cov, new[family], 1), where)
    mean = np.concatenate([born.position, born.velocity], axis=1)
    bank = _Bank(free.time, mean, born.cov, family, weight, new[family], np.full(F, free.time), np.ones(F, int))
    return _pruned(bank)


def _weighed(bank: _Bank, free: Free, detection: float, clutter: float) -> _Bank:
    """The bank after a scan: moved on a straight line, each hypothesis with its likeliest plot."""
    dt = free.time - bank.time
    F = np.eye(4)
    F[:2, 2:] = np.eye(2) * dt
    mean, cov = bank.mean @ F.T, F @ bank.cov @ F.T
    H, k = len(mean), len(free.plot)
    plot = np.full(H, -1)
    gain = np.full(H, np.log(1 - min(detection, 0.999)))
    if H and k:
        reach = np.sqrt(_GATE * (np.linalg.eigvalsh(cov[:, :2, :2])[:, -1] + _widest(free.where)))
        near = cKDTree(free.where.position).query_ball_point(mean[:, :2], reach)
        i = np.repeat(np.arange(H), [len(some) for some in near])
        j = np.fromiter((p for some in near for p in some), int, len(i))
        S = cov[i, :2, :2] + free.where.cov[j]
        miss = free.where.position[j] - mean[i, :2]
        nis = np.einsum("ki,ki->k", miss, np.linalg.solve(S, miss[:, :, None])[:, :, 0])
        log = -0.5 * nis - 0.5 * np.log(np.linalg.det(S)) + np.log(detection / clutter) - np.log(2 * np.pi)
        fits = nis <= _GATE
        order = np.argsort(log[fits], kind="stable")
        i, j, log = i[fits][order], j[fits][order], log[fits][order]
        plot[i], gain[i] = j, log
        hit = plot >= 0
        S = cov[hit, :2, :2] + free.where.cov[plot[hit]]
        K = np.linalg.solve(S, cov[hit, :2]).swapaxes(1, 2)
        miss = free.where.position[plot[hit]] - mean[hit, :2]
        mean[hit] += (K @ miss[:, :, None])[:, :, 0]
        cov[hit] -= K @ cov[hit, :2]
    top = np.full(len(bank.born), -np.inf)
    np.maximum.at(top, bank.family, gain)
    weight = bank.weight * np.exp(gain - top[bank.family])
    total = summed(weight, bank.family, len(bank.born))
    found = np.zeros(len(bank.born), int)
    np.maximum.at(found, bank.family, plot >= 0)
    return bank._replace(
        time=free.time,
        mean=mean,
        cov=(cov + cov.swapaxes(1, 2)) / 2,
        weight=weight / total[bank.family],
        plot=plot,
        hits=bank.hits + found,
    )


def _decided(bank: _Bank, free: Free, plots: int, within: float) -> tuple[Births, _Bank]:
    """Families with plots enough become tracks; those that took too long are given up."""
    ready = (bank.hits >= plots) & (summed((bank.plot >= 0).astype(float), bank.family, len(bank.born)) > 0)
    members = ready[bank.family]
    group = (np.cumsum(ready) - 1)[bank.family[members]]
    mean, cov = merged(bank.mean[members], bank.cov[members], bank.weight[members], group, int(ready.sum()), _PLANE)
    heaviest = np.full(int(ready.sum()), -1)
    order = np.argsort(np.where(bank.plot[members] >= 0, bank.weight[members], -1), kind="stable")
    heaviest[group[order]] = bank.plot[members][order]
    # Two families may have come to the same plot: the one that had more plots is the track.
    _, first = np.unique(heaviest, return_index=True)
    births = Births(mean[first, :2], mean[first, 2:], cov[first], free.plot[heaviest[first]], plots)
    stays = ~ready & (free.time - bank.born <= within)
    return births, _pruned(bank, stays)


def _pruned(bank: _Bank, families: np.ndarray | None = None) -> _Bank:
    families = np.ones(len(bank.born), bool) if families is None else families
    kept = families[bank.family] & (bank.weight > _LEAST)
    total = summed(np.where(kept, bank.weight, 0.0), bank.family, len(bank.born))
    family = bank.family[kept]
    return bank._replace(
        mean=bank.mean[kept],
        cov=bank.cov[kept],
        family=(np.cumsum(families) - 1)[family],
        weight=bank.weight[kept] / total[family],
        plot=bank.plot[kept],
        born=bank.born[families],
        hits=bank.hits[families],
    )


def _joined(bank: _Bank | None, other: _Bank) -> _Bank:
    if bank is None:
        return other
    F = len(bank.born)
    shifted = other._replace(family=other.family + F)
    parts = (np.concatenate(pair) for pair in zip(bank[1:], shifted[1:], strict=True))
    return _Bank(other.time, *parts)


def _widest(where: Located) -> float:
    return float(np.linalg.eigvalsh(where.cov)[:, -1].max(initial=0.0))
