"""What a cause is called, how large it is, and what mends it."""

import numpy as np

from sigmax.examination.alternatives import UNITS
from sigmax.examination.search import Candidate
from sigmax.views.words import measured

_NAMES = {c: f"{name}: {a} where {b} are wanted" for c, (name, a, b) in UNITS.items()} | {1e3: "1000", 1e-3: "1/1000"}


def known_factor(log: float, std: float, power: int = 1) -> float:
    """The factor with a name whose power eˡᵒᵍ is, within three standard errors; 0 where it has none for sure."""
    # Of a factor that is known to a tenth only, one of these names would fit by chance.
    near = (c for c in _NAMES if abs(log - power * np.log(c)) < max(3 * std, 1e-3) and std < 0.03)
    return next(near, 0.0)


def recognised(log: float, std: float, power: int = 1) -> str:
    """What a factor eˡᵒᵍ that mends is known by; empty where it has no name for sure."""
    factor = known_factor(log, std, power)
    return f" ({'the square of ' if power == 2 else ''}{_NAMES[factor]})" if factor else ""


def factor_of(c: Candidate) -> float:
    """What values are to be multiplied by, where it has a name or the cause is another reading of them; else 0."""
    if c.alternative is not None:
        return c.alternative.factor
    v = float(c.value[0]) if c.value.size else -1.0
    if v <= -1 or c.kind not in ("scale", "input gain"):
        return 0.0
    return known_factor(-np.log1p(v) if c.kind == "scale" else np.log1p(v), c.std / (1 + v))


def in_words(c: Candidate, variance: float | None) -> tuple[str, str, str]:
    """Cause, size and change in words; `variance` is R of the component where it is one."""
    v = float(c.value[np.argmax(np.abs(c.value))]) if c.value.size else 0.0
    if c.alternative is not None:
        return c.alternative.cause, "", c.alternative.mend
    say = measured(v, c.std if np.isfinite(c.std) else None)
    if c.kind == "bias":
        return f"{c.where} is offset", f"{say} too much", f"subtract {v:.4g} from {c.where}, or estimate it: bias="
    if c.kind == "scale":
        # What mends is its inverse. A factor below 0 is another sign, and has no name beside it.
        known = recognised(-np.log1p(v), c.std / (1 + v)) if v > -1 else ""
        return (
            f"{c.where} is {'too long' if v > 0 else 'too short'} by a factor",
            f"{measured(1 + v, c.std)}{known}",
            f"divide {c.where} by {1 + v:.6g}, or estimate the factor as a state",
        )
    if c.kind in ("R", "Q"):
        return _noise(c, v, variance)
    if c.kind == "linearisation":
        return "the filter's linearisation is too crude for the model", "", f"use the filter {c.where}"
    if c.kind == "motion":
        name = c.where.partition("(")[0].replace("_", " ")
        change = f"motion = sigmax.motions.{c.where}, Q = motion.noise({c.numbers}); and examine again"
        return f"the target moves otherwise: {name}", "", change
    if c.kind == "tails":
        return (
            f"the noise of {c.where} has long tails",
            f"like Student's with {v:.2g} degrees of freedom",
            f'an update that bears them: sigmax.get(name, update=sigmax.robust("student", nu={max(v, 2.5):.2g}))',
        )
    if c.kind == "outliers":
        return (
            f"{c.where} has outliers",
            f"{100 * v:.2g} ± {100 * c.std:.1g} % of the values, {c.times:.0f} times as wide as the others",
            'refuse or weigh them: sigmax.get(name, update="gate") or "student"',
        )
    return _other(c, v, say)


def _noise(c: Candidate, v: float, variance: float | None) -> tuple[str, str, str]:
    known = recognised(v, c.std, 2)
    if c.kind == "R" and variance and abs(v - np.log(variance)) < max(3 * c.std, 0.05) and abs(v) > 0.5:
        known = f" (its own root: {variance:.4g} is the deviation, and R wants the variance {variance**2:.4g})"
    by = np.exp(abs(v))
    if c.std > 1:
        size = f"a factor of about {by:.2g}, which the record does not tell closely"
    else:
        size = f"factor {by:.3g}, within {by * np.exp(-c.std):.3g} to {by * np.exp(c.std):.3g}{known}"
    way = "small" if v > 0 else "large"
    now = f": {variance:.4g} → {variance * np.exp(v):.4g}" if variance and c.kind == "R" else ""
    return f"{c.kind} of {c.where} is too {way}", size, f"multiply it by {np.exp(v):.3g}{now}"


def _other(c: Candidate, v: float, say: str) -> tuple[str, str, str]:
    known = recognised(np.log1p(v), c.std / (1 + v)) if v > -1 else ""
    ahead = "late" if v > 0 else "early"
    table = {
        "drift": (f"{c.where} drifts beyond the motion", f"{say} a second", "add it to the motion, or as a bias"),
        "prior": (
            f"the prior of {c.where} is off" if c.value.size == 1 else "the mean of the prior is off",
            f"{say} of its deviations",
            "move the mean, or start from the measurements: sigmax.start",
        ),
        "rotation": (f"{c.where} are turned against the axes", f"{say} rad", f"turn them back by {-v:.4g} rad"),
        "input rotation": (
            f"{c.where} are turned against the axes of the motion",
            f"{measured(-v, c.std)} rad",
            f"turn them by {v:.4g} rad",
        ),
        "delay": (
            f"{c.where} is {ahead} against the others",
            f"{measured(abs(v), c.std)} s",
            f"correct its times by {-v:.4g} s",
        ),
        "skew": (
            f"the clock of {c.where} runs too {'fast' if v > 0 else 'slowly'} against the others",
            f"{measured(abs(v), c.std)} s a second",
            f"multiply its times, counted from the start, by {1 - v:.7g}",
        ),
        "input offset": (f"{c.where} is offset", f"{measured(-v, c.std)} too much", f"add {v:.4g} to {c.where}"),
        "input gain": (
            f"{c.where} is off by a factor",
            f"times {measured(1 + v, c.std)} fits{known}",
            f"multiply {c.where} by {1 + v:.5g}",
        ),
        "input delay": (
            "the inputs of the motion come at another time than their stamps",
            f"{measured(abs(v), c.std)} s too {'early' if v > 0 else 'late'}",
            f"use u(t − ({v:.4g} s))",
        ),
        "clock": (
            "the motion runs at another pace than dt",
            f"dt times {measured(1 + v, c.std)} fits{known}",
            f"multiply dt by {1 + v:.5g}, or look for a factor of the velocities",
        ),
    }
    return table[c.kind]
