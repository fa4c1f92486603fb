"""Where each filter of a study stands."""

from bisect import bisect_left
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from sigmax.reports.comparison.judgement import Honesty, Judged, judged, loses
from sigmax.studies import Comparison, Measures
from sigmax.studies.measures import distance

# Beyond this ratio errors are told as "over 1000 times", and have no place in pictures.
FAR = 1000.0
# Runs are asked for in round numbers up to what is reasonable, with something to spare.
_ROUND_NUMBERS = [int(k * 10**e) for e in range(2, 6) for k in (1, 1.5, 2, 3, 4, 5, 7)]
_SPARE = 1.3
# So many runs of all steps together calm what was seen at one step.
_CALM = 32


class Word(Enum):
    """What is said of a filter in one word; the better ones first."""

    SOUND = "sound"
    NOT_JUDGED = "not judged"
    CAUTIOUS = "too cautious"
    UNKNOWN = "not known"
    OPTIMISTIC = "too optimistic"
    LOSSY = "loses runs"
    FAILED = "could not be run"

    @property
    def usable(self) -> bool:
        """Whether such a filter can be advised."""
        return self in (Word.SOUND, Word.NOT_JUDGED, Word.CAUTIOUS)


class Standing(NamedTuple):
    """How a filter compares.

    Attributes:
        name: of the filter.
        word: the verdict.
        failure: why it could not be run, empty where it could.
        distance: mean ratio of its RMSE to the reference's, None where it could not be run.
        middle: the same of the median errors.
        lost: how many runs are lost.
        lossy: whether those are too many, None where that is not known.
        honest: what is known of its errors, None where that is not asked.
        needed: how many runs would tell, where the verdict is not known; None where no reasonable number would.
        then: what they would tell if they gave the same shares.
        cost: relative to the EKF, None where it was not measured.
        typical: NEES per degree of freedom of the run in the middle.
        outside: how often the truth is outside of the claimed 95 % region, of the state as a whole or of the component
            for which that is worst; None where it is not asked, or says nothing because most runs are lost.
    """

    name: str
    word: Word
    failure: str = ""
    distance: float | None = None
    middle: float | None = None
    lost: int = 0
    lossy: bool | None = False
    honest: Judged | None = None
    needed: int | None = None
    then: Word | None = None
    cost: float | None = None
    typical: float = float("nan")
    outside: float | None = None


def standings(c: Comparison) -> list[Standing]:
    """Every filter of a study, in its order."""
    names = list(c.measures)
    lost = np.array([c.sums[name].lost.sum() for name in names])
    runs = int(c.sums[names[0]].runs) if names else 0
    lossy = loses(lost, runs)
    distances, middles = (_distances(c, of) for of in (_rmse, _median))
    found = []
    for name in c.filters:
        if name not in c.measures:
            found.append(Standing(name, Word.FAILED, c.failures.get(name, "every run escaped")))
            continue
        k = names.index(name)
        honest = (
            None if c.study.unasked else judged(c.sums[name].outside, float(c.sums[name].far), runs, _degrees(c, name))
        )
        word = _word(lossy[k], honest)
        needed, then = _needed(c, k, lost, runs) if word is Word.UNKNOWN else (None, None)
        found.append(
            Standing(
                name,
                word,
                distance=distances[name],
                middle=middles[name],
                lost=int(lost[k]),
                lossy=lossy[k],
                honest=honest,
                needed=needed,
                then=then,
                cost=float(c.costs[name].relative[2]) if name in c.costs else None,
                typical=c.measures[name].typical,
                outside=None if honest is None or 2 * lost[k] > runs else honest.outside,
            )
        )
    return found


def _needed(c: Comparison, k: int, lost: np.ndarray, runs: int) -> tuple[int | None, Word | None]:
    """How many runs would tell of the k-th filter, and what, at the same shares; None beyond what is usual."""
    name = list(c.measures)[k]
    outside, far, degrees = c.sums[name].outside, float(c.sums[name].far), _degrees(c, name)
    # A share at one step is known less well than that over all of them.
    calm = (outside + _CALM * outside.mean(1, keepdims=True) / runs) / (runs + _CALM)

    def word(count: float) -> Word:
        lossy = loses(lost * count / runs, count)[k]
        honest = None if c.study.unasked else judged(calm * count, far * count / runs, count, degrees)
        return _word(lossy, honest)

    asked = [n for n in _ROUND_NUMBERS if n > runs]
    first = bisect_left(asked, True, key=lambda n: word(n / _SPARE) is not Word.UNKNOWN)
    return (asked[first], word(asked[first] / _SPARE)) if first < len(asked) else (None, None)


def _degrees(c: Comparison, name: str) -> np.ndarray:
    """The degrees of freedom of what is claimed of the whole state and of each component (T, n + 1)."""
    s = c.sums[name]
    whole = np.round(s.known / s.runs)
    return np.concatenate([whole[:, None], np.einsum("tii->ti", s.P) > 0], axis=1)


def _word(lossy: bool | None, honest: Judged | None) -> Word:
    if lossy:
        return Word.LOSSY
    if honest is not None and honest.honesty is Honesty.OPTIMISTIC:
        return Word.OPTIMISTIC
    if lossy is None or (honest is not None and honest.honesty is Honesty.UNKNOWN):
        return Word.UNKNOWN
    return Word.NOT_JUDGED if honest is None else Word(honest.honesty.value)


def _rmse(m: Measures) -> np.ndarray:
    return m.rmse.value


def _median(m: Measures) -> np.ndarray:
    return m.median.value


def _distances(c: Comparison, error: Callable[[Measures], np.ndarray]) -> dict[str, float]:
    """How much larger the errors of each filter are than those of the optimum, or of the best of the filters."""
    if not c.measures:
        return {}
    if c.optimum is not None:
        reference = error(c.optimum.limit)
        return {name: distance(error(m), reference) for name, m in c.optimum.filters.items()}
    errors = {name: error(m) for name, m in c.measures.items()}
    any_of_them = next(iter(errors.values()))
    merit = {name: distance(value, any_of_them) for name, value in errors.items()}
    best = errors[min(merit, key=lambda name: np.inf if np.isnan(merit[name]) else merit[name])]
    return {name: distance(value, best) for name, value in errors.items()}
