"""The numbers in words, by rules that are stated on the page."""

from collections.abc import Sequence
from enum import Enum
from math import ceil, log10, sqrt

from sigmax.reports.score import Score

# Real sensors are never exactly what a model says: this factor on the mean NIS is let pass.
_NEAR = 1.5
_EQUAL = 1.01
_LIKELIHOOD = 1.0

RULES = (
    "The NIS of a step weighs the miss of a measurement by the covariance the filter claims for it. "
    "The mean of an honest filter is the number of measured components, within bounds that hold for 95 of 100.",
    f"Within the bounds a filter is consistent; up to a factor of {_NEAR} beside what is expected it is plausible, "
    "which is as much as real sensors allow; beyond that its covariance cannot be believed.",
    "The advice is the filter of the smallest position RMSE (without truth: of the largest likelihood) among those "
    "that are consistent or plausible and had no faults; filters within 1 % of it (a log-likelihood "
    "within 1) count as equally good.",
)


class Grade(Enum):
    """How far a filter's own covariance can be believed."""

    CONSISTENT = "consistent"
    NEAR = "plausible"
    OVERCONFIDENT = "overconfident"
    CAUTIOUS = "too cautious"
    FAULTY = "broke down"
    FAILED = "failed"
    UNKNOWN = "not known"

    @property
    def believable(self) -> bool:
        """Whether it is good enough to be advised."""
        return self in (Grade.CONSISTENT, Grade.NEAR)


def grade(score: Score) -> Grade:
    """The grade of a filter by its NIS and its faults."""
    if score.failure:
        return Grade.FAILED
    if score.faults:
        return Grade.FAULTY
    if score.mean_nis is None or score.expected_nis is None or score.nis_bounds is None:
        return Grade.UNKNOWN
    low, high = score.nis_bounds
    if low <= score.mean_nis <= high:
        return Grade.CONSISTENT
    ratio = score.mean_nis / score.expected_nis
    if 1 / _NEAR <= ratio <= _NEAR:
        return Grade.NEAR
    return Grade.OVERCONFIDENT if ratio > 1 else Grade.CAUTIOUS


def best(scores: Sequence[Score]) -> Score | None:
    """The filter that is advised, None where none can be."""
    good = [s for s in scores if grade(s).believable]
    if not good:
        return None
    least = min(map(_merit, good))
    # Of those that differ by rounding, the first that was asked for.
    return next(s for s in good if _merit(s) <= least + 1e-9 * abs(least))


def _merit(score: Score) -> float:
    if score.rmse_position_m is not None:
        return score.rmse_position_m
    return -(score.log_likelihood or 0.0)


def _as_good(score: Score, chosen: Score) -> bool:
    if chosen.rmse_position_m is None:
        return _merit(score) <= _merit(chosen) + _LIKELIHOOD
    return _merit(score) <= _merit(chosen) * _EQUAL


def verdict(scores: Sequence[Score]) -> tuple[str, list[str]]:
    """A headline, and a sentence for each filter that needs one."""
    chosen = best(scores)
    sentences = [_sentence(s) for s in scores if not grade(s).believable]
    if chosen is None:
        if scores and all(grade(s) is Grade.UNKNOWN for s in scores):
            return "Nothing was measured, so nothing can be said about any filter.", sentences
        only = f"{scores[0].label} cannot" if len(scores) == 1 else "None of these filters can"
        return f"{only} be believed: the model, or its noises, need work.", sentences
    rmse = chosen.rmse_position_m
    merit = "the largest likelihood" if rmse is None else f"position RMSE {significant(rmse)} m"
    believed = [s for s in scores if grade(s).believable]
    if len(scores) == 1:
        headline = f"{chosen.label} can be used" + ("." if rmse is None else f": {merit}.")
    elif len(believed) == 1:
        headline = f"Take {chosen.label}, the only one whose covariance can be believed" + (
            "." if rmse is None else f": {merit}."
        )
    else:
        smallest = "" if rmse is None else ", the smallest"
        headline = f"Take {chosen.label}: {merit}{smallest} of the {len(believed)} whose covariance can be believed."
    equal = [s.label for s in believed if s is not chosen and _as_good(s, chosen)]
    if equal:
        headline += f" {listed(equal)} {'is' if len(equal) == 1 else 'are'} equally good."
    return headline, [_sentence(chosen), *sentences]


def listed(names: Sequence[str]) -> str:
    """Names as a sentence has them."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _sentence(score: Score) -> str:
    graded = grade(score)
    if graded is Grade.FAILED:
        return f"{score.label} could not be run: {score.failure}"
    if graded is Grade.FAULTY:
        steps = "1 step was" if score.faults == 1 else f"{score.faults} steps were"
        return f"{score.label} broke down: {steps} not sound, the first at {score.first_fault}."
    if score.mean_nis is None or score.expected_nis is None:
        return f"{score.label}: no measurement was used, so there is no NIS."
    seen = (
        f"{score.label}: mean NIS {significant(score.mean_nis)} against an expected {significant(score.expected_nis)}"
    )
    factor = sqrt(score.mean_nis / score.expected_nis)
    if graded is Grade.CONSISTENT:
        return f"{seen}, within its bounds: its covariance can be believed."
    if graded is Grade.NEAR:
        side = "small" if factor > 1 else "large"
        return f"{seen}: close. The standard deviations it claims are about {abs(1 - factor) * 100:.0f} % too {side}."
    if graded is Grade.CAUTIOUS:
        return (
            f"{seen}: too cautious. Measurements miss by {significant(factor)} times what it claims; "
            "its noises are larger than the data show."
        )
    error = (
        ""
        if score.rmse_position_m is None
        else f" Its position is off by {significant(score.rmse_position_m)} m (RMSE)."
    )
    return (
        f"{seen}: this filter's covariance cannot be believed; its model lacks something. "
        f"Measurements miss by {significant(factor)} times what it claims.{error}"
    )


def nis_in_words(score: Score) -> tuple[str, str]:
    """Mean NIS, and "expected (low–high)", with as many digits as the bounds need; dashes where there is none."""
    if score.mean_nis is None or score.expected_nis is None or score.nis_bounds is None:
        return "–", "–"
    low, high = score.nis_bounds
    digits = max(3, 1 + ceil(log10(score.expected_nis / (high - low))))
    mean, low_text, high_text = (significant(v, digits) for v in (score.mean_nis, low, high))
    return mean, f"{significant(score.expected_nis)} ({low_text}–{high_text})"


def significant(value: float, digits: int = 3) -> str:
    """A number with a few significant digits, without an exponent where it can be read without."""
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e" in text else text
