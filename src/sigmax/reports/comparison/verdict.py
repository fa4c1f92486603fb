"""The verdict of a study in words, by rules that are stated on the page."""

from collections.abc import Sequence

import numpy as np

from sigmax.reports.comparison.judgement import (
    AGAIN,
    AT_ONCE,
    CAUTIOUS,
    CERTAIN,
    FAR_RUNS,
    LOST,
    LOST_AT_ALL,
    OPTIMISTIC,
    SELDOM,
    Honesty,
    Judged,
)
from sigmax.reports.comparison.standing import FAR, Standing, Word, standings
from sigmax.reports.verdict import listed, significant
from sigmax.studies import Comparison, Measures
from sigmax.studies.measures import distance
from sigmax.studies.sums import FAR_OFF

# Within so much of the most accurate, a filter is as good; the cheapest of those is taken.
_AS_GOOD = 1.05

RULES = (
    "Errors are compared as the mean ratio of RMSE, and of the median error, over all times and components "
    "(geometric, so that units do not matter): to the optimum where there is one, else to the most accurate filter. "
    "A few lost runs can multiply an RMSE; the median does not feel them.",
    f"A filter loses runs if it loses more than {LOST:.0%} and {AGAIN:g} times the share of the filter that loses "
    f"fewest, or more than {LOST_AT_ALL:.0%}. A run is lost if a step of it failed, if it ends nearer to the mirror "
    "image of the truth than to the truth, or if it ends farther off than four times what a prediction without any "
    "measurement would be.",
    "Whether a filter can be believed is asked by counting the runs in which the truth is outside of the region that "
    "the filter claims to hold it with 95 %: of the whole state (its NEES, by the chi-square law) and of each "
    "component. An honest filter is outside in 5 %. A run counts once, however far off it is. The table has it "
    "averaged over time, for the whole state or the component where it is worst.",
    "A filter is too optimistic if the truth is outside as often as if the real variances were over "
    f"{OPTIMISTIC:g} times the claimed ones on average over time, or over {AT_ONCE:g} times at some step; or if more "
    f"than {FAR_RUNS:.0%} of the runs are far off: with a NEES, on average over the run, of over {FAR_OFF:g} times "
    "what is expected.",
    "It is too cautious if the truth is within the claimed 50 % region as often as if the real variances were under "
    f"1/{CAUTIOUS:g} of the claimed ones, and outside of the 95 % region in less than {SELDOM:.1%}. Such a filter can "
    "be used: its errors are smaller than it claims.",
    f"Each of these is said only where the number of runs makes it certain (to {CERTAIN:.2%} for all that is said of "
    "a filter, by exact binomial bounds); otherwise the verdict is not known, and more runs can only settle it.",
    f"Of the sound filters, those within {_AS_GOOD - 1:.0%} of the most accurate count as equally good, and the "
    "cheapest of these is taken.",
)


def verdict(c: Comparison) -> tuple[str, list[str]]:
    """A headline, and a sentence for each filter that needs one."""
    found = standings(c)
    usable = [s for s in found if s.word.usable]
    quiet = (Word.SOUND, Word.NOT_JUDGED, Word.UNKNOWN)
    sentences = [_of_one(s, c) for s in found if s.word not in quiet]
    sentences += _unknown([s for s in found if s.word is Word.UNKNOWN], c)
    if c.study.unasked and c.measures:
        sentences.append(f"Whether covariances can be believed is not judged: {c.study.unasked}.")
    if c.optimum is not None:
        sentences.append(_about_the_optimum(c))
    ran = [s for s in found if not s.failure]
    if not ran:
        return "None of these filters could be run.", sentences
    if not usable:
        return _nothing_to_take(found, c), sentences
    kind = min((s.word for s in usable), key=list(Word).index)
    alike = [s for s in usable if s.word is kind]
    best = min(alike, key=_merit)
    good = [s for s in alike if _merit(s) <= _merit(best) * _AS_GOOD]
    taken = min(good, key=lambda s: np.inf if s.cost is None else s.cost)
    cost = "" if taken.cost is None else f" at {significant(taken.cost, 2)} × the EKF's cost"
    though = ", though it is too cautious" if kind is Word.CAUTIOUS else ""
    headline = f"Take {taken.name}: {_nearness(taken, best, c)}{cost}{though}."
    others = [s.name for s in good if s is not taken]
    if others:
        headline += f" {listed(others)} {'is' if len(others) == 1 else 'are'} as accurate within {_AS_GOOD - 1:.0%}."
    adjective = "is" if kind is Word.NOT_JUDGED else f"is {kind.value} but"
    less = [f"{s.name} {adjective} less accurate: {_distance(s)} {_reference(c)}." for s in alike if s not in good]
    return headline, less + sentences


def _nothing_to_take(found: Sequence[Standing], c: Comparison) -> str:
    open_ones = [s for s in found if s.word is Word.UNKNOWN]
    best = min(open_ones or [s for s in found if not s.failure], key=_merit)
    far = "" if c.optimum is None and _merit(best) <= 1.0005 else f", {_distance(best)} {_reference(c)}"
    if not open_ones:
        return f"None of these filters can be trusted here; the errors of {best.name} are the smallest{far}."
    runs = int(next(iter(c.sums.values())).runs)
    return (
        f"{runs:,} runs are too few for a verdict{_ask(open_ones)}. So far the errors of {best.name} are the smallest "
        f"of those that may be sound{far}."
    )


def _ask(open_ones: Sequence[Standing]) -> str:
    """How many runs would give an advice, or would tell that there is none."""
    usable = [s.needed for s in open_ones if s.needed is not None and s.then is not None and s.then.usable]
    if usable:
        return f": about {min(usable):,} would tell (--runs {min(usable)})"
    needed = [s.needed for s in open_ones if s.needed is not None]
    if len(needed) < len(open_ones):
        return ""
    return f": about {max(needed):,} would tell, but at these shares no filter turns out sound (--runs {max(needed)})"


def _reference(c: Comparison) -> str:
    return "the optimum" if c.optimum is not None else "the most accurate"


def _merit(s: Standing) -> float:
    return np.inf if s.distance is None or np.isnan(s.distance) else s.distance


def _nearness(taken: Standing, best: Standing, c: Comparison) -> str:
    if c.optimum is not None:
        return f"its errors are {_distance(taken)} the optimum"
    if taken is best and _merit(taken) <= 1.0005:
        return "the most accurate of all" if c.study.unasked else "the most accurate of those that can be believed"
    return f"its errors are {_distance(taken)} the most accurate"


def times(ratio: float | None) -> str:
    """A ratio of errors for tables: one without bounds does not widen a column."""
    if ratio is None or np.isnan(ratio):
        return "–"
    return f"> {FAR:.0f}" if ratio > FAR else significant(ratio, 4)


def _distance(s: Standing) -> str:
    if s.distance is None or np.isnan(s.distance):
        return "not comparable to"
    if s.distance > FAR:
        return f"over {FAR:.0f} times those of"
    if s.distance >= 1.995:
        return f"{significant(s.distance)} times those of"
    percent = 100 * (s.distance - 1)
    return (
        f"within {max(np.ceil(abs(percent) * 10) / 10, 0.1):.1f} % of" if percent < 9.95 else f"{percent:.0f} % above"
    )


def _unknown(found: Sequence[Standing], c: Comparison) -> list[str]:
    """Sentences on what is not known, one for all filters of which so many runs would tell."""
    said = []
    for needed in dict.fromkeys(s.needed for s in found):
        alike = [s for s in found if s.needed == needed]
        names, runs = listed([s.name for s in alike]), int(c.sums[alike[0].name].runs)
        honest = any(s.honest is not None and s.honest.honesty is Honesty.UNKNOWN for s in alike)
        question = "can be believed" if honest else "loses too many runs" if len(alike) == 1 else "lose too many runs"
        more = "this is too near a limit" if needed is None else f"about {needed:,} would tell"
        subject = "it" if len(alike) == 1 else "they"
        said.append(f"{names}: whether {subject} {question} is not known from {runs:,} runs; {more}.")
    return said


def _of_one(s: Standing, c: Comparison) -> str:
    if s.word is Word.FAILED:
        return f"{s.name} could not be run: {s.failure}"
    reasons = []
    if s.lossy:
        reasons.append(f"it loses {s.lost:,} of {int(c.sums[s.name].runs):,} runs")
    if s.honest is not None and s.honest.honesty is Honesty.OPTIMISTIC:
        reasons.append(_too_optimistic(s, s.honest, c))
    if reasons:
        return f"Avoid {s.name}: {' and '.join(reasons)}."
    assert s.honest is not None
    return (
        f"{s.name} is too cautious: its errors in {facet(s.honest.facet or 0, c)} are smaller than it claims, in "
        f"variance by more than a factor of {CAUTIOUS:g}. Lower Q or R where they are guesses, or take another rule."
    )


def _too_optimistic(s: Standing, honest: Judged, c: Comparison) -> str:
    if honest.facet is None:
        return f"{honest.share:.0%} of its runs are far off: with a NEES of over {FAR_OFF:g} times what is expected"
    when = "" if honest.step is None else f" at {significant(float(c.study.time[honest.step]))} s"
    return (
        f"the truth is outside of the 95 % region that it claims for {facet(honest.facet, c)} in {honest.share:.0%} "
        f"of the cases{when}"
    )


def facet(k: int, c: Comparison) -> str:
    """The whole state for 0, the k-th component for k."""
    names = [str(name) for name in c.study.model.deviations]
    return names[0] if len(names) == 1 else names[k - 1] if k else "the whole state"


def _of_the_optimums_claim(m: Measures) -> str:
    """G / G~ of the optimum, which is 1 (Stepanov et al., (44)), at the step where it is farthest from it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.abs(m.ratio.value - 1) / m.ratio.error
    if not np.isfinite(away).any():
        return ""
    k, i = np.unravel_index(np.nanargmax(np.where(np.isfinite(away), away, np.nan)), away.shape)
    at = [significant(float(of[k, i]), digits) for of, digits in ((m.ratio.value, 3), (m.ratio.error, 2))]
    return (
        f" Its real variances are {significant(float(np.nanmean(m.ratio.value)), 3)} of the claimed on average, where "
        f"1 is the truth of an optimum; farthest from it at step {k + 1}: {at[0]} ± {at[1]}."
    )


def _about_the_optimum(c: Comparison) -> str:
    assert c.optimum is not None
    o = c.optimum
    kind = "members of a bank of filters" if c.study.optimum == "bank" else "particles"
    moved = distance(o.measures.rmse.value, o.check.rmse.value)
    better = [
        name for name, m in o.filters.items() if distance(m.rmse.value, o.check.rmse.value) < min(0.98, 1 / moved)
    ]
    said = (
        f"The optimum is that of {2 * o.particles} {kind} over {o.check.runs} runs; with half as many its errors "
        + ("are the same to 0.5 %." if abs(moved - 1) < 0.005 else f"are {significant(moved)} times as large.")
        + _of_the_optimums_claim(o.limit)
    )
    short = 1 - distance(np.sqrt(_variances(o.check)), np.sqrt(_variances(o.limit))) ** 2
    if abs(short) >= 0.005:
        side = "small" if short > 0 else "large"
        said += (
            f" With finitely many the variance that it claims is {abs(short):.1%} too {side}; such errors, of order "
            "1/N, are extrapolated away."
        )
    if better:
        said += f" {listed(better)} did better, so there are too few of them: take no distance to it as proven."
    return said


def _variances(m: Measures) -> np.ndarray:
    return np.einsum("tii->ti", m.claimed)
