"""Rows, and stretches of rows, in which the target moves far beyond its Q."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sigmax.examination.envelope_runs import Innovations, Variant, log_likelihood
from sigmax.examination.record_data import Alternative, RecordData
from sigmax.examination.search import Setup, normalised

# Q times one of these, the first looked for, at most so many times, in one row or so many rows to both sides of it.
_FACTORS, _MOST, _AROUND = (100.0, 30.0, 1000.0, 10000.0), 6, 4
# It is looked for near so many of the largest sums of NIS less its expectation, each over so many rows, from so many
# rows before: a turn shows in positions after it began.
_PLACES, _SUM, _BEFORE = 12, 5, 12


class _More(NamedTuple):
    """Q times a factor in some rows."""

    rows: range
    factor: float

    def __str__(self) -> str:
        return f"{self.rows[0]}" if len(self.rows) == 1 else f"{self.rows[0]} to {self.rows[-1]}"


def manoeuvres(setup: Setup, theta: np.ndarray, outcome: Innovations, record: RecordData) -> list[Alternative]:
    """The likeliest manoeuvre, the likeliest with another one, and so on as long as each gains enough for its place."""
    T, tried = len(record.dt), _suspected(setup, outcome, record)
    chosen, found = tuple[_More, ...](), list[Alternative]()
    best = float(log_likelihood(outcome)[0])
    while tried and len(chosen) < _MOST:
        _, (*_, where) = _likeliest(setup, theta, record, [(*chosen, one) for one in tried])
        sized = [(*chosen, where._replace(factor=c)) for c in _FACTORS]
        L, some = _likeliest(setup, theta, record, sized)
        if not L - best > np.log(T):
            break
        best, chosen = L, some
        found.append(_alternative(chosen, T))
        tried = [one for one in tried if not set(one.rows) & set(chosen[-1].rows)]
    return found


def _likeliest(
    setup: Setup, theta: np.ndarray, record: RecordData, tries: Sequence[tuple[_More, ...]]
) -> tuple[float, tuple[_More, ...]]:
    L = log_likelihood(setup.runner([Variant(theta, _moving(record, some)) for some in tries]))
    i = int(np.argmax(L))
    return float(L[i]), tries[i]


def _suspected(setup: Setup, outcome: Innovations, record: RecordData) -> list[_More]:
    r, seen = normalised(outcome, record)
    excess = np.where(seen, r * r - 1, 0.0).sum(1)
    T, found = len(excess), list[_More]()
    first = setup.burn + _AROUND  # before it a wrong prior speaks
    if first + _SUM > T:
        return []
    sums = np.convolve(excess, np.ones(_SUM), mode="same")
    sums[:first] = -np.inf
    for _ in range(_PLACES):
        k = int(np.argmax(sums))
        if sums[k] <= 0:
            break
        sums[max(0, k - _SUM) : k + _SUM + 1] = -np.inf
        rows = [range(i, i + 1) for i in range(max(first, k - _BEFORE), min(T, k + _SUM // 2 + 1))]
        rows.append(range(max(first, k - _AROUND), min(T, k + _AROUND + 1)))
        found += [_More(some, _FACTORS[0]) for some in rows]
    return list(dict.fromkeys(found))


def _moving(r: RecordData, some: Sequence[_More]) -> RecordData:
    q = r.q_factor.copy()
    for one in some:
        q[one.rows.start : one.rows.stop] = one.factor
    return replace(r, q_factor=q)


def _alternative(some: tuple[_More, ...], T: int) -> Alternative:
    inside = sorted(some, key=lambda one: one.rows[0])
    rows = f"row{'s' if len(some) > 1 or len(some[0].rows) > 1 else ''} {', '.join(map(str, inside))}"
    factors = " or ".join(f"{c:g}" for c in sorted({one.factor for one in some}))
    return Alternative(
        "manoeuvre",
        rows,
        f"the target moves beyond its Q in {rows}",
        f"Q times {factors} there fits: a second mode for it (sigmax.imm), or a function of the input that drives it",
        lambda r: _moving(r, some),
        cost=len(some) * float(np.log(T)) + 1,
    )
