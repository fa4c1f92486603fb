"""Mixtures of Gaussians, many at once: each member belongs to a group, a group becomes one Gaussian."""

from collections.abc import Sequence

import numpy as np

from sigmax.algebra.arrays import wrapped


def merged(
    mean: np.ndarray, cov: np.ndarray, weight: np.ndarray, group: np.ndarray, count: int, angular: Sequence[bool]
) -> tuple[np.ndarray, np.ndarray]:
    """Means (count, n) and covariances (count, n, n) of mixtures, by their first two moments.

    Args:
        mean: (k, n) of the members.
        cov: (k, n, n).
        weight: (k,), which sum to 1 in each group.
        group: (k,) below `count`; every group has a member.
        count: number of groups.
        angular: which components are angles: their mean is taken about the heaviest member's.
    """
    heaviest = np.empty(count, int)
    order = np.argsort(weight, kind="stable")
    heaviest[group[order]] = order
    about = mean[heaviest]
    d = wrapped(mean - about[group], angular)
    shift = summed(weight[:, None] * d, group, count)
    d = d - shift[group]
    P = summed(weight[:, None, None] * (cov + d[:, :, None] * d[:, None, :]), group, count)
    return wrapped(about + shift, angular), (P + P.swapaxes(1, 2)) / 2


def firsts(rows: np.ndarray) -> np.ndarray:
    """Which rows (k, m) are not the same as one before, NaN being the same as NaN."""
    same = np.nan_to_num(rows, nan=np.inf)
    order = np.lexsort(same.T) if len(rows) else np.empty(0, int)
    repeated = (same[order][1:] == same[order][:-1]).all(1)
    first = np.ones(len(rows), bool)
    # lexsort keeps the order of equals.
    first[order[1:][repeated]] = False
    return first


def summed(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, …) of values (k, …) by group."""
    rest = values.shape[1:]
    flat = values.reshape(len(values), int(np.prod(rest)))
    total = np.stack([np.bincount(group, column, count) for column in flat.T], axis=1)
    return total.reshape(count, *rest)
