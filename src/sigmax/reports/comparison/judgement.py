"""Whether a filter errs as it claims and how many runs it loses: yes, no, or not known with so few runs."""

from enum import Enum
from math import e as EULER
from typing import NamedTuple

import numpy as np

from sigmax.reports.shares import outside_if, share_bounds
from sigmax.studies.claims import LEVELS

# All assertions on one filter in one study are right together with this probability, for any number of runs.
CERTAIN = 0.9999
# Real over claimed variance from which on a filter is too optimistic: over the whole time, and at any single step.
OPTIMISTIC, AT_ONCE = 2.0, 3.0
# Share of the runs that may be far off.
FAR_RUNS = 0.1
# Claimed over real variance from which on a filter is too cautious, if besides the truth is outside of the claimed
# 95 % region less often than this: errors with long tails are not small.
CAUTIOUS, SELDOM = 2.0, 0.025
# A filter loses too many runs if it loses this share, and so many times the share of the filter that loses fewest; and
# if it loses this share whatever the others do.
LOST, AGAIN, LOST_AT_ALL = 0.03, 1.5, 0.5


class Honesty(Enum):
    """Whether errors are what a filter claims."""

    SOUND = "sound"
    OPTIMISTIC = "too optimistic"
    CAUTIOUS = "too cautious"
    UNKNOWN = "not known"


class Judged(NamedTuple):
    """What is known of the errors of a filter.

    Attributes:
        honesty: the judgement.
        facet: what it is about: 0 the whole state, k the k-th component, None the runs that are far off.
        step: the step at which it is too optimistic, None where that is so on average over time.
        share: how often the truth is outside of the claimed 95 % region there; or the share of runs far off.
        limit: how often it may be.
        worst: the facet for which the truth is outside most often on average, in comparison with how often it may be.
        outside: how often that is.
        far: share of runs far off.
    """

    honesty: Honesty
    facet: int | None
    step: int | None
    share: float
    limit: float
    worst: int
    outside: float
    far: float


def judged(outside: np.ndarray, far: float, runs: float, degrees: np.ndarray) -> Judged:
    """Whether a filter errs as it claims.

    Every bound is exact for the number of runs at hand: at a step, and as a whole, runs are independent; an average
    over time is that of independent numbers between 0 and 1, one of each run, for which the binomial bound holds with
    e times the probability to miss (Bentkus 2004, Theorem 1.2).

    Args:
        outside: runs with the truth outside of the claimed region of each of `LEVELS` (2, T, n + 1).
        far: runs that are far off, see `sums.FAR_OFF`.
        runs: how many there were.
        degrees: of freedom of each region (T, n + 1), 0 where nothing is claimed but to be exact.
    """
    T, facets = outside.shape[1:]
    miss = (1 - CERTAIN) / 3
    low, high = share_bounds(outside.mean(1), runs, miss / (4 * facets) / EULER)
    low_at, high_at = share_bounds(outside[1], runs, miss / (2 * facets * T))
    low_far, high_far = share_bounds(np.array(far), runs, miss / 2)
    inner, outer = LEVELS
    often, once = outside_if(OPTIMISTIC, outer, degrees).mean(0), outside_if(AT_ONCE, outer, degrees)
    claimed = (degrees > 0).all(0)
    seldom = np.where(claimed, outside_if(1 / CAUTIOUS, inner, degrees).mean(0), 0.0)
    share, share_at = outside[1].mean(0) / runs, outside[1] / runs

    worst = int((share / often).argmax())

    def because(honesty: Honesty, facet: int | None, step: int | None, seen: float, limit: float) -> Judged:
        return Judged(honesty, facet, step, float(seen), float(limit), worst, float(share[worst]), far / runs)

    def about(honesty: Honesty, facet: int) -> Judged:
        return because(honesty, facet, None, share[facet], often[facet])

    if (low[1] > often).any():
        return about(Honesty.OPTIMISTIC, int(np.where(low[1] > often, share / often, -1.0).argmax()))
    if low_far > FAR_RUNS:
        return because(Honesty.OPTIMISTIC, None, None, far / runs, FAR_RUNS)
    if (low_at > once).any():
        step, facet = divmod(int(np.where(low_at > once, share_at / once, -1.0).argmax()), facets)
        return because(Honesty.OPTIMISTIC, facet, step, share_at[step, facet], once[step, facet])
    if not ((high[1] <= often).all() and (high_at <= once).all() and high_far <= FAR_RUNS):
        return about(Honesty.UNKNOWN, worst)
    cautious = claimed & (high[0] < seldom) & (high[1] < SELDOM)
    if cautious.any():
        return about(Honesty.CAUTIOUS, int(np.where(cautious, outside[0].mean(0), np.inf).argmin()))
    brave = (low[0] >= seldom) | (low[1] >= SELDOM)
    return about(Honesty.SOUND if brave.all() else Honesty.UNKNOWN, worst)


def loses(lost: np.ndarray, runs: float) -> list[bool | None]:
    """Whether each filter loses too many runs, None where that is not known with so few.

    Args:
        lost: how many each of them lost.
        runs: of how many.
    """
    if not len(lost):
        return []
    low, high = share_bounds(lost, runs, (1 - CERTAIN) / (2 * len(lost)))
    too_many = (low > LOST + AGAIN * high.min()) | (low > LOST_AT_ALL)
    few = (high <= LOST + AGAIN * low.min()) & (high <= LOST_AT_ALL)
    return [True if bad else False if good else None for bad, good in zip(too_many, few, strict=True)]
