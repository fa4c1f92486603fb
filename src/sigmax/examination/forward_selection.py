"""Forward selection of causes: the likeliest is accepted, and the next is looked for from there."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sigmax.examination.alternatives import alternatives, with_starts
from sigmax.examination.conclusion import correlated, evidence, needed, unobserved
from sigmax.examination.envelope import curved
from sigmax.examination.envelope_runs import Innovations, Variant, log_likelihood
from sigmax.examination.families import other_families
from sigmax.examination.linearisations import crude, other_linearisations, with_filter
from sigmax.examination.manoeuvres import manoeuvres
from sigmax.examination.record_data import RecordData
from sigmax.examination.report import Evidence, Finding
from sigmax.examination.search import (
    Candidate,
    Setup,
    continuous,
    discrete,
    masked,
    nis_per_value,
    shapes,
    stretch,
)  # fmt: skip
from sigmax.examination.values import copies, flaw
from sigmax.examination.words import factor_of, in_words

_ROUNDS, _ALPHA, _TIE = 4, 0.003, 3.0
# What another family of motions looks like.
_AS_ANOTHER_MOTION = ("Q", "manoeuvre", "drift", "delay", "clock")
# What a number that was fitted must gain over a reading of the record without one.
_FITTED = 5.0
# NIS per value of a record that is so near to its model that nothing has to begin elsewhere.
_NEAR = 0.6
_SHAPES = ("tails", "outliers")
# Causes that another one imitates, and which tell the simpler story where they tell nearly as much.
_ELSEWHERE = ("sign", "turned", "convention")
_SIMPLER = ("sign", "turned", "degrees", "convention", "swap", "axes", "units")


class Accepted(NamedTuple):
    """A cause when it was accepted: it, those that explained less, NIS per value before and after."""

    best: Candidate
    others: Sequence[Candidate]
    nis: tuple[float, float]


class ForwardSelection:
    """One examination as it goes on."""

    def __init__(self, setup: Setup, record: RecordData, first: Innovations, say: Callable[[str], Any]) -> None:
        from scipy.special import chdtri

        self.setup, self.record, self.first, self.say = setup, record, first, say
        self.evidence: Evidence | None = None
        self.nis0 = nis_per_value(first, record)
        self.some = alternatives(setup.runner.family, record, setup.timed)
        self.tested = len(setup.hypotheses) + len(self.some) + 3 * len(record.huge)
        self.limit = 0.5 * float(chdtri(1, _ALPHA / len(setup.hypotheses)))

    def examine(self) -> tuple[tuple[Finding, ...], tuple[str, ...], str]:
        """Findings, what is not determined, and why nothing can be said where it is so."""
        flaws, start = self._values()
        theta, whole, accepted = np.zeros(len(self.setup.climber.steps)), start, list[Accepted]()
        (record,), out = masked(self.setup, [Variant(theta, whole)])
        T, first = len(whole.dt), stretch(whole)
        # By a model of another motion nothing can be searched any more.
        for rows in (T,) if first == T else (first, T):
            while len(accepted) < _ROUNDS and not any(a.best.kind == "motion" for a in accepted):
                of = "" if rows == T else f" on the first {rows:,} of {T:,} rows"
                self.say(f"round {len(accepted) + 1} of at most {_ROUNDS}{of}: {self.tested} hypotheses")
                found = self._found(theta, whole, rows, accepted)
                if not found or found[0].gain < self.limit:
                    break
                best, *others = _preferred(found, self.limit)
                before = nis_per_value(self.setup.runner([Variant(theta, whole)]), whole)
                if best.kind == "linearisation":
                    self.setup = with_filter(self.setup, best.where)
                theta = theta if best.basis is None else theta + best.basis @ best.value
                whole = whole if best.alternative is None else best.alternative.change(whole)
                (record,), out = masked(self.setup, [Variant(theta, whole)])
                after = best.nis if best.kind == "motion" else nis_per_value(out, record)
                accepted.append(Accepted(best, others, (before, after)))
        if not np.isfinite(log_likelihood(out)[0]):
            why = f"the filter fails on the model as it stands, {out.first_fault}, and nothing examined mends it"
            return (), (), why
        said = list[Finding]()
        if accepted:
            self.say("all causes together, and each left out once")
            fit = needed(self.setup, [a.best for a in accepted], start, record.out, self.limit)
            own = {(a.best.kind, a.best.where): a for a in accepted}
            for c in fit.causes:
                a = own[c.kind, c.where]
                said.append(self._finding(c, a.others, a.nis, bool(said or flaws)))
            theta, whole = fit.theta, replace(fit.record, out=start.out)
            (record,), out = masked(self.setup, [Variant(theta, whole)])
        if any(a.best.kind == "motion" for a in accepted):
            return (*flaws, *said), (), ""
        findings = (*flaws, *said, *correlated(self.setup, out, record, bool(flaws or said)))
        if findings:
            self.evidence = evidence(self.setup, findings[0].where, (self.first, out), (self.record, record))
        return findings, (*unobserved(self.setup, theta, record), *self._undetermined(theta, record)), ""

    def _found(self, theta: np.ndarray, whole: RecordData, rows: int, accepted: Sequence[Accepted]) -> list[Candidate]:
        """What the first rows tell, the likeliest in front; of all rows of a long record, what has a score alone."""
        part = whole.first(rows)
        (record,), out = masked(self.setup, [Variant(theta, part)])
        ended = {(a.best.kind, a.best.where) for a in accepted}
        kinds = {kind for kind, _ in ended}
        as_it_stands = float(log_likelihood(out)[0])
        found = list[Candidate]()
        if rows == stretch(whole):
            some = [a for a in self.some if (a.kind, a.where) not in ended]
            if np.isfinite(as_it_stands) and "manoeuvre" not in kinds:
                some += manoeuvres(self.setup, theta, self.setup.runner([Variant(theta, part)]), part)
            if not _NEAR < nis_per_value(out, record) < 1 / _NEAR:
                some += with_starts(self.setup.runner.family, some)
            found += discrete(self.setup, theta, part, some, as_it_stands)
        if np.isfinite(as_it_stands):
            if not kinds & set(_SHAPES):
                found += shapes(self.setup, out, record, part)
            found += continuous(self.setup, theta, record, ended)
        found = [c for c in found if _matters(c)]
        best = max(found, key=lambda c: c.gain, default=None)
        some_gain = best is not None and best.gain > self.limit
        if some_gain and "linearisation" not in kinds and crude(self.setup, theta, part):
            found += other_linearisations(self.setup, theta, part, as_it_stands)
        if some_gain and not accepted and best is not None and best.kind in _AS_ANOTHER_MOTION:
            found += other_families(self.setup, record, best)
        return sorted(found, key=lambda c: -c.gain)

    def _values(self) -> tuple[list[Finding], RecordData]:
        """Flaws of the values themselves, and the record without them."""
        record, found, at = self.record, list[Finding](), 0
        extra, out = record.extra.copy(), record.out.copy()
        nis = self.nis0
        for s, z in record.z.items():
            own = self.setup.names[s]
            for j, name in enumerate(own):
                one = None if curved(self.setup.runner.family.plain, s) else flaw(z[:, j], float(self.setup.R[s][j]))
                if one is not None:
                    extra[at] += one.extra
                    out[:, at] |= one.rows
                    if one.kind == "coarse":
                        said = (
                            f"{name} comes in steps",
                            f"of {one.size:.4g}",
                            f"add {one.extra:.3g} to its R (step²/12)",
                        )
                    else:
                        said = (
                            f"{name} is stuck", f"up to {one.size:.0f} equal values in a row, from row {one.first}",
                            "leave these rows out: NaN",
                        )  # fmt: skip
                    found.append(Finding(one.kind, name, *said, one.size, np.nan, one.concerned, nis, nis))
                at += 1
            if (twice := copies(z)) is not None and not any(f.kind == "stuck" for f in found):
                out[:, at - len(own) : at] |= twice.rows[:, None]
                said = (
                    "rows are copies of the one before",
                    f"{twice.concerned} of {np.isfinite(z).any(1).sum()}, the first is row {twice.first}",
                    "leave them out: NaN",
                )  # fmt: skip
                found.append(Finding("copies", s or "rows", *said, twice.size, np.nan, twice.concerned, nis, nis))
        clean = replace(record, extra=extra, out=out)
        if found:
            after = nis_per_value(self.setup.runner([Variant(np.zeros(len(self.setup.climber.steps)), clean)]), clean)
            found = [replace(f, nis_after=after) for f in found]
        return found, clean

    def _finding(
        self, best: Candidate, others: Sequence[Candidate], nis: tuple[float, float], provisional: bool
    ) -> Finding:
        rivals = list[tuple[str, Candidate]]()
        for said, c in [(self._said(c), c) for c in others if best.gain - c.gain < max(5.0, 0.1 * abs(best.gain))]:
            if not _same(best, c) and said not in (self._said(best), *(other for other, _ in rivals)):
                rivals.append((said, c))
        tied = [(said, c.kind) for said, c in rivals if abs(best.gain - c.gain) < _TIE]
        cause, size, change = in_words(best, self._variance(best))
        value = best.value[np.argmax(np.abs(best.value))] if best.value.size else np.nan
        std = best.std if best.value.size else np.nan
        return Finding(
            best.kind, best.where, cause, size, change, float(value), float(std), best.gain,
            *nis, tuple(said for said, _ in tied), tuple(kind for _, kind in tied),
            tuple((said, best.gain - c.gain) for said, c in rivals if best.gain - c.gain >= _TIE), provisional,
            factor_of(best),
        )  # fmt: skip

    def _said(self, c: Candidate) -> str:
        cause, size, _ = in_words(c, self._variance(c))
        return f"{cause}{f', {size}' if size else ''}"

    def _variance(self, c: Candidate) -> float | None:
        """R of the component that a candidate is about."""
        names = [(name, s, j) for s, some in self.setup.names.items() for j, name in enumerate(some)]
        return next((float(self.setup.R[s][j]) for name, s, j in names if name == c.where), None)

    def _undetermined(self, theta: np.ndarray, record: RecordData) -> tuple[str, ...]:
        """Which noises the record does not tell."""
        noises = [(i, p) for i, p in enumerate(self.setup.runner.family.parameters) if p.kind in ("R", "Q")]
        basis = np.eye(len(theta))[:, [i for i, _ in noises]]
        (here,) = self.setup.climber.slopes([(Variant(theta, record), basis)])
        return tuple(f"{p.kind} of {p.where}" for j, (_, p) in enumerate(noises) if here.info[j, j] < 1)


def _matters(c: Candidate) -> bool:
    """Whether a cause is large enough to be worth a word."""
    least = {"R": np.log(1.2), "Q": np.log(1.6), "prior": 3.0}.get(c.kind, 0.0)
    return bool(np.isfinite(c.gain) and (not c.value.size or np.abs(c.value).max() > least))


def _same(best: Candidate, c: Candidate) -> bool:
    """Whether a factor that was fitted is but the sign, or the unit, that is named."""
    return c.where == best.where and best.kind in _SIMPLER and c.kind in ("scale", "input gain")


def _vague(found: list[Candidate]) -> list[Candidate]:
    """Readings of a component that exclude each other and explain as much: they do no more than begin elsewhere."""
    turned = [c for c in found if c.kind in _ELSEWHERE]
    groups = ([c for c in turned if c.where == d.where and abs(c.gain - d.gain) < _TIE] for d in turned)
    return [c for group in groups if len(group) > 2 for c in group]


def _preferred(found: list[Candidate], limit: float) -> list[Candidate]:
    """The candidates with the one to believe in front."""
    first = found[0]
    vague = _vague(found)
    if any(first is c for c in vague):
        other = [c for c in found if not any(c is d for d in vague) and c.gain > max(limit, 0.7 * first.gain)]
        return other[:1] + [c for c in found if not other or c is not other[0]]
    if first.kind == "R":  # tails blow R up
        heavy = [c for c in found if c.kind in _SHAPES and c.gain > max(limit, 0.2 * first.gain)]
        return heavy[:1] + [c for c in found if not heavy or c is not heavy[0]]
    for c in found:
        if c.kind == "linearisation" and c.gain > 0.9 * first.gain:
            return [c, *(d for d in found if d is not c)]
    for c in found[1:]:
        # A prior that is off imitates them, and a factor that is fitted is one number more than a sign.
        near = 0.7 * first.gain if first.kind == "prior" else first.gain - _FITTED if first.value.size else np.inf
        if c.kind in _SIMPLER and c.gain > max(limit, near) and not any(c is d for d in vague):
            return [c, *(d for d in found if d is not c)]
    return found
