"""The search: score tests, re-runs of the best hypotheses, and what they gain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sigmax.examination.alternatives import Alternative
from sigmax.examination.hypotheses import LIMITS, Hypothesis
from sigmax.examination.scores import scores
from sigmax.examination.shape import tails
from sigmax.examination.variants import Innovations, RecordData, Runner, Variant, log_likelihood

# Values farther off than so many robust deviations are left out: in how many rounds, and how large a share at most.
_FAR, _ROUNDS, _MOST = 4.5, 4, 0.3
_FORWARD = 1e-3


@dataclass(frozen=True)
class Candidate:
    """A hypothesis after its re-run.

    Attributes:
        kind: as of the hypothesis.
        where: as of the hypothesis.
        gain: in log-likelihood, less what its parameters cost.
        value: its parameters (d,), empty for a discrete one.
        std: standard error of the first.
        theta: the parameters of the envelope to add (p,).
        alternative: what changes the record instead.
        times: of outliers, how many deviations wide they are.
    """

    kind: str
    where: str
    gain: float
    value: np.ndarray
    std: float
    theta: np.ndarray | None = None
    alternative: Alternative | None = None
    times: float = 0.0


@dataclass(frozen=True)
class Setup:
    """What stays the same through the search.

    Attributes:
        runner: the filter on the envelope.
        hypotheses: directions.
        steps: what is small of each parameter (p,).
        R: variances of the sensors at the prior.
        names: of components, by sensor.
        burn: steps at the start that are never left out, where a wrong prior speaks.
        angular: which components turn, by sensor.
        timed: whether the motion depends on dt.
    """

    runner: Runner
    hypotheses: Sequence[Hypothesis]
    steps: np.ndarray
    R: dict[str, np.ndarray]
    names: dict[str, list[str]]
    burn: int
    angular: dict[str, tuple[bool, ...]]
    timed: bool


def normalised(outcome: Innovations, record: RecordData) -> tuple[np.ndarray, np.ndarray]:
    """Innovations over their deviations (T, M), as if nothing were left out; and which values are there."""
    S = np.concatenate([np.einsum("tii->ti", v[0]) for v in outcome.S.values()], 1)
    nu = np.concatenate([v[0] for v in outcome.nu.values()], 1)
    seen = np.concatenate(list(outcome.seen.values()), 1)
    return nu / np.sqrt(np.maximum(S - record.out * record.huge, 1e-12 * S)), seen


def masked(setup: Setup, theta: np.ndarray, whole: RecordData) -> tuple[RecordData, Innovations]:
    """The record with the values left out that are too far from their predictions, and its run."""
    record, seen_out = whole, setup.runner([Variant(theta, whole)])
    for _ in range(_ROUNDS):
        r, seen = normalised(seen_out, record)
        seen = seen & ~whole.out
        middle = [float(np.median(np.abs(r[on, j]))) if on.sum() > 10 else np.inf for j, on in enumerate(seen.T)]
        far = (np.abs(r) > _FAR * np.maximum(1.0, 1.4826 * np.array(middle))) & seen
        far[: setup.burn] = False
        if far.sum() > _MOST * seen.sum() or (whole.out | far == record.out).all():
            break
        record = replace(whole, out=whole.out | far)
        seen_out = setup.runner([Variant(theta, record)])
    return record, seen_out


def score_at(setup: Setup, theta: np.ndarray, record: RecordData, bases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Score and information along the columns of `bases` (p, q)."""
    steps = _FORWARD * np.array([_shortest(setup.steps, b) for b in bases.T])
    variants = [Variant(theta, record), *(Variant(theta + h * b, record) for h, b in zip(steps, bases.T, strict=True))]
    return scores(setup.runner(variants), steps, setup.angular)


def _shortest(steps: np.ndarray, direction: np.ndarray) -> float:
    on = direction != 0
    return float((steps[on] / np.abs(direction[on])).min())


def discrete(setup: Setup, theta: np.ndarray, record: RecordData, some: Sequence[Alternative]) -> list[Candidate]:
    """What changing the record as a whole gains, nothing left out of it."""
    variants = [Variant(theta, record), *(Variant(theta, a.change(record)) for a in some)]
    out = setup.runner(variants)
    L = log_likelihood(out)
    found = []
    for i, a in enumerate(some, 1):
        gain = L[i] + a.jacobian - L[0] if np.isfinite(L[0]) else 1e9 + min(L[i] + a.jacobian, 1e8) / 1e3
        if not np.isfinite(L[i]) or (a.kind == "time units" and not _plausible(out, i)):
            continue
        found.append(Candidate(a.kind, a.where, float(gain) - 2.0, np.zeros(0), 0.0, alternative=a))
    return found


def _plausible(out: Innovations, i: int) -> bool:
    """Whether the median NIS is about what it should be: a longer dt is also a larger Q."""
    from scipy.special import chdtri

    ratios = []
    for s, nis in out.nis().items():
        d = out.seen[s].sum(-1)
        ratios.append(nis[i][d > 0] / chdtri(d[d > 0], 0.5))
    return bool(0.4 < np.median(np.concatenate(ratios)) < 2.5)


def shapes(setup: Setup, out: Innovations, record: RecordData, whole: RecordData) -> list[Candidate]:
    """Long tails and outliers, component by component."""
    r, seen = normalised(out, record)
    seen, names = seen & ~whole.out, [name for s in record.z for name in setup.names[s]]
    found = []
    for j, name in enumerate(names):
        rows = seen[:, j].copy()
        rows[: setup.burn] = False
        shape = tails(r[rows, j]) if np.isfinite(r[rows, j]).all() else None
        if shape is not None:
            value = np.array([shape.size])
            std = float(np.sqrt(shape.size * (1 - shape.size) / rows.sum())) if shape.kind == "outliers" else np.nan
            found.append(Candidate(shape.kind, name, shape.gain, value, std, times=shape.times))
    return found


def continuous(
    setup: Setup, theta: np.ndarray, record: RecordData, ended: set[tuple[str, str]]
) -> tuple[list[Candidate], np.ndarray]:
    """The best directions by their scores, refined; and the information of all parameters."""
    p, T = len(theta), len(record.dt)
    g, info = score_at(setup, theta, record, np.eye(p))
    chi: list[tuple[float, Hypothesis]] = []
    for h in setup.hypotheses:
        I, slope = h.basis.T @ info @ h.basis, h.basis.T @ g
        if (h.kind, h.where) in ended or np.trace(I) < 1e-8:
            continue
        chi.append((float(slope @ np.linalg.lstsq(I, slope, rcond=1e-10)[0]) - 2 * (I.shape[0] - 1), h))
    chi.sort(key=lambda c: -c[0])
    pick: list[Hypothesis] = []
    for value, h in chi:
        if value > 8 and len(pick) < 9 and sum(other.kind == h.kind for other in pick) < 2:
            pick.append(h)
    found = refine(setup, theta, record, pick, g, info)
    return [replace(c, gain=c.gain - 0.5 * np.log(T) * (len(c.value) - 1)) for c in found], info


def refine(
    setup: Setup,
    theta: np.ndarray,
    record: RecordData,
    some: Sequence[Hypothesis],
    g: np.ndarray,
    info: np.ndarray,
    iterations: int = 6,
) -> list[Candidate]:
    """Gauss–Newton along each hypothesis, all in one batch; steps that do not gain are cut to thirds."""
    if not some:
        return []
    L0 = float(log_likelihood(setup.runner([Variant(theta, record)]))[0])
    value = [np.zeros(h.basis.shape[1]) for h in some]
    L = np.full(len(some), L0)
    slope = [h.basis.T @ g for h in some]
    I = [h.basis.T @ info @ h.basis for h in some]
    active = list(range(len(some)))
    for _ in range(iterations):
        tries = []
        for i in active:
            limit = LIMITS.get(some[i].kind, np.inf)
            s = np.clip(np.linalg.lstsq(I[i], slope[i], rcond=1e-10)[0], -limit, limit)
            tries += [(i, value[i] + s * c) for c in (1.0, 1 / 3, 1 / 9, 1 / 27)]
        variants = [Variant(theta + some[i].basis @ v, record) for i, v in tries]
        now = log_likelihood(setup.runner(variants))
        gained = set()
        for i in active:
            best = max((k for k, (owner, _) in enumerate(tries) if owner == i), key=lambda k: now[k])
            if now[best] > L[i]:
                gained |= {i} if now[best] - L[i] > 0.05 else set()
                value[i], L[i] = tries[best][1], now[best]
        active = [i for i in active if i in gained and some[i].basis.shape[1] == 1]
        if not active:
            break
        for i in active:
            at = theta + some[i].basis @ value[i]
            slope[i], I[i] = score_at(setup, at, record, some[i].basis)
    return [
        Candidate(h.kind, h.where, float(L[i] - L0), value[i], float(1 / np.sqrt(max(I[i][0, 0], 1e-300))),
                  theta=h.basis @ value[i])
        for i, h in enumerate(some)
    ]  # fmt: skip
