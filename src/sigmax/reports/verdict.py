"""The numbers in words, by rules that are stated on the page."""

from collections.abc import Sequence
from math import ceil, log10, sqrt

from sigmax.reports.grade import NEAR, Grade, explains_away, grade, needed
from sigmax.reports.score import Score

_EQUAL = 1.01
_LIKELIHOOD = 1.0

RULES = (
    "The NIS of a step weighs the miss of a measurement by the covariance the filter claims for it. "
    "The mean of an honest filter is the number of measured components, within bounds that hold for 95 of 100.",
    f"Within the bounds a filter is consistent; up to a factor of {NEAR} beside what is expected it is plausible, "
    "which is as much as real sensors allow. Beyond that it is too optimistic, and its covariance cannot be believed, "
    "or too cautious: it can be used, but claims more error than it makes. Where the number of measurements does not "
    "tell (with 99 %) on which side of that factor a filter is, the verdict is not known.",
    "A mean says nothing of single misses. Tails are heavy if more than one step in a thousand surely misses by more "
    "than 4 σ (of a Gaussian: one in 16 000), or if most misses are surely much smaller than the rest: noises that "
    "were raised until the mean fits, over outliers, show so.",
    "Where an update expects tails, as Student's and Huber's do, a miss is judged by that distribution: it counts as a "
    "Gaussian miss that is as rare. Where such a filter's misses come one after another, it is too optimistic whatever "
    "the mean: outliers come singly, and it weighs down what its model lacks.",
    "The advice is the filter of the smallest position RMSE (without truth: of the largest likelihood) among those "
    "that are consistent or plausible and had no faults, else among those with heavy tails or too much caution; "
    "filters within 1 % of it (a log-likelihood within 1) count as equally good.",
)


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


def best_of_heavy_tails(scores: Sequence[Score]) -> Score | None:
    """The best filter with heavy tails that weighs nothing yet, None where one without them is advised."""
    chosen = best(scores)
    if chosen is not None and not chosen.heavy:
        return None
    heavy = [s for s in scores if s.heavy and not s.weighed and not s.failure and not s.faults]
    return min(heavy, key=_merit, default=None)


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
    if scores and all(g is Grade.FAILED for g in graded):
        return f"{scores[0].label} could not be run." if len(scores) == 1 else "None of these filters could be run."
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
    return " ".join([_of_the_mean(score, graded, seen), *_of_single_misses(score), *_of_weights(score)])


def _of_the_mean(score: Score, graded: Grade, seen: str) -> str:
    factor = sqrt((score.mean_nis or 0.0) / (score.expected_nis or 1.0))
    if explains_away(score):
        return (
            f"{seen}, but its misses come one after another (correlation {significant(score.stretches or 0.0, 2)}), as "
            "outliers do not: it weighs down what its model lacks, such as a manoeuvre or an offset. "
            "Its covariance cannot be believed."
        )
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
    if score.stretches is not None and above and not score.weighed:
        said.append(
            f"Large misses come one after another (correlation {significant(score.stretches, 2)}): something that "
            "lasts is not in the model, such as an offset."
        )
    return said


def _of_weights(score: Score) -> list[str]:
    """What a filter that weighs measurements made of them."""
    said = []
    for sensor, w in score.weighed.items():
        of = f"{w.measurements:,} measurements{f' of {sensor}' if sensor else ''}"
        said.append(f"Of {of} it refused {w.refused:,} and took {w.lowered:,} with less than half their weight.")
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
