"""Where each filter stands, and the verdict in words, by rules that are stated on the page."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sigmax.reports.verdict import listed, significant
from sigmax.studies import Comparison, Measures
from sigmax.studies.measures import distance

# Within so much of the most accurate, a filter is as good; the cheapest of those is taken.
_AS_GOOD = 1.05
# Beyond this ratio of real to claimed variance a covariance is not to be believed.
_HONEST = 2.0
# … and for such a part of the time it makes a filter overconfident.
_OFTEN = 0.1
# More lost runs than the filter that loses fewest, by this share and by three standard errors.
_LOST = 0.002

RULES = (
    "Errors are compared as the mean ratio of RMSE over all times and components (geometric, so that units do not "
    "matter): to the optimum where there is one, else to the most accurate filter.",
    f"A filter is lossy if it loses more runs than the filter that loses fewest, by {_LOST:.1%} and by three standard "
    "errors. A run is lost if a step of it failed, if it ends nearer to the mirror image of the truth than to the "
    "truth, or if it ends farther off than four times what a prediction without any measurement would be.",
    f"A filter is overconfident if for more than {_OFTEN:.0%} of the time the real variance of a component is more "
    f"than {_HONEST:g} times the claimed one, by three standard errors.",
    f"Of those that are neither, the ones within {_AS_GOOD - 1:.0%} of the most accurate count as equally good, and "
    "the cheapest of these is taken.",
)


class Standing(NamedTuple):
    """How a filter compares.

    Attributes:
        name: of the filter.
        failure: why it could not be run, empty where it could.
        distance: mean ratio of its errors to the reference's, None where it could not be run.
        lost: share of lost runs, and its standard error.
        lossy: whether it loses too many.
        often: part of the time in which the real variance of a component exceeds the claimed one by too much.
        where: which component.
        overconfident: whether that is too often.
        cost: relative to the EKF, None where it was not measured.
    """

    name: str
    failure: str = ""
    distance: float | None = None
    lost: float = 0.0
    lost_error: float = 0.0
    lossy: bool = False
    often: float = 0.0
    where: str = ""
    overconfident: bool = False
    cost: float | None = None

    @property
    def sound(self) -> bool:
        """Whether it can be advised."""
        return not (self.failure or self.lossy or self.overconfident)


def standings(c: Comparison) -> list[Standing]:
    """Every filter of a study, in its order."""
    if not c.measures:
        return [Standing(name, failure=c.failures.get(name, "every run escaped")) for name in c.filters]
    shares = {name: m.lost["all"] for name, m in c.measures.items()}
    least = min(shares.values(), key=lambda share: float(share.value))
    distances = _distances(c)
    found = []
    for name in c.filters:
        if name not in c.measures:
            found.append(Standing(name, failure=c.failures.get(name, "")))
            continue
        share = shares[name]
        more = float(share.value - least.value)
        error = float(np.hypot(share.error, least.error))
        often, where = _often(c, c.measures[name])
        found.append(
            Standing(
                name,
                "",
                distances[name],
                float(share.value),
                float(share.error),
                more > _LOST and more > 3 * error,
                often,
                where,
                often > _OFTEN,
                float(c.costs[name].relative[2]) if name in c.costs else None,
            )
        )
    return found


def _distances(c: Comparison) -> dict[str, float]:
    if c.optimum is not None:
        reference = c.optimum.check.rmse.value
        return {name: distance(m.rmse.value, reference) for name, m in c.optimum.filters.items()}
    return _to_the_best({name: m.rmse.value for name, m in c.measures.items()})


def _to_the_best(rmse: Mapping[str, np.ndarray]) -> dict[str, float]:
    any_of_them = next(iter(rmse.values()))
    merit = {name: distance(value, any_of_them) for name, value in rmse.items()}
    best = rmse[min(merit, key=lambda name: np.inf if np.isnan(merit[name]) else merit[name])]
    return {name: distance(value, best) for name, value in rmse.items()}


def _often(c: Comparison, m: Measures) -> tuple[float, str]:
    """The part of the time in which a component is claimed too well, and which component."""
    ratio, error = m.ratio
    too_well = (ratio - 3 * np.nan_to_num(error, posinf=0.0) > _HONEST).mean(0)
    worst = int(too_well.argmax())
    return float(too_well[worst]), str(c.study.model.state[worst])


def verdict(c: Comparison) -> tuple[str, list[str]]:
    """A headline, and a sentence for each filter that needs one."""
    found = standings(c)
    sound = [s for s in found if s.sound]
    sentences = [_avoid(s) for s in found if not s.sound]
    if c.optimum is not None:
        sentences.append(_about_the_optimum(c))
    ran = [s for s in found if not s.failure]
    if not ran:
        return "None of these filters could be run.", sentences
    to = "the optimum" if c.optimum is not None else "the most accurate"
    if not sound:
        least = min(ran, key=_merit)
        return (
            f"None of these filters can be trusted here; the errors of {least.name} are {_distance(least)} {to}.",
            sentences,
        )
    best = min(sound, key=_merit)
    good = [s for s in sound if _merit(s) <= _merit(best) * _AS_GOOD]
    taken = min(good, key=lambda s: np.inf if s.cost is None else s.cost)
    cost = "" if taken.cost is None else f" at {significant(taken.cost, 2)} × the EKF's cost"
    headline = f"Take {taken.name}: {_nearness(taken, best, c)}{cost}."
    others = [s.name for s in good if s is not taken]
    if others:
        headline += f" {listed(others)} {'is' if len(others) == 1 else 'are'} as accurate within {_AS_GOOD - 1:.0%}."
    less = [s for s in sound if s not in good]
    sentences = [f"{s.name} is sound but less accurate: {_distance(s)} {to}." for s in less] + sentences
    return headline, sentences


def _merit(s: Standing) -> float:
    return np.inf if s.distance is None or np.isnan(s.distance) else s.distance


def _nearness(taken: Standing, best: Standing, c: Comparison) -> str:
    if c.optimum is not None:
        return f"its errors are {_distance(taken)} the optimum"
    if taken is best and _merit(taken) <= 1.0005:
        return "the most accurate of those that can be believed"
    return f"its errors are {_distance(taken)} the most accurate"


def _distance(s: Standing) -> str:
    if s.distance is None or np.isnan(s.distance):
        return "not comparable to"
    if s.distance >= 1.995:
        return f"{significant(s.distance)} times those of"
    percent = 100 * (s.distance - 1)
    return (
        f"within {max(np.ceil(abs(percent) * 10) / 10, 0.1):.1f} % of" if percent < 9.95 else f"{percent:.0f} % above"
    )


def _avoid(s: Standing) -> str:
    if s.failure:
        return f"{s.name} could not be run: {s.failure}"
    reasons = []
    if s.lossy:
        reasons.append(f"it loses {100 * s.lost:.2g} ± {100 * s.lost_error:.1g} % of the runs")
    if s.overconfident:
        reasons.append(
            f"for {s.often:.0%} of the time the real variance of {s.where} is over {_HONEST:g} times what it claims"
        )
    return f"Avoid {s.name}: {' and '.join(reasons)}."


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
    )
    if better:
        said += f" {listed(better)} did better, so there are too few of them: take no distance to it as proven."
    return said
