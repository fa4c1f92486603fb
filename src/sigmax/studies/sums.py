"""What a block of runs leaves behind: sums, so that memory does not grow with the number of runs."""

from collections.abc import Mapping
from functools import reduce
from typing import NamedTuple

import numpy as np

from sigmax.algebra.arrays import wrapped
from sigmax.running.step import Fault

# Why a run is lost; the first that applies counts.
LOST = ("failed", "mirrored", "diverged")
# Errors are counted in bins of asinh(e / δ), δ being this part of the limit: straight near 0, by a few per cent beyond.
_FINE, _STEP, _BINS = 1e-5, 0.04, 800
# Numbers of factors that are summed at a time.
_AT_ONCE = 131_072


class Yardsticks(NamedTuple):
    """What errors are held against.

    Attributes:
        look: the places (L,) of the times that are looked at closely.
        limit: (n,), the error at the end beyond which a run has diverged.
        scale: (L, n), sizes for the bins of the histograms.
        angular: (n,), which components are angles.
    """

    look: np.ndarray
    limit: np.ndarray
    scale: np.ndarray
    angular: np.ndarray


class Estimated(NamedTuple):
    """What a filter made of a block: means (B, T, n), factors (B, T, n, n), faults, NIS and its degrees (B, T)."""

    mean: np.ndarray
    factor: np.ndarray
    fault: np.ndarray
    nis: np.ndarray
    dof: np.ndarray


class Sums(NamedTuple):
    """Sums over runs, by time (T) and component (n); e is the error, P the covariance that the filter claims.

    Attributes:
        runs: how many.
        e: Σ e (T, n).
        ee: Σ e eᵀ (T, n, n).
        e4: Σ e⁴ (T, n).
        P: Σ P (T, n, n).
        p2: Σ P_ii² (T, n).
        e2p: Σ e² P_ii (T, n).
        nees: Σ eᵀ P⁻¹ e (T,).
        nees2: Σ of its square (T,).
        known: Σ of its degrees of freedom (T,): components that are not known exactly.
        nis: Σ of the NIS (T,).
        nis2: Σ of its square (T,).
        dof: Σ of its degrees of freedom (T,).
        plots: runs with a measurement (T,).
        median: Σ over blocks of (runs × median of |e|) at the times looked at (L, n).
        median2: the same of the square of the median.
        blocks: how many blocks those are.
        lost: runs lost by reason (3,).
        faults: steps by fault, in the order of `Fault` (9,).
        bins: errors by bin at the times looked at (L, n, bins).
    """

    runs: np.ndarray
    e: np.ndarray
    ee: np.ndarray
    e4: np.ndarray
    P: np.ndarray
    p2: np.ndarray
    e2p: np.ndarray
    nees: np.ndarray
    nees2: np.ndarray
    known: np.ndarray
    nis: np.ndarray
    nis2: np.ndarray
    dof: np.ndarray
    plots: np.ndarray
    median: np.ndarray
    median2: np.ndarray
    blocks: np.ndarray
    lost: np.ndarray
    faults: np.ndarray
    bins: np.ndarray

    def plus(self, other: "Sums") -> "Sums":
        """The sums of both."""
        return Sums(*(a + b for a, b in zip(self, other, strict=True)))


def bin_edges(scale: np.ndarray) -> np.ndarray:
    """The edges (bins + 1, …) of the bins for errors of a scale (…)."""
    at = (np.arange(_BINS + 1) - _BINS / 2) * _STEP
    return np.multiply.outer(np.sinh(at), scale * _FINE)


def _binned(e: np.ndarray, scale: np.ndarray) -> np.ndarray:
    place = np.floor(np.arcsinh(e / (scale * _FINE)) / _STEP + _BINS / 2)
    return np.clip(place, 0, _BINS - 1).astype(int)


def _whitened(e: np.ndarray, S: np.ndarray) -> np.ndarray:
    """S⁻¹ e (n, ...) by components; one that is known exactly gives 0."""
    rows = np.zeros_like(e)
    for i, error in enumerate(e):
        rest = error - np.einsum("k...,k...->...", S[i, :i], rows[:i])
        np.divide(rest, S[i, i], out=rows[i], where=S[i, i] > 0)
    return rows


@np.errstate(over="ignore", invalid="ignore")  # a filter may be off by 1e80; infinity says so
def summed(found: Estimated, truth: np.ndarray, mirrored: np.ndarray | None, by: Yardsticks) -> Sums:
    """The sums of one filter over a block.

    Args:
        found: what the filter estimated.
        truth: (B, T, n).
        mirrored: the state (B, n) that is the same motion as the truth at the end, or None.
        by: what errors are held against.
    """
    B, T, n = truth.shape
    error = wrapped(found.mean - truth, by.angular)
    # As many runs at a time as the processor's cache holds: several times faster.
    few = max(1, _AT_ONCE // (T * n * n))
    parts = [slice(first, first + few) for first in range(0, B, few)]
    near = error[:, by.look]
    medians = np.median(np.abs(near), axis=0)
    bins = np.zeros((*near.shape[1:], _BINS), np.int64)
    place = _binned(near, by.scale)
    level, component = np.indices(near.shape[1:])
    np.add.at(bins, (np.broadcast_to(level, place.shape), np.broadcast_to(component, place.shape), place), 1)
    added = [reduce(np.add, terms) for terms in zip(*(_by_time(error[k], found, k) for k in parts), strict=True)]
    faults = np.array([np.count_nonzero(found.fault == f) for f in Fault])
    lost = _lost(found, error[:, -1], mirrored, by)
    return Sums._make([*added, B * medians, B * medians**2, np.array(1), lost, faults, bins])


def _by_time(error: np.ndarray, found: Estimated, runs: slice) -> tuple[np.ndarray, ...]:
    """The sums by time of some runs, in the order of `Sums`."""
    B, T, n = error.shape
    # One contiguous plane (B, T) for each component: several times faster than small matrices.
    e = np.moveaxis(error, -1, 0).copy()
    S = np.moveaxis(found.factor[runs].reshape(B, T, n * n), -1, 0).copy().reshape(n, n, B, T)
    squares, whitened, known = e * e, _whitened(e, S), np.stack([S[i, i] > 0 for i in range(n)])
    nees = reduce(np.add, whitened * whitened)
    ee, P, variances = np.empty((T, n, n)), np.empty((T, n, n)), np.empty_like(e)
    for i in range(n):
        for j in range(i):
            ee[:, i, j] = ee[:, j, i] = np.einsum("bt,bt->t", e[i], e[j])
            P[:, i, j] = P[:, j, i] = np.einsum("kbt,kbt->t", S[i, : j + 1], S[j, : j + 1])
        ee[:, i, i] = squares[i].sum(0)
        variances[i] = np.einsum("kbt,kbt->bt", S[i, : i + 1], S[i, : i + 1])
        P[:, i, i] = variances[i].sum(0)
    nis = found.nis[runs]
    seen = ~np.isnan(nis)
    nis = np.where(seen, nis, 0.0)
    return (
        np.array(B),
        e.sum(1).T,
        ee,
        np.einsum("ibt,ibt->ti", squares, squares),
        P,
        np.einsum("ibt,ibt->ti", variances, variances),
        np.einsum("ibt,ibt->ti", squares, variances),
        nees.sum(0),
        np.einsum("bt,bt->t", nees, nees),
        known.sum((0, 1)).astype(float),
        nis.sum(0),
        np.einsum("bt,bt->t", nis, nis),
        np.where(seen, found.dof[runs], 0).sum(0),
        seen.sum(0),
    )


def _lost(found: Estimated, last: np.ndarray, mirrored: np.ndarray | None, by: Yardsticks) -> np.ndarray:
    failed = np.any(found.fault > 0, axis=1)
    diverged = ~(np.abs(last) <= by.limit).all(1)
    turned = np.zeros_like(failed)
    if mirrored is not None:
        other = wrapped(found.mean[:, -1] - mirrored, by.angular)
        turned = ((other / by.limit) ** 2).sum(1) < ((last / by.limit) ** 2).sum(1)
    reasons: Mapping[str, np.ndarray] = {
        "failed": failed,
        "mirrored": turned & ~failed,
        "diverged": diverged & ~turned & ~failed,
    }
    return np.array([reasons[name].sum() for name in LOST])
