"""What the values of a record say by themselves, without any model: coarse, stuck and copied ones."""

from typing import NamedTuple

import numpy as np

# Rounding that adds less than this share to R is no finding.
_SHARE = 0.08


class Flaw(NamedTuple):
    """Something wrong with the values of a record.

    Attributes:
        kind: "coarse", "stuck" or "copies".
        size: the step of coarse values, the longest stretch of equal ones, the number of copies.
        concerned: how many values are concerned.
        first: the row where it begins.
        extra: the variance that coarse values add to R.
        rows: values (T,) to leave out.
    """

    kind: str
    size: float
    concerned: int
    first: int
    extra: float
    rows: np.ndarray


def flaw(values: np.ndarray, variance: float) -> Flaw | None:
    """Whether a component (T,) is coarse for its variance, or stuck; coarse values come before stuck ones."""
    rows = np.flatnonzero(np.isfinite(values))
    v = values[rows]
    if len(v) < 20:
        return None
    none = np.zeros(len(values), bool)
    distinct = np.unique(v)
    q = _step(distinct, len(v))
    if q and q * q / 12 > _SHARE * variance:
        return Flaw("coarse", q, len(v), int(rows[0]), q * q / 12, none)
    equal = np.flatnonzero(np.diff(v) == 0) + 1
    if not len(equal) or len(distinct) <= 0.3 * len(v):
        return None
    stretches = np.split(equal, np.flatnonzero(np.diff(equal) > 1) + 1)
    longest = max(stretches, key=len)
    if len(longest) + 1 < 6:
        return None
    out = none.copy()
    for stretch in stretches:
        if len(stretch) >= 3:
            out[rows[stretch]] = True
    return Flaw("stuck", len(longest) + 1, int(out.sum()), int(rows[longest[0] - 1]), 0.0, out)


def _step(distinct: np.ndarray, count: int) -> float:
    """The step of which all gaps between distinct values are multiples, 0 where there is none."""
    if len(distinct) < 2 or (len(distinct) == 2 and count <= 20 * len(distinct)):
        return 0.0
    gaps = np.diff(distinct)
    q = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    whole = np.abs(gaps / q - np.round(gaps / q)) < 1e-3
    return q if whole.mean() > 0.99 else 0.0


def copies(z: np.ndarray) -> Flaw | None:
    """Whether rows (T, M) repeat the one before, in values that are not coarse."""
    heard, T = np.isfinite(z), len(z)
    for j in range(z.shape[1]):
        v = z[heard[:, j], j]
        if len(np.unique(v)) < 0.5 * len(v):
            return None
    at = np.flatnonzero(heard.any(1))  # other sensors may be heard between two rows
    v, there = np.where(heard, z, 0.0)[at], heard[at]
    again = ((v[1:] == v[:-1]) & (there[1:] == there[:-1])).all(1)
    rows = np.zeros(T, bool)
    rows[at[1:][again]] = True
    if rows.sum() < 2:
        return None
    return Flaw("copies", float(rows.sum()), int(rows.sum()), int(np.argmax(rows)), 0.0, rows)
