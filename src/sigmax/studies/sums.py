"""What a block of runs leaves behind: sums, so that memory does not grow with the number of runs."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer, total, wrap, wrapped
from sigmax.running.mapped import totals
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


@lru_cache(maxsize=16)
def _terms(angular: tuple[bool, ...]) -> Callable[..., Any]:
    """What is added up of one run and step, in the order of `Sums`, matrices by their lower triangles."""
    n = len(angular)
    i, j = np.tril_indices(n)

    def terms(mean: Any, factor: Any, truth: Any, nis: Any, dof: Any) -> tuple[Any, ...]:
        e, S = wrap(mean - truth, angular), jnp.tril(factor)
        P = outer(S, S)
        every = np.arange(n)
        squares, variances, known = e * e, P[every, every], S[every, every] > 0
        whitened: list[Any] = []
        for k in range(n):
            rest = e[k] - sum(S[k, c] * w for c, w in enumerate(whitened))
            # One that is known exactly counts for nothing.
            whitened.append(jnp.where(known[k], rest / jnp.where(known[k], S[k, k], 1.0), 0.0))
        nees = total([w * w for w in whitened])
        seen = ~jnp.isnan(nis)
        nis = jnp.where(seen, nis, 0.0)
        products = (e, e[i] * e[j], squares * squares, P[i, j], variances * variances, squares * variances)
        counted = [
            jnp.where(known, 1.0, 0.0).sum(),
            nis,
            nis * nis,
            jnp.where(seen, dof, 0.0),
            jnp.where(seen, 1.0, 0.0),
        ]
        return (*products, nees, nees * nees, *counted)

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
    B, n = len(truth), truth.shape[-1]
    angular = tuple(map(bool, by.angular))
    given = (found.mean, found.factor, truth, found.nis, np.asarray(found.dof, float))
    e, ee, e4, P, p2, e2p, *rest = totals(_terms(angular), *given, backend=backend)
    *by_time, dof, plots = rest
    near = wrapped(found.mean[:, by.look] - truth[:, by.look], angular)
    medians = np.median(np.abs(near), axis=0)
    bins = np.zeros((*near.shape[1:], _BINS), np.int64)
    place = _binned(near, by.scale)
    level, component = np.indices(near.shape[1:])
    np.add.at(bins, (np.broadcast_to(level, place.shape), np.broadcast_to(component, place.shape), place), 1)
    faults = np.array([np.count_nonzero(found.fault == f) for f in Fault])
    lost = _lost(found, wrapped(found.mean[:, -1] - truth[:, -1], angular), mirrored, by)
    sums = (np.array(B), e, _whole(ee, n), e4, _whole(P, n), p2, e2p, *by_time, dof.astype(int), plots.astype(int))
    return Sums._make([*sums, B * medians, B * medians**2, np.array(1), lost, faults, bins])


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
