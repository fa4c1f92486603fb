"""From sums to what people read, each figure with its Monte Carlo error."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from sigmax.studies.sums import LOST, Sums, bin_edges


class Figure(NamedTuple):
    """A number with its standard error; arrays of the same shape."""

    value: np.ndarray
    error: np.ndarray


class Bounded(NamedTuple):
    """A mean that an honest filter keeps between bounds in 95 of 100 studies; all (T,)."""

    value: np.ndarray
    expected: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Measures(NamedTuple):
    """What the sums of one filter say.

    Attributes:
        runs: how many runs they are of.
        rmse: root mean square error (T, n), over all runs, the lost ones too.
        bias: mean error (T, n).
        median: median of |e| at the times looked at (L, n): the mean of the medians of blocks of runs.
        real: G, the covariance of the real errors about 0 (T, n, n).
        claimed: G~, the mean of the covariances that the filter computed (T, n, n).
        ratio: diagonal of G over that of G~ (T, n), 1 for an honest filter (Stepanov et al., (46)).
        nees: mean of eᵀ P⁻¹ e (T,).
        typical: NEES per degree of freedom of the run in the middle, over its time: one that a few runs cannot move.
        far: share of the runs whose NEES is over `FAR_OFF` times what is expected.
        outside: shares of the runs with the truth outside of the claimed 50 % and 95 % regions (2, T, n + 1), of the
            whole state and of each component.
        nis: mean of the normalised innovation squared (T,).
        largest: the largest |e| over runs (T, n).
        lost: share of the runs lost by reason, and of all of them under "all".
        faults: how many steps had each fault, in the order of `Fault` (9,).
    """

    runs: int
    rmse: Figure
    bias: Figure
    median: Figure
    real: np.ndarray
    claimed: np.ndarray
    ratio: Figure
    nees: Bounded
    typical: float
    far: float
    outside: np.ndarray
    nis: Bounded
    largest: np.ndarray
    lost: dict[str, Figure]
    faults: np.ndarray


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def measures(s: Sums) -> Measures:
    """What the sums say."""
    N = int(s.runs)
    G, claimed = s.ee / N, s.P / N
    g = np.einsum("tii->ti", G)
    p = np.einsum("tii->ti", claimed)
    rmse = np.sqrt(g)
    spread = np.maximum(s.e4 / N - g**2, 0.0)
    rmse_error = np.where(rmse > 0, np.sqrt(spread / N) / (2 * rmse), 0.0)
    mean = s.e / N
    ratio = g / p
    between = s.e2p / N - g * p
    claims = np.maximum(s.p2 / N - p**2, 0.0)
    ratio_error = np.sqrt(np.maximum(spread - 2 * ratio * between + ratio**2 * claims, 0.0) / N) / p
    middle = s.median / N
    blocks = int(s.blocks)
    between_blocks = np.maximum(s.median2 / N - middle**2, 0.0)
    # A single block tells nothing of its own spread; then the asymptotic error of a normal sample's.
    median_error = np.sqrt(between_blocks / (blocks - 1)) if blocks > 1 else 1.17 * middle / np.sqrt(N)
    return Measures(
        N,
        Figure(rmse, rmse_error),
        Figure(mean, np.sqrt(np.maximum(g - mean**2, 0.0) / N)),
        Figure(middle, median_error),
        G,
        claimed,
        Figure(ratio, ratio_error),
        _chi_square(s.nees, s.known, np.broadcast_to(s.runs, s.nees.shape)),
        float(s.typical / N),
        float(s.far / N),
        s.outside / N,
        _chi_square(s.nis, s.dof, s.plots),
        s.largest,
        {name: _share(count, N) for name, count in zip((*LOST, "all"), (*s.lost, s.lost.sum()), strict=True)},
        s.faults,
    )


@np.errstate(invalid="ignore", divide="ignore")
def tends_to(half: Measures, whole: Measures) -> Measures:
    """What an optimum by particles tends to, from N and from 2N of them over the same runs.

    With finitely many the mean is off by chance and the weighted covariance is too small, both by an error of order
    1/N: it is extrapolated away, 2 a(2N) − a(N), in errors, medians and claimed covariances.
    """

    def beyond(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Of what is positive; where so few runs say nothing, as with 2N."""
        more = 2 * b - a
        return np.where((more > b / 2) & (more < 2 * b), more, b)

    i = np.arange(whole.claimed.shape[-1])
    claimed = 2 * whole.claimed - half.claimed
    p = claimed[:, i, i] = beyond(half.claimed[:, i, i], whole.claimed[:, i, i])
    g = beyond(half.rmse.value**2, whole.rmse.value**2)
    return whole._replace(
        rmse=Figure(np.sqrt(g), whole.rmse.error),
        median=Figure(beyond(half.median.value, whole.median.value), whole.median.error),
        claimed=claimed,
        ratio=Figure(g / p, whole.ratio.error),
    )


def _chi_square(total: np.ndarray, dof: np.ndarray, count: np.ndarray) -> Bounded:
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high = (chdtri(dof, q) / count for q in (0.975, 0.025))
        return Bounded(total / count, dof / count, low, high)


def _share(count: int, of: int) -> Figure:
    share = count / of
    return Figure(np.array(share), np.array(np.sqrt(share * (1 - share) / of)))


def histogram(bins: np.ndarray, scale: float, reach: float, count: int = 41) -> tuple[np.ndarray, np.ndarray]:
    """The density of errors (count,) and the edges (count + 1,) of equal bins from −reach to reach.

    Args:
        bins: counts of one time and component, see `Sums`.
        scale: the scale of their bins.
        reach: where the picture ends; what lies beyond is left out of it.
        count: how many bins it has.
    """
    edges = np.linspace(-reach, reach, count + 1)
    # Within a bin errors are supposed to lie evenly.
    below = np.interp(edges, bin_edges(np.array(scale)), np.concatenate([[0], bins.cumsum()]))
    return np.diff(below) / (bins.sum() * np.diff(edges)), edges


def claimed_density(x: np.ndarray, deviation: float) -> np.ndarray:
    """The Gaussian that a filter claims at errors x, 0 where it claims to be exact."""
    if not deviation > 0:
        return np.zeros_like(x)
    return np.exp(-0.5 * (x / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi))


def distance(rmse: np.ndarray, reference: np.ndarray) -> float:
    """How much larger errors are than those of a reference, as a mean ratio over times and components.

    The geometric mean, so that no component and no time outweighs others by its unit or its size.
    """
    usable = (rmse > 0) & (reference > 0) & np.isfinite(rmse) & np.isfinite(reference)
    return float(np.exp(np.log(rmse[usable] / reference[usable]).mean())) if usable.any() else float("nan")
