"""What a filter claims of its errors, held against what they are."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from sigmax.spaces import Space, errors

# The regions that a filter claims to hold the truth with these probabilities: it is counted how often they do not.
LEVELS = (0.5, 0.95)
# A component that is claimed to be known exactly may be off by rounding, as a part of its size.
_EXACT = 1e-9


class Claims(NamedTuple):
    """What a filter claims of its errors, by run and time.

    Attributes:
        nees: eᵀ P⁻¹ e (B, T).
        known: its degrees of freedom (B, T).
        largest: the largest |e| over runs (T, n), infinite where an error is not a number.
        outside: whether the truth is outside of the regions of `LEVELS` (2, B, T, n + 1).
    """

    nees: np.ndarray
    known: np.ndarray
    largest: np.ndarray
    outside: np.ndarray


def claims_of(mean: np.ndarray, factor: np.ndarray, truth: np.ndarray, space: Space) -> Claims:
    """Estimates (B, T, n) with factors (B, T, n, n) held against the truth (B, T, n)."""
    n = space.dim
    e, S = errors(space, mean, truth), np.tril(factor)
    size = np.abs(truth) if space.flat else np.zeros_like(e)
    variances = np.einsum("btij,btij->bti", S, S)
    whitened: list[np.ndarray] = []
    wrong = np.zeros(e.shape, bool)
    for k in range(n):
        rest = e[..., k] - sum((S[..., k, c] * w for c, w in enumerate(whitened)), np.zeros(e.shape[:-1]))
        exact = ~(S[..., k, k] > 0)
        # One that is known exactly counts for nothing in the NEES, but it must be right.
        wrong[..., k] = exact & ~(np.abs(rest) <= _EXACT * (1.0 + size[..., k]))
        whitened.append(np.where(exact, 0.0, rest / np.where(exact, 1.0, S[..., k, k])))
    nees = sum((w * w for w in whitened), np.zeros(e.shape[:-1]))
    known = np.count_nonzero(np.einsum("btii->bti", S) > 0, axis=-1)
    single = np.where(variances > 0, e**2 / np.where(variances > 0, variances, 1.0), 0.0)
    outside = []
    for level in LEVELS:
        reach = np.array([0.0, *chdtri(np.arange(1, n + 1), 1 - level)])
        whole = ~(nees <= reach[known]) | wrong.any(-1)
        outside.append(np.concatenate([whole[..., None], ~(single <= reach[1]) | wrong], axis=-1))
    largest = np.where(np.isnan(e), np.inf, np.abs(e)).max(axis=0, initial=0.0)
    return Claims(nees, known, largest, np.array(outside))
