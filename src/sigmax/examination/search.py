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
# So many readings of the record as a whole are looked at closely.
_READINGS = 8


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


def normalised(outcome: Innovations, record: RecordData, i: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Innovations of variant i over their deviations (T, M), as if nothing were left out; which values are there."""
    S = np.concatenate([np.einsum("tii->ti", v[i]) for v in outcome.S.values()], 1)
    nu = np.concatenate([v[i] for v in outcome.nu.values()], 1)
    seen = np.concatenate(list(outcome.seen.values()), 1)
    return nu / np.sqrt(np.maximum(S - record.out * record.huge, 1e-12 * S)), seen


def masked(setup: Setup, variants: Sequence[Variant]) -> tuple[list[RecordData], Innovations]:
    """The records with the values left out that are too far from their predictions, and their runs.

    A value that is left out has a Gaussian of variance `huge`: the likelihood of such a run is that of a record with
    outliers, of which each costs as much however far it is.
    """
    records, out = [v.record for v in variants], setup.runner(variants)
    active = list(range(len(variants)))
    for _ in range(_ROUNDS):
        found = {i: _far(setup, out, records[i], variants[i].record, i) for i in active}
        masks = {i: mask for i, mask in found.items() if mask is not None}
        if not masks:
            break
        active = list(masks)
        records = [replace(r, out=masks[i]) if i in masks else r for i, r in enumerate(records)]
        out = setup.runner([v._replace(record=r) for v, r in zip(variants, records, strict=True)])
    return records, out


def _far(setup: Setup, out: Innovations, record: RecordData, whole: RecordData, i: int) -> np.ndarray | None:
    """What is to be left out of a record (T, M); None where that is settled, or would be too much."""
    r, seen = normalised(out, record, i)
    seen = seen & ~whole.out
    middle = [float(np.median(np.abs(r[on, j]))) if on.sum() > 10 else np.inf for j, on in enumerate(seen.T)]
    far = (np.abs(r) > _FAR * np.maximum(1.0, 1.4826 * np.array(middle))) & seen
    far[: setup.burn] = False
    settled = far.sum() > _MOST * seen.sum() or (whole.out | far == record.out).all()
    return None if settled else np.asarray(whole.out | far)


def score_at(
    setup: Setup, points: Sequence[tuple[np.ndarray, np.ndarray]], record: RecordData
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Score and information at each point θ (p,) along the columns of its basis (p, q), all in one batch."""
    variants, steps = list[Variant](), list[np.ndarray]()
    for theta, basis in points:
        steps.append(_FORWARD * np.array([_shortest(setup.steps, b) for b in basis.T]))
        variants += [
            Variant(theta, record),
            *(Variant(theta + h * b, record) for h, b in zip(steps[-1], basis.T, strict=True)),
        ]
    out, found, at = setup.runner(variants), list[tuple[np.ndarray, np.ndarray]](), 0
    for one in steps:
        found.append(scores(out.some(slice(at, at + 1 + len(one))), one, setup.angular))
        at += 1 + len(one)
    return found


def _shortest(steps: np.ndarray, direction: np.ndarray) -> float:
    on = direction != 0
    return float((steps[on] / np.abs(direction[on])).min())


def discrete(
    setup: Setup, theta: np.ndarray, record: RecordData, some: Sequence[Alternative], with_outliers: float
) -> list[Candidate]:
    """What changing the record as a whole gains beyond leaving out what is far off.

    `with_outliers` is the log-likelihood of the record as it stands, outliers left out. Without it a smaller unit wins
    against outliers: it brings them nearer.
    """
    out = setup.runner([Variant(theta, record), *(Variant(theta, a.change(record)) for a in some)])
    L = log_likelihood(out)
    fit = [
        np.isfinite(v) and (a.kind != "time units" or _plausible(out, i))
        for i, (v, a) in enumerate(zip(L[1:], some, strict=True), 1)
    ]
    gains = np.array([v + a.jacobian for v, a in zip(L[1:], some, strict=True)]) - (L[0] if np.isfinite(L[0]) else 0.0)
    if not np.isfinite(with_outliers):
        gains = 1e9 + np.minimum(gains, 1e8) / 1e3
        return [_read(a, float(gains[i])) for i, a in enumerate(some) if fit[i]]
    pick = [i for i in np.argsort(-gains)[:_READINGS] if fit[i] and gains[i] > some[i].cost]
    if not pick:
        return []
    L = log_likelihood(masked(setup, [Variant(theta, some[i].change(record)) for i in pick])[1])
    return [_read(some[i], float(v + some[i].jacobian - with_outliers)) for i, v in zip(pick, L, strict=True)]


def _read(a: Alternative, gain: float) -> Candidate:
    return Candidate(a.kind, a.where, gain - a.cost, np.zeros(0), 0.0, alternative=a)


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
    ((g, info),) = score_at(setup, [(theta, np.eye(p))], record)
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
        points = [(theta + some[i].basis @ value[i], some[i].basis) for i in active]
        for i, at in zip(active, score_at(setup, points, record), strict=True):
            slope[i], I[i] = at
    return [
        Candidate(h.kind, h.where, float(L[i] - L0), value[i], float(1 / np.sqrt(max(I[i][0, 0], 1e-300))),
                  theta=h.basis @ value[i])
        for i, h in enumerate(some)
    ]  # fmt: skip
