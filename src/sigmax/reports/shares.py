"""What a count, and a sum of squares, tells of what lies behind it: bounds that are exact for any number."""

import numpy as np
from scipy.special import betaincinv, chdtr, chdtri


def share_bounds(count: np.ndarray, runs: float, miss: float) -> tuple[np.ndarray, np.ndarray]:
    """Between what the probability lies of something that was seen in `count` of `runs` (Clopper and Pearson 1934).

    Args:
        count: of any shape, whole or not.
        runs: how many.
        miss: the probability, of each bound, that the truth is beyond it.
    """
    k = np.asarray(count, float)
    low = np.where(k > 0, betaincinv(np.maximum(k, 1e-9), runs - k + 1, miss), 0.0)
    high = np.where(k < runs, betaincinv(k + 1, np.maximum(runs - k, 1e-9), 1 - miss), 1.0)
    return low, high


def outside_if(ratio: float, level: float, degrees: np.ndarray) -> np.ndarray:
    """The probability to be outside of a claimed region where real variances are `ratio` times the claimed ones."""
    d = np.maximum(degrees, 1)
    return np.asarray(1 - chdtr(d, chdtri(d, 1 - level) / ratio))


def ratio_bounds(squares: float, degrees: float, miss: float) -> tuple[float, float]:
    """Between what the real variance lies in units of the claimed one.

    Args:
        squares: the sum of squared misses in those units.
        degrees: how many there were.
        miss: the probability, of each bound, that the truth is beyond it.
    """
    return squares / float(chdtri(degrees, miss)), squares / float(chdtri(degrees, 1 - miss))
