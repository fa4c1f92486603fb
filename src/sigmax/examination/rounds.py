"""Rounds of an examination: the likeliest cause is accepted, and the next is looked for from there."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sigmax.examination.alternatives import alternatives, with_starts
from sigmax.examination.report import Evidence, Finding
from sigmax.examination.search import (
    Candidate,
    Setup,
    continuous,
    discrete,
    masked,
    normalised,
    score_at,
    shapes,
)  # fmt: skip
from sigmax.examination.values import copies, flaw
from sigmax.examination.variants import Innovations, RecordData, Variant, log_likelihood
from sigmax.examination.words import factor_of, in_words

_ROUNDS, _ALPHA, _TIE = 4, 0.003, 3.0
# NIS per value of a record that is so near to its model that nothing has to begin elsewhere.
_NEAR = 0.6
_SHAPES = ("tails", "outliers")
# Causes that another one imitates, and which tell the simpler story where they tell nearly as much.
_SIMPLER = ("sign", "turned", "degrees", "convention", "swap", "units")


class Accepted(NamedTuple):
    """A cause with how it stood when it was accepted."""

    candidate: Candidate
    finding: Finding


class Rounds:
    """One examination as it goes on."""

    def __init__(self, setup: Setup, record: RecordData, first: Innovations, say: Callable[[str], Any]) -> None:
        from scipy.special import chdtri

        self.setup, self.record, self.first, self.say = setup, record, first, say
        self.evidence: Evidence | None = None
        self.nis0 = _nis_per_value(first, record)
        self.some = alternatives(setup.runner.family, record, setup.timed)
        self.tested = len(setup.hypotheses) + len(self.some) + 3 * len(record.huge)
        self.limit = 0.5 * float(chdtri(1, _ALPHA / len(setup.hypotheses)))

    def examine(self) -> tuple[tuple[Finding, ...], tuple[str, ...], str]:
        """Findings, what is not determined, and why nothing can be said where it is so."""
        flaws, whole = self._values()
        theta, ended, accepted = np.zeros(len(self.setup.steps)), set[tuple[str, str]](), list[Accepted]()
        start = whole
        (record,), out = masked(self.setup, [Variant(theta, whole)])
        for i in range(_ROUNDS):
            self.say(f"round {i + 1} of at most {_ROUNDS}: {self.tested} hypotheses")
            some = [a for a in self.some if (a.kind, a.where) not in ended]
            as_it_stands = float(log_likelihood(out)[0])
            if not _NEAR < _nis_per_value(out, record) < 1 / _NEAR:
                some += with_starts(self.setup.runner.family, some)
            found = discrete(self.setup, theta, whole, some, as_it_stands)
            if np.isfinite(as_it_stands):
                if ("shape", "") not in ended:
                    found += shapes(self.setup, out, record, whole)
                found += continuous(self.setup, theta, record, ended)[0]
            found = sorted(filter(_matters, found), key=lambda c: -c.gain)
            if not found or found[0].gain < self.limit:
                break
            best, *others = _preferred(found, self.limit)
            before = _nis_per_value(self.setup.runner([Variant(theta, whole)]), whole)
            if best.kind in _SHAPES:
                ended.add(("shape", ""))
            ended.add((best.kind, best.where))
            theta = theta if best.theta is None else theta + best.theta
            whole = whole if best.alternative is None else best.alternative.change(whole)
            (record,), out = masked(self.setup, [Variant(theta, whole)])
            nis = before, _nis_per_value(out, record)
            accepted.append(Accepted(best, self._finding(best, others, nis, bool(accepted or flaws))))
        if not np.isfinite(log_likelihood(out)[0]):
            return (
                (),
                (),
                f"the filter fails on the model as it stands, {out.first_fault}, and nothing examined mends it",
            )
        self.say("each cause left out once")
        kept = self._needed(accepted, theta, start, record)
        last = self._correlated(out, record, bool(flaws or kept))
        findings = (*flaws, *(a.finding for a in kept), *last)
        self.evidence = self._evidence(findings[0].where, out, record) if findings else None
        return findings, self._undetermined(theta, record), ""

    def _evidence(self, where: str, out: Innovations, record: RecordData) -> Evidence:
        """The innovations before and after, of the component of a cause or else the one that changed most."""
        names = [name for some in self.setup.names.values() for name in some]
        (before, seen), (after, _) = normalised(self.first, self.record), normalised(out, record)
        kept = seen & ~record.out
        change = [float(np.mean((before[k, j] - after[k, j]) ** 2)) if k.any() else 0.0 for j, k in enumerate(kept.T)]
        j = names.index(where) if where in names else int(np.argmax(change))
        nis = tuple(sum(v[0] for v in o.nis().values()) for o in (self.first, out))
        residual = tuple(np.where(seen[:, j], r[:, j], np.nan) for r in (before, after))
        return Evidence(
            (nis[0], nis[1]), kept.sum(1), names[j], (residual[0], residual[1]), record.out[:, j] & seen[:, j]
        )

    def _values(self) -> tuple[list[Finding], RecordData]:
        """Flaws of the values themselves, and the record without them."""
        record, found, at = self.record, list[Finding](), 0
        extra, out = record.extra.copy(), record.out.copy()
        nis = self.nis0
        for s, z in record.z.items():
            for j in range(z.shape[1]):
                name, one = self.setup.names[s][j], flaw(z[:, j], float(self.setup.R[s][j]))
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
                out[:, at - z.shape[1] : at] |= twice.rows[:, None]
                said = (
                    "rows are copies of the one before",
                    f"{twice.concerned} of {len(z)}, the first is row {twice.first}",
                    "leave them out: NaN",
                )  # fmt: skip
                found.append(Finding("copies", s or "rows", *said, twice.size, np.nan, twice.concerned, nis, nis))
        clean = replace(record, extra=extra, out=out)
        if found:
            after = _nis_per_value(self.setup.runner([Variant(np.zeros(len(self.setup.steps)), clean)]), clean)
            found = [replace(f, nis_after=after) for f in found]
        return found, clean

    def _finding(
        self, best: Candidate, others: Sequence[Candidate], nis: tuple[float, float], provisional: bool
    ) -> Finding:
        rivals = [(self._said(c), c) for c in others if best.gain - c.gain < max(5.0, 0.1 * abs(best.gain))]
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

    def _needed(
        self, accepted: list[Accepted], theta: np.ndarray, start: RecordData, record: RecordData
    ) -> list[Accepted]:
        """The causes without each of which the record is less likely: what only explained another's debris goes."""
        if len(accepted) < 2:
            return accepted
        variants, owners, owed = [Variant(theta, record)], [], []
        for a in accepted:
            c = a.candidate
            if c.theta is None and c.alternative is None:
                continue
            rest = start
            for other in accepted:
                if other is not a and other.candidate.alternative is not None:
                    rest = other.candidate.alternative.change(rest)
            variants.append(Variant(theta if c.theta is None else theta - c.theta, replace(rest, out=record.out)))
            owners.append(a)
            owed.append(0.0 if c.alternative is None else c.alternative.jacobian)
        L = log_likelihood(self.setup.runner(variants))
        lost = {id(a): L[0] + owed[i] - L[i + 1] for i, a in enumerate(owners)}
        return [a for a in accepted if lost.get(id(a), np.inf) > self.limit]

    def _correlated(self, out: Innovations, record: RecordData, provisional: bool) -> list[Finding]:
        """Whether what remains goes on from one row to the next, which nothing examined explains."""
        r, seen = normalised(out, record)
        found = []
        for j, name in enumerate(name for some in self.setup.names.values() for name in some):
            e = np.clip(r[seen[:, j] & ~record.out[:, j], j], -4, 4)[self.setup.burn :]
            if len(e) < 50:
                continue
            rho = float((e[1:] * e[:-1]).mean() / (e * e).mean())
            z = rho * np.sqrt(len(e))
            if abs(z) > 4.5 and abs(rho) > 0.1:
                nis = _nis_per_value(out, record)
                cause = f"what remains of {name} is correlated from one value to the next"
                change = "nothing examined explains it: noise correlated in time, or a motion that lacks a state"
                said = (cause, f"{rho:.2f} ± {1 / np.sqrt(len(e)):.2f}", change)
                one = Finding("correlated", name, *said, rho, 1 / np.sqrt(len(e)), z * z / 2, nis, nis)
                found.append(replace(one, provisional=provisional))
        return sorted(found, key=lambda f: -f.gain)[:1]

    def _undetermined(self, theta: np.ndarray, record: RecordData) -> tuple[str, ...]:
        """Which noises the record does not tell."""
        ((_, info),) = score_at(self.setup, [(theta, np.eye(len(theta)))], record)
        parameters = self.setup.runner.family.parameters
        return tuple(
            f"{p.kind} of {p.where}" for i, p in enumerate(parameters) if p.kind in ("R", "Q") and info[i, i] < 1
        )


def _nis_per_value(out: Innovations, record: RecordData) -> float:
    """NIS over the number of values that are not left out."""
    seen = np.concatenate(list(out.seen.values()), 1) & ~record.out
    return float(sum(nis[0].sum() for nis in out.nis().values()) / max(int(seen.sum()), 1))


def _matters(c: Candidate) -> bool:
    """Whether a cause is large enough to be worth a word."""
    least = {"R": np.log(1.2), "Q": np.log(1.6), "prior": 3.0}.get(c.kind, 0.0)
    return bool(np.isfinite(c.gain) and (not c.value.size or np.abs(c.value).max() > least))


def _preferred(found: list[Candidate], limit: float) -> list[Candidate]:
    """The candidates with the one to believe in front."""
    first = found[0]
    if first.kind == "R":  # tails blow R up
        heavy = [c for c in found if c.kind in _SHAPES and c.gain > max(limit, 0.2 * first.gain)]
        return heavy[:1] + [c for c in found if not heavy or c is not heavy[0]]
    if first.kind == "prior":
        for c in found[1:]:
            if c.kind in _SIMPLER and c.gain > max(limit, 0.7 * first.gain):
                return [c, *(d for d in found if d is not c)]
    return found
