"""What a block of runs leaves behind: sums, so that memory does not grow with the number of runs."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer, wrap
from sigmax.engine.vectorized import totals
from sigmax.spaces import Space, errors
from sigmax.steps.step import Fault
from sigmax.studies.claims import claims_of

# Why a run is lost; the first that applies counts.
LOST = ("failed", "mirrored", "diverged")
# A run is far off if its NEES, on average over its time, is so many times what is expected: errors twice as large.
FAR_OFF = 4.0
# Errors are counted in bins of asinh(e / δ), δ being this part of the limit: straight near 0, by a few per cent beyond.
_FINE, _STEP, _BINS = 1e-5, 0.04, 800


class Yardsticks(NamedTuple):
    """What errors are held against.

    Attributes:
        look: the places (L,) of the times that are looked at closely.
        limit: (d,), the error at the end beyond which a run has diverged.
        scale: (L, d), sizes for the bins of the histograms.
        space: where the state lives.
    """

    look: np.ndarray
    limit: np.ndarray
    scale: np.ndarray
    space: Space


class Estimated(NamedTuple):
    """What a filter made of a block: means (B, T, n), factors (B, T, n, n), faults, NIS and its degrees (B, T)."""

    mean: np.ndarray
    factor: np.ndarray
    fault: np.ndarray
    nis: np.ndarray
    dof: np.ndarray


class Sums(NamedTuple):
    """Sums over runs, by time (T) and deviation (n); e is the error, P the covariance that the filter claims.

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
        outside: runs with the truth outside of the claimed region of each of `LEVELS` (2, T, n + 1): of the whole
            state by the chi-square law of eᵀ P⁻¹ e, then of each component by that of e² / P_ii.
        far: runs that are far off, see `FAR_OFF`.
        typical: Σ over blocks of (runs × median over runs of the NEES per degree of freedom of a run over its time).
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
        largest: max over runs of |e| (T, n), infinite where an error is not a number.
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
    outside: np.ndarray
    far: np.ndarray
    typical: np.ndarray
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
    largest: np.ndarray

    def plus(self, other: "Sums") -> "Sums":
        """Of both: the sums, and the largest of each."""
        both = Sums(*(a + b for a, b in zip(self, other, strict=True)))
        return both._replace(largest=np.maximum(self.largest, other.largest))


def bin_edges(scale: np.ndarray) -> np.ndarray:
    """The edges (bins + 1, …) of the bins for errors of a scale (…)."""
    at = (np.arange(_BINS + 1) - _BINS / 2) * _STEP
    return np.multiply.outer(np.sinh(at), scale * _FINE)


def _binned(e: np.ndarray, scale: np.ndarray) -> np.ndarray:
    place = np.floor(np.arcsinh(e / (scale * _FINE)) / _STEP + _BINS / 2)
    return np.clip(place, 0, _BINS - 1).astype(int)


@lru_cache(maxsize=16)
def _terms(space: Space) -> Callable[..., Any]:
    """What is added up of one run and step, in the order of `Sums`, matrices by their lower triangles."""
    n = space.dim
    i, j = np.tril_indices(n)

    def terms(mean: Any, factor: Any, truth: Any, nis: Any, dof: Any) -> tuple[Any, ...]:
        e = wrap(mean - truth, space.periodic) if space.flat else -space.difference(truth, mean)
        S = jnp.tril(factor)
        P = outer(S, S)
        every = np.arange(n)
        squares, variances = e * e, P[every, every]
        seen = ~jnp.isnan(nis)
        nis = jnp.where(seen, nis, 0.0)
        products = (e, e[i] * e[j], squares * squares, P[i, j], variances * variances, squares * variances)
        return (*products, nis, nis * nis, jnp.where(seen, dof, 0.0), jnp.where(seen, 1.0, 0.0))

    return terms


def _whole(triangle: np.ndarray, n: int) -> np.ndarray:
    """Symmetric matrices (T, n, n) of lower triangles (T, n (n + 1) / 2)."""
    full = np.empty((len(triangle), n, n))
    i, j = np.tril_indices(n)
    full[:, i, j] = full[:, j, i] = triangle
    return full


@np.errstate(over="ignore", invalid="ignore")  # a filter may be off by 1e80; infinity says so
def summed(
    found: Estimated, truth: np.ndarray, mirrored: np.ndarray | None, by: Yardsticks, backend: str | None = None
) -> Sums:
    """The sums of one filter over a block.

    Args:
        found: what the filter estimated.
        truth: (B, T, n).
        mirrored: the state (B, n) that is the same motion as the truth at the end, or None.
        by: what errors are held against.
        backend: as in `run`.
    """
    B, n, space = len(truth), by.space.dim, by.space
    given = (found.mean, found.factor, truth, found.nis, np.asarray(found.dof, float))
    e, ee, e4, P, p2, e2p, nis, nis2, dof, plots = totals(_terms(space), *given, backend=backend)
    claims = claims_of(found.mean, found.factor, truth, space)
    by_run = claims.nees.sum(1) / np.maximum(claims.known.sum(1), 1)
    by_time = (claims.nees.sum(0), (claims.nees**2).sum(0), claims.known.sum(0))
    near = errors(space, found.mean[:, by.look], truth[:, by.look])
    medians = np.median(np.abs(near), axis=0)
    bins = np.zeros((*near.shape[1:], _BINS), np.int64)
    place = _binned(near, by.scale)
    level, component = np.indices(near.shape[1:])
    np.add.at(bins, (np.broadcast_to(level, place.shape), np.broadcast_to(component, place.shape), place), 1)
    faults = np.array([np.count_nonzero(found.fault == f) for f in Fault])
    lost = _lost(found, errors(space, found.mean[:, -1], truth[:, -1]), mirrored, by)
    return Sums(
        runs=np.array(B),
        e=e,
        ee=_whole(ee, n),
        e4=e4,
        P=_whole(P, n),
        p2=p2,
        e2p=e2p,
        nees=by_time[0],
        nees2=by_time[1],
        known=by_time[2],
        outside=claims.outside.sum(1),
        far=np.array(np.count_nonzero(~(by_run <= FAR_OFF))),
        typical=B * np.median(by_run),
        nis=nis,
        nis2=nis2,
        dof=dof.astype(int),
        plots=plots.astype(int),
        median=B * medians,
        median2=B * medians**2,
        blocks=np.array(1),
        lost=lost,
        faults=faults,
        bins=bins,
        largest=claims.largest,
    )


def _lost(found: Estimated, last: np.ndarray, mirrored: np.ndarray | None, by: Yardsticks) -> np.ndarray:
    failed = np.any(found.fault > 0, axis=1)
    diverged = ~(np.abs(last) <= by.limit).all(1)
    turned = np.zeros_like(failed)
    if mirrored is not None:
        other = errors(by.space, found.mean[:, -1], mirrored)
        turned = ((other / by.limit) ** 2).sum(1) < ((last / by.limit) ** 2).sum(1)
    reasons: Mapping[str, np.ndarray] = {
        "failed": failed,
        "mirrored": turned & ~failed,
        "diverged": diverged & ~turned & ~failed,
    }
    return np.array([reasons[name].sum() for name in LOST])
