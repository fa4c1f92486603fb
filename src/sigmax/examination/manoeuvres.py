"""Stretches of a record in which the target moves far beyond its Q."""

from dataclasses import replace

import numpy as np

from sigmax.examination.alternatives import Alternative
from sigmax.examination.search import Setup, normalised
from sigmax.examination.variants import Innovations, RecordData

# Q times these, in up to so many windows, each so many rows to both sides of the middle of so long a sum.
_FACTORS, _WINDOWS, _AROUND, _SUM = (30.0, 1000.0), 6, 4, 5


def manoeuvres(setup: Setup, outcome: Innovations, record: RecordData) -> list[Alternative]:
    """Q times a factor around the largest sums of NIS less its expectation, one window to several."""
    r, seen = normalised(outcome, record)
    excess = np.where(seen, r * r - 1, 0.0).sum(1)
    T = len(excess)
    if 2 * setup.burn + _SUM > T:
        return []
    sums = np.convolve(excess, np.ones(_SUM), mode="same")
    sums[: setup.burn + _AROUND] = -np.inf  # where a wrong prior speaks
    middles, found = list[int](), list[Alternative]()
    for _ in range(_WINDOWS):
        k = int(np.argmax(sums))
        if sums[k] <= 0:
            break
        middles.append(k)
        sums[max(0, k - 2 * _AROUND) : k + 2 * _AROUND + 1] = -np.inf
        found += [_with_more(tuple(sorted(middles)), c, T) for c in _FACTORS]
    return found


def _with_more(middles: tuple[int, ...], c: float, T: int) -> Alternative:
    def change(r: RecordData) -> RecordData:
        q = r.q_factor.copy()
        for k in middles:
            q[max(0, k - _AROUND) : k + _AROUND + 1] = c
        return replace(r, q_factor=q)

    rows = ", ".join(str(k) for k in middles)
    return Alternative(
        "manoeuvre",
        f"row{'s' if len(middles) > 1 else ''} {rows}",
        f"the target moves beyond its Q around row{'s' if len(middles) > 1 else ''} {rows}",
        f"Q times {c:g} there fits: a second mode for it (sigmax.imm), or a function of the input that drives it",
        change,
        cost=len(middles) * float(np.log(T)) + 1,
    )
