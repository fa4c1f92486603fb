"""The numbers in words, by rules that are stated on the page."""

from collections.abc import Sequence
from enum import Enum
from math import ceil, log10, sqrt

from sigmax.reports.score import Score
from sigmax.reports.shares import ratio_bounds

# Real sensors are never exactly what a model says: this factor on the mean NIS is let pass.
_NEAR = 1.5
_EQUAL = 1.01
_LIKELIHOOD = 1.0

RULES = (
    "The NIS of a step weighs the miss of a measurement by the covariance the filter claims for it. "
    "The mean of an honest filter is the number of measured components, within bounds that hold for 95 of 100.",
    f"Within the bounds a filter is consistent; up to a factor of {_NEAR} beside what is expected it is plausible, "
    "which is as much as real sensors allow. Beyond that it is too optimistic, and its covariance cannot be believed, "
    "or too cautious: it can be used, but claims more error than it makes. Where the number of measurements does not "
    "tell (with 99 %) on which side of that factor a filter is, the verdict is not known.",
    "A mean says nothing of single misses. Tails are heavy if more than one step in a thousand surely misses by more "
    "than 4 σ (of a Gaussian: one in 16 000), or if most misses are surely much smaller than the rest: noises that "
    "were raised until the mean fits, over outliers, show so.",
    "The advice is the filter of the smallest position RMSE (without truth: of the largest likelihood) among those "
    "that are consistent or plausible and had no faults, else among those with heavy tails or too much caution; "
    "filters within 1 % of it (a log-likelihood within 1) count as equally good.",
)


class Grade(Enum):
    """How far a filter's own covariance can be believed."""

    CONSISTENT = "consistent"
    NEAR = "plausible"
    HEAVY = "heavy tails"
    CAUTIOUS = "too cautious"
    UNKNOWN = "not known"
    OPTIMISTIC = "too optimistic"
    FAULTY = "broke down"
    FAILED = "failed"

    @property
    def believable(self) -> bool:
        """Whether its covariance is what it says."""
        return self in (Grade.CONSISTENT, Grade.NEAR)

    @property
    def usable(self) -> bool:
        """Whether it can be advised where none is believable: its errors are not larger than it claims."""
        return self in (Grade.HEAVY, Grade.CAUTIOUS)


def grade(score: Score) -> Grade:
    """The grade of a filter by its NIS and its faults."""
    if score.failure:
        return Grade.FAILED
    if score.faults:
        return Grade.FAULTY
    if score.mean_nis is None or score.nis_ratio is None or score.nis_bounds is None:
        return Grade.UNKNOWN
    return _by_ratio(score, *score.nis_ratio)


def _by_ratio(score: Score, low: float, high: float) -> Grade:
    assert score.nis_bounds is not None
    assert score.mean_nis is not None
    if low > _NEAR:
        return Grade.OPTIMISTIC
    if score.heavy:
        return Grade.HEAVY
    if high < 1 / _NEAR:
        return Grade.CAUTIOUS
    if low < 1 / _NEAR or high > _NEAR:
        return Grade.UNKNOWN
    least, most = score.nis_bounds
    return Grade.CONSISTENT if least <= score.mean_nis <= most else Grade.NEAR


def needed(score: Score) -> int | None:
    """How many measured components would tell how far a filter can be believed; None if more than is reasonable."""
    if score.nis_ratio is None or score.mean_nis is None or score.expected_nis is None:
        return None
    ratio = score.mean_nis / score.expected_nis
    for count in (int(k * 10**e) for e in range(1, 6) for k in (1, 1.5, 2, 3, 5, 7)):
        if count > score.components:
            low, high = ratio_bounds(ratio * count, count, 0.005)
            if low > _NEAR or high < 1 / _NEAR or (low >= 1 / _NEAR and high <= _NEAR):
                return count
    return None


def best(scores: Sequence[Score]) -> Score | None:
    """The filter that is advised, None where none can be."""
    good = [s for s in scores if grade(s).believable] or [s for s in scores if grade(s).usable]
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
    sentences = [_sentence(s) for s in scores if s is not chosen and not grade(s).believable]
    if chosen is None:
        return _nobody(scores), sentences
    rmse = chosen.rmse_position_m
    merit = "the largest likelihood" if rmse is None else f"position RMSE {significant(rmse)} m"
    alike = [s for s in scores if (grade(s).believable if grade(chosen).believable else grade(s).usable)]
    whose = "whose covariance can be believed" if grade(chosen).believable else "that can be used"
    though = {Grade.CAUTIOUS: ", though it is too cautious", Grade.HEAVY: ", though its misses have heavy tails"}
    said = though.get(grade(chosen), "")
    if len(scores) == 1:
        headline = f"{chosen.label} can be used{said}" + ("." if rmse is None else f": {merit}.")
    elif len(alike) == 1:
        headline = f"Take {chosen.label}, the only one {whose}{said}" + ("." if rmse is None else f": {merit}.")
    else:
        smallest = "" if rmse is None else ", the smallest"
        headline = f"Take {chosen.label}{said}: {merit}{smallest} of the {len(alike)} {whose}."
    equal = [s.label for s in alike if s is not chosen and _as_good(s, chosen)]
    if equal:
        headline += f" {listed(equal)} {'is' if len(equal) == 1 else 'are'} equally good."
    return headline, [_sentence(chosen), *sentences]


def _nobody(scores: Sequence[Score]) -> str:
    """The headline where no filter is advised."""
    graded = [grade(s) for s in scores]
    if scores and all(g is Grade.UNKNOWN for g in graded) and not any(s.measurements for s in scores):
        return "Nothing was measured, so nothing can be said about any filter."
    if Grade.UNKNOWN in graded:
        unknown = [s for s in scores if grade(s) is Grade.UNKNOWN]
        counts = [n for n in map(needed, unknown) if n is not None]
        more = f"; about {min(counts):,} would tell" if counts else ""
        components = max(s.components for s in unknown)
        least = min(unknown, key=_merit)
        rmse = least.rmse_position_m
        merit = "the largest likelihood" if rmse is None else f"the smallest position RMSE, {significant(rmse)} m,"
        so_far = f" So far {least.label} has {merit} of those that may be believed." if len(scores) > 1 else ""
        few = f"{components:,} measured components are too few to say whether a covariance can be believed"
        return f"{few}{more}.{so_far}"
    only = f"{scores[0].label} cannot" if len(scores) == 1 else "None of these filters can"
    return f"{only} be believed: the model, or its noises, need work."


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
    return " ".join([_of_the_mean(score, graded, seen), *_of_single_misses(score)])


def _of_the_mean(score: Score, graded: Grade, seen: str) -> str:
    factor = sqrt((score.mean_nis or 0.0) / (score.expected_nis or 1.0))
    if graded is Grade.CONSISTENT:
        return f"{seen}, within its bounds: its covariance can be believed."
    if graded is Grade.NEAR:
        side = "small" if factor > 1 else "large"
        return f"{seen}: close. The standard deviations it claims are about {abs(1 - factor) * 100:.0f} % too {side}."
    if graded is Grade.HEAVY:
        return (
            f"{seen}, but its misses have heavy tails: most are smaller than it claims, a few much larger. Noises that "
            "were fitted over outliers show so; gate or down-weight outliers, and fit the noises to the rest."
        )
    if graded is Grade.CAUTIOUS:
        return (
            f"{seen}: too cautious. Measurements miss by {significant(factor)} times what it claims; "
            "lower R, or Q, which are larger than the data show. It can be used: it errs on the safe side."
        )
    if graded is Grade.UNKNOWN:
        more = needed(score)
        told = f"; about {more:,} would tell" if more is not None else ""
        return f"{seen}: {score.components:,} measured components are too few for a verdict{told}."
    error = (
        ""
        if score.rmse_position_m is None
        else f" Its position is off by {significant(score.rmse_position_m)} m (RMSE)."
    )
    return (
        f"{seen}: this filter's covariance cannot be believed; its model lacks something. "
        f"Measurements miss by {significant(factor)} times what it claims.{error}"
    )


def _of_single_misses(score: Score) -> list[str]:
    """What the distribution of the misses adds to their mean."""
    said = []
    if grade(score) is Grade.HEAVY:
        kurtosis = "" if score.kurtosis is None else f" (kurtosis {significant(score.kurtosis)}, of a Gaussian 3)"
        steps = f"{score.beyond:,} of {score.measurements:,} steps miss by more than 4 σ"
        said.append(f"{steps}{kurtosis}.")
    above = score.nis_bounds is not None and (score.mean_nis or 0.0) > score.nis_bounds[1]
    if score.stretches is not None and above:
        said.append(
            f"Large misses come one after another (correlation {significant(score.stretches, 2)}): something that "
            "lasts is not in the model, such as an offset."
        )
    return said


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
