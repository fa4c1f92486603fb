"""After the rounds: all causes sized together, what is not needed any more, and what remains."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sigmax.examination.envelope_runs import Innovations, Variant
from sigmax.examination.gauss_newton import Start
from sigmax.examination.record_data import RecordData
from sigmax.examination.report import Evidence, Finding
from sigmax.examination.search import Candidate, Setup, nis_per_value, normalised

# Four times the R widens what is told by more than this; what is not told is at the end about as wide as at the start.
_SAME, _AS_WIDE = 1.01, 0.9
# Correlation is looked for up to so many values back, and is one from so many deviations and such a size on.
_LAGS, _SURE, _LEAST = 12, 5.0, 0.1


class Fit(NamedTuple):
    """Causes sized together, where that puts the model and the record, and the log-likelihood there."""

    causes: tuple[Candidate, ...]
    theta: np.ndarray
    record: RecordData
    L: float


def fitted(setup: Setup, several: Sequence[Sequence[Candidate]], start: RecordData, out: np.ndarray) -> list[Fit]:
    """Each of several lists of causes, the parameters of each fitted together, from where they stand.

    Args:
        setup: of the examination.
        several: the lists.
        start: the record before any of the causes.
        out: values left out (T, M).
    """
    starts, owed = list[Start](), list[float]()
    for causes in several:
        record, theta, bases = start, np.zeros(len(setup.climber.steps)), [np.zeros((len(setup.climber.steps), 0))]
        for c in causes:
            record = record if c.alternative is None else c.alternative.change(record)
            theta = theta if c.basis is None else theta + c.basis @ c.value
            bases += [] if c.basis is None else [c.basis]
        limits = np.concatenate([np.zeros(0), *(c.limits for c in causes if c.basis is not None)])
        starts.append(Start(theta, np.concatenate(bases, 1), limits, replace(record, out=out)))
        owed.append(sum(c.alternative.jacobian for c in causes if c.alternative is not None))
    found = []
    for causes, begun, more, (value, there) in zip(several, starts, owed, setup.climber.climb(starts), strict=True):
        deviations, at, sized = there.deviations(), 0, list[Candidate]()
        for c in causes:
            if c.basis is not None:
                own = slice(at, at + len(c.value))
                c, at = c.moved(c.value + value[own], deviations[own]), own.stop
            sized.append(c)
        found.append(Fit(tuple(sized), begun.theta + begun.basis @ value, begun.record, there.L + more))
    return found


def needed(setup: Setup, accepted: Sequence[Candidate], start: RecordData, out: np.ndarray, limit: float) -> Fit:
    """The causes without each of which the record is less likely, all others fitted again; sized together.

    What only explained another one's debris goes, the least needed first.
    """
    (whole,) = fitted(setup, [accepted], start, out)
    while len(whole.causes) > 1:
        rest = [
            tuple(other for other in whole.causes if other is not c)
            for c in whole.causes
            if c.basis is not None or c.alternative is not None
        ]
        best = max(fitted(setup, rest, start, out), key=lambda fit: fit.L, default=whole)
        if best is whole or limit < whole.L - best.L:
            break
        whole = best
    return whole


def correlated(setup: Setup, outcome: Innovations, record: RecordData, provisional: bool) -> list[Finding]:
    """Whether what remains of a component goes on to later values, which nothing examined explains."""
    r, seen = normalised(outcome, record)
    found = []
    for j, name in enumerate(name for some in setup.names.values() for name in some):
        e = np.clip(r[seen[:, j] & ~record.out[:, j], j], -4, 4)[setup.burn :]
        if len(e) < 50:
            continue
        power = float((e * e).mean())
        rho = np.array([(e[lag:] * e[:-lag]).mean() / power for lag in range(1, _LAGS + 1)])
        lag = int(np.argmax(np.abs(rho[:1] if abs(rho[0]) * np.sqrt(len(e)) > _SURE else rho)))
        one, z = float(rho[lag]), float(rho[lag] * np.sqrt(len(e)))
        if abs(z) > _SURE and abs(one) > _LEAST:
            nis = nis_per_value(outcome, record)
            to = "from one value to the next" if lag == 0 else f"with the value {lag + 1} before"
            cause = f"what remains of {name} is correlated {to}"
            change = "nothing examined explains it: noise correlated in time, or a motion that lacks a state"
            said = (cause, f"{one:.2f} ± {1 / np.sqrt(len(e)):.2f}", change)
            gain = z * z / 2
            found.append(
                Finding("correlated", name, *said, one, 1 / np.sqrt(len(e)), gain, nis, nis, provisional=provisional)
            )
    return sorted(found, key=lambda f: -f.gain)[:1]


def unobserved(setup: Setup, theta: np.ndarray, record: RecordData) -> tuple[str, ...]:
    """Directions of the state of which the record tells nothing, in components.

    There the covariance P at the end is that of the prior or wider, and what it is with R four times as large, P': of
    the generalised eigenproblem P' v = λ P v those with λ = 1, which are the directions P v of the state.
    """
    from scipy.linalg import eigh

    kinds = [p.kind for p in setup.runner.family.parameters]
    less = theta + np.log(4) * np.array([kind == "R" for kind in kinds])
    ends = setup.runner.estimates([Variant(theta, record), Variant(less, record)])[1][:, -1]
    spread = np.sqrt(np.diag(record.cov))
    on = np.flatnonzero((spread > 0) & (np.diag(ends[0]) > 0))
    if not len(on) or not np.isfinite(ends).all():
        return ()
    P, wide, begun = (m[np.ix_(on, on)] / np.outer(spread[on], spread[on]) for m in (*ends, record.cov))
    try:
        ratio, v = eigh(wide, P)
    except np.linalg.LinAlgError:
        return ()
    names, found = [str(setup.runner.family.plain.deviations[i]) for i in on], list[str]()
    for k in np.flatnonzero(ratio < _SAME):
        if v[:, k] @ P @ v[:, k] < _AS_WIDE * (v[:, k] @ begun @ v[:, k]):
            continue
        d = P @ v[:, k]
        d /= d[np.argmax(np.abs(d))]
        parts = [f"{'−' if x < 0 else '+'} {names[i]}" for i, x in enumerate(d) if abs(x) > 0.2]
        found.append(" ".join(parts).removeprefix("+ "))
    return tuple(f"the state along {one}: no surer at the end than the prior" for one in found)


def evidence(
    setup: Setup, where: str, outcomes: tuple[Innovations, Innovations], records: tuple[RecordData, RecordData]
) -> Evidence:
    """The innovations before and after, of the component of a cause or else the one that changed most."""
    names = [name for some in setup.names.values() for name in some]
    (before, seen), (after, _) = (normalised(o, r) for o, r in zip(outcomes, records, strict=True))
    out = records[1].out
    used = seen & ~out
    change = [float(np.mean((before[k, j] - after[k, j]) ** 2)) if k.any() else 0.0 for j, k in enumerate(used.T)]
    j = names.index(where) if where in names else int(np.argmax(change))
    nis = tuple(sum(v[0] for v in o.nis().values()) for o in outcomes)
    residual = tuple(np.where(seen[:, j], r[:, j], np.nan) for r in (before, after))
    return Evidence((nis[0], nis[1]), used.sum(1), names[j], (residual[0], residual[1]), out[:, j] & seen[:, j])
