"""What a block of runs leaves behind: sums, so that memory does not grow with the number of runs."""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from sigmax.algebra.arrays import wrapped
from sigmax.running.step import Fault

# Why a run is lost; the first that applies counts.
LOST = ("failed", "mirrored", "diverged")
# Errors are counted in bins of asinh(e / δ), δ being this part of the limit: straight near 0, by a few per cent beyond.
_FINE, _STEP, _BINS = 1e-5, 0.04, 800


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


def _whitened(e: Sequence[np.ndarray], S: Mapping[tuple[int, int], np.ndarray]) -> list[np.ndarray]:
    """S⁻¹ e by components; one that is known exactly gives 0."""
    rows: list[np.ndarray] = []
    for i, error in enumerate(e):
        rest = error.copy()
        for j in range(i):
            rest -= S[i, j] * rows[j]
        rows.append(np.divide(rest, S[i, i], out=np.zeros_like(rest), where=S[i, i] > 0))
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
    n = truth.shape[-1]
    error = wrapped(found.mean - truth, by.angular)
    # One contiguous plane (B, T) for each component: several times faster than small matrices.
    e = [np.ascontiguousarray(error[..., i]) for i in range(n)]
    S = {(i, j): np.ascontiguousarray(found.factor[..., i, j]) for i in range(n) for j in range(i + 1)}
    nees = _total([row**2 for row in _whitened(e, S)])
    known = _total([(S[i, i] > 0).astype(float) for i in range(n)])
    squares = [row**2 for row in e]
    variances = [_total([S[i, k] ** 2 for k in range(i + 1)]) for i in range(n)]
    T = truth.shape[1]
    ee, P = np.empty((T, n, n)), np.empty((T, n, n))
    for i in range(n):
        for j in range(i + 1):
            ee[:, i, j] = ee[:, j, i] = (e[i] * e[j]).sum(0)
            covariance = variances[i] if i == j else _total([S[i, k] * S[j, k] for k in range(j + 1)])
            P[:, i, j] = P[:, j, i] = covariance.sum(0)
    seen = ~np.isnan(found.nis)
    nis = np.where(seen, found.nis, 0.0)
    near = error[:, by.look]
    medians = np.median(np.abs(near), axis=0)
    B = len(error)
    bins = np.zeros((*near.shape[1:], _BINS), np.int64)
    place = _binned(near, by.scale)
    level, component = np.indices(near.shape[1:])
    np.add.at(bins, (np.broadcast_to(level, place.shape), np.broadcast_to(component, place.shape), place), 1)
    return Sums(
        runs=np.array(B),
        e=_by_time(e),
        ee=ee,
        e4=_by_time([row**2 for row in squares]),
        P=P,
        p2=_by_time([row**2 for row in variances]),
        e2p=_by_time([a * b for a, b in zip(squares, variances, strict=True)]),
        nees=nees.sum(0),
        nees2=(nees**2).sum(0),
        known=known.sum(0),
        nis=nis.sum(0),
        nis2=(nis**2).sum(0),
        dof=np.where(seen, found.dof, 0).sum(0),
        plots=seen.sum(0),
        median=B * medians,
        median2=B * medians**2,
        blocks=np.array(1),
        lost=_lost(found, error[:, -1], mirrored, by),
        faults=np.array([np.count_nonzero(found.fault == f) for f in Fault]),
        bins=bins,
    )


def _total(terms: Sequence[np.ndarray]) -> np.ndarray:
    return reduce(np.add, terms)


def _by_time(planes: Sequence[np.ndarray]) -> np.ndarray:
    """Sums over runs (T, n) of planes (B, T)."""
    return np.stack([plane.sum(0) for plane in planes], axis=-1)


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
