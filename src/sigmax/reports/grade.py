"""How far a filter's own covariance can be believed, by its NIS and its faults."""

from enum import Enum

from sigmax.reports.score import Score
from sigmax.reports.shares import ratio_bounds

# Real sensors are never exactly what a model says: this factor on the mean NIS is let pass.
NEAR = 1.5


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
    if low > NEAR or explains_away(score):
        return Grade.OPTIMISTIC
    if score.heavy:
        return Grade.HEAVY
    if high < 1 / NEAR:
        return Grade.CAUTIOUS
    if low < 1 / NEAR or high > NEAR:
        return Grade.UNKNOWN
    least, most = score.nis_bounds
    return Grade.CONSISTENT if least <= score.mean_nis <= most else Grade.NEAR


def explains_away(score: Score) -> bool:
    """Whether a filter weighs down what its model lacks: outliers come singly, a manoeuvre or an offset lasts."""
    return bool(score.weighed) and score.stretches is not None


def needed(score: Score) -> int | None:
    """How many measured components would tell how far a filter can be believed; None if more than is reasonable."""
    if score.nis_ratio is None or score.mean_nis is None or score.expected_nis is None:
        return None
    ratio = score.mean_nis / score.expected_nis
    for count in (int(k * 10**e) for e in range(1, 6) for k in (1, 1.5, 2, 3, 5, 7)):
        if count > score.components:
            low, high = ratio_bounds(ratio * count, count, 0.005)
            if low > NEAR or high < 1 / NEAR or (low >= 1 / NEAR and high <= NEAR):
                return count
    return None
