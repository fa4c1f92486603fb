"""The search: score tests, re-runs of the best hypotheses, and what they gain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sigmax.examination.envelope_runs import Innovations, Runner, Variant, log_likelihood
from sigmax.examination.gauss_newton import Climber, Start
from sigmax.examination.hypotheses import LIMITS, Hypothesis
from sigmax.examination.record_data import Alternative, RecordData
from sigmax.examination.shape import tails

# Values farther off than so many robust deviations are left out: in how many rounds, and how large a share at most.
_FAR, _ROUNDS, _MOST = 4.5, 4, 0.3
# A longer record is searched in its first rows, as long as these have so many values of each component.
_LONG, _VALUES = 5000, 200
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
        std: standard error of the largest.
        basis: the directions of these parameters in those of the envelope (p, d).
        alternative: what changes the record instead.
        times: of outliers, how many deviations wide they are.
        numbers: of another motion, those of its noise, in words.
        nis: NIS per value with another motion, by which nothing else is searched.
    """

    kind: str
    where: str
    gain: float
    value: np.ndarray
    std: float
    basis: np.ndarray | None = None
    alternative: Alternative | None = None
    times: float = 0.0
    numbers: str = ""
    nis: float = float("nan")

    @property
    def limits(self) -> np.ndarray:
        """The longest step of each parameter (d,)."""
        return np.full(len(self.value), LIMITS.get(self.kind, np.inf))

    def moved(self, value: np.ndarray, deviations: np.ndarray) -> "Candidate":
        """With other values (d,) of its parameters, and their standard errors."""
        return replace(self, value=value, std=float(deviations[np.argmax(np.abs(value))]))


@dataclass(frozen=True)
class Setup:
    """What stays the same through the search.

    Attributes:
        climber: the filter on the envelope, and how the likelihood slopes there.
        hypotheses: directions.
        R: variances of the sensors at the prior.
        names: of components, by sensor.
        burn: steps at the start that are never left out, where a wrong prior speaks.
        timed: whether the motion depends on dt.
    """

    climber: Climber
    hypotheses: Sequence[Hypothesis]
    R: dict[str, np.ndarray]
    names: dict[str, list[str]]
    burn: int
    timed: bool

    @property
    def runner(self) -> Runner:
        """The filter on the envelope."""
        return self.climber.runner


def normalised(outcome: Innovations, record: RecordData, i: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Innovations of variant i over their deviations (T, M), as if nothing were left out; which values are there."""
    S = np.concatenate([np.einsum("tii->ti", v[i]) for v in outcome.S.values()], 1)
    nu = np.concatenate([v[i] for v in outcome.nu.values()], 1)
    seen = np.concatenate(list(outcome.seen.values()), 1)
    return nu / np.sqrt(np.maximum(S - record.out * record.huge, 1e-12 * S)), seen


def stretch(record: RecordData) -> int:
    """How many of the first rows are searched for causes; what is found is fitted to all rows."""
    seen = np.isfinite(np.concatenate(list(record.z.values()), 1)).cumsum(0)
    rows, T = _LONG, len(record.dt)
    while rows < T and (seen[rows - 1] < np.minimum(_VALUES, seen[-1])).any():
        rows *= 2
    return min(rows, T)


def nis_per_value(outcome: Innovations, record: RecordData) -> float:
    """NIS over the number of values that are not left out."""
    seen = np.concatenate(list(outcome.seen.values()), 1) & ~record.out
    return float(sum(nis[0].sum() for nis in outcome.nis().values()) / max(int(seen.sum()), 1))


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
        np.isfinite(v) and (a.kind not in ("time units", "manoeuvre") or _plausible(out, i))
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
    """Whether the median NIS is about what it should be: a longer dt, and Q in some rows, are also a larger Q."""
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


def continuous(setup: Setup, theta: np.ndarray, record: RecordData, ended: set[tuple[str, str]]) -> list[Candidate]:
    """The best directions by their scores, each followed to where the likelihood is largest."""
    p, T = len(theta), len(record.dt)
    (here,) = setup.climber.slopes([(Variant(theta, record), np.eye(p))])
    chi: list[tuple[float, Hypothesis]] = []
    for h in setup.hypotheses:
        along = here.along(h.basis)
        if (h.kind, h.where) in ended or np.trace(along.info) < 1e-8:
            continue
        step = np.linalg.lstsq(along.info, along.gradient, rcond=1e-10)[0]
        chi.append((float(along.gradient @ step) - 2 * (len(step) - 1), h))
    chi.sort(key=lambda c: -c[0])
    pick: list[Candidate] = []
    for value, h in chi:
        if value > 8 and len(pick) < 9 and sum(other.kind == h.kind for other in pick) < 2:
            pick.append(Candidate(h.kind, h.where, 0.0, np.zeros(h.basis.shape[1]), np.nan, h.basis))
    tops = setup.climber.climb(
        [Start(theta, c.basis, c.limits, record) for c in pick if c.basis is not None],
        [here.along(c.basis) for c in pick if c.basis is not None],
    )
    return [
        replace(c.moved(value, there.deviations()), gain=there.L - here.L - 0.5 * np.log(T) * (len(value) - 1))
        for c, (value, there) in zip(pick, tops, strict=True)
    ]
