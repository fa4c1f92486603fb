"""A Kalman filter and smoother in extended precision over many linear models at once: the judge of `random_models.py`.

NumPy alone, in square roots by reflections, 64 bits of mantissa; it shares no code with the library. Arrays have the
components first and the models last.
"""

from typing import NamedTuple

import numpy as np

Real = np.longdouble
# Where this is double precision (as on ARM, or with Microsoft's compiler) the judge is no better than the judged.
EXTENDED = np.finfo(Real).nmant >= 63


class Record(NamedTuple):
    """Linear models with their measurements.

    Attributes:
        mean, cov: the priors (n, B), (n, n, B).
        F, Q: of each step, (T, n, n, B).
        H, R: (T, m, n, B), (T, m, m, B).
        z: (T, m, B), NaN where missing.
    """

    mean: np.ndarray
    cov: np.ndarray
    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    z: np.ndarray


def lower(A: np.ndarray, rows: int | None = None) -> np.ndarray:
    """A (r, k, B) turned by reflections from the right until its first `rows` are lower triangular."""
    A = A.copy()
    for i in range(A.shape[0] if rows is None else rows):
        v = A[i, i:].copy()
        norm = np.sqrt((v * v).sum(0))
        v[0] += np.where(v[0] < 0, -norm, norm)
        size = (v * v).sum(0)
        along = np.einsum("rkb,kb->rb", A[i:, i:], v) * (2 / np.where(size > 0, size, 1))
        A[i:, i:] -= along[:, None] * v
    return A


def root(P: np.ndarray) -> np.ndarray:
    """Lower factor of covariances (n, n, B); a pivot that rounding of the matrix given can have made is 0."""
    P, n = P.astype(Real), len(P)
    variance = np.einsum("iib->ib", P).copy()
    S = np.zeros_like(P)
    for j in range(n):
        usable = P[j, j] > 32 * n * np.finfo(float).eps * variance[j]
        pivot = np.sqrt(np.where(usable, P[j, j], 1))
        S[j:, j] = np.where(usable, P[j:, j] / pivot, 0)
        P[j:, j:] -= S[j:, None, j] * S[None, j:, j]
    return S


def solved(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """L⁻¹ b for lower triangles (n, n, B) and b (n, k, B)."""
    x = np.empty_like(b)
    for i in range(len(L)):
        x[i] = (b[i] - np.einsum("jb,jkb->kb", L[i, :i], x[:i])) / L[i, i]
    return x


def _times(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    return np.einsum("ijb,j...b->i...b", A, B)


class Track(NamedTuple):
    """Means (T, n, B) and standard deviations."""

    mean: np.ndarray
    std: np.ndarray


def filtered_and_smoothed(record: Record) -> tuple[Track, Track]:
    """What the Kalman filter and the fixed-interval smoother know at each step."""
    x, S = record.mean.astype(Real), root(record.cov)
    n, T = len(x), len(record.z)
    kept = []
    for k in range(T):
        F, H, Lq = record.F[k].astype(Real), record.H[k].astype(Real), root(record.Q[k])
        before, root_before = x, S
        x = _times(F, x)
        S = lower(np.concatenate([_times(F, S), Lq], axis=1))[:, :n]
        ahead = x
        seen = ~np.isnan(record.z[k])
        both = seen[:, None] & seen[None]
        Lr = root(np.where(both, record.R[k], np.eye(len(seen))[:, :, None]))
        H = np.where(seen[:, None], H, 0)
        nu = np.where(seen, np.where(seen, record.z[k], 0) - _times(H, x), 0)
        m = len(seen)
        top = np.concatenate([Lr, _times(H, S)], axis=1)
        array = lower(np.concatenate([top, np.concatenate([np.zeros((n, m, x.shape[1]), Real), S], axis=1)]))
        x = x + _times(array[m:, :m], solved(array[:m, :m], nu[:, None]))[:, 0]
        S = array[m:, m:]
        kept.append((before, root_before, F, Lq, ahead, x, S))
    means, stds = [x], [_std(S)]
    late, late_root = x, S
    for k in range(T - 1, 0, -1):
        before, S, F, Lq, ahead, *_ = kept[k]
        below = np.concatenate([S, np.zeros_like(S)], axis=1)
        array = lower(np.concatenate([np.concatenate([_times(F, S), Lq], axis=1), below]), n)
        predicted, cross, left = array[:n, :n], array[n:, :n], array[n:, n:]
        along = solved(predicted, np.concatenate([(late - ahead)[:, None], late_root], axis=1))
        late = before + _times(cross, along[:, 0])
        late_root = lower(np.concatenate([left, _times(cross, along[:, 1:])], axis=1))[:, :n]
        means.append(late)
        stds.append(_std(late_root))
    filtered = Track(np.array([step[5] for step in kept]), np.array([_std(step[6]) for step in kept]))
    return filtered, Track(np.array(means[::-1]), np.array(stds[::-1]))


def _std(S: np.ndarray) -> np.ndarray:
    return np.sqrt((S * S).sum(1))
