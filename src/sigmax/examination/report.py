"""What an examination found."""

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np


@dataclass(frozen=True)
class Finding:
    """One cause.

    Attributes:
        kind: "bias", "scale", "R", "Q", "outliers", "coarse", "units", … : see the page of the docs.
        where: component, sensor, state or input.
        cause: in words.
        size: in words, with its standard error.
        change: what mends it.
        value: the size as a number, NaN where there is none: the bias, the scale less 1, log factors of R and Q.
        std: its standard error, NaN where there is none.
        gain: in log-likelihood by re-running with the change; how many values are concerned for a flaw of the values.
        nis_before: NIS per measured value before the change.
        nis_after: after it, far values left out.
        either: causes that the record cannot tell from this one, within a log-likelihood of 3.
        either_kinds: of what kind these are.
        rivals: causes that explain it less well, and by how much.
        provisional: whether it was found after another one, whose debris it may be.
        factor: by which values, times or the prior's covariance are to be multiplied, where it has a name or the cause
            is another reading of them; else 0.
    """

    kind: str
    where: str
    cause: str
    size: str
    change: str
    value: float
    std: float
    gain: float
    nis_before: float
    nis_after: float
    either: tuple[str, ...] = ()
    either_kinds: tuple[str, ...] = ()
    rivals: tuple[tuple[str, float], ...] = ()
    provisional: bool = False
    factor: float = 0.0


class Evidence(NamedTuple):
    """What the filter said at each step, before anything was changed and with all that was found.

    Attributes:
        nis: NIS of all sensors together (T,), before and after.
        dof: how many values each step has (T,).
        component: the one whose innovations gave the first cause away.
        residual: its innovations over their deviations (T,), before and after; NaN where there was no value.
        out: which of them are too far off after it (T,).
    """

    nis: tuple[np.ndarray, np.ndarray]
    dof: np.ndarray
    component: str
    residual: tuple[np.ndarray, np.ndarray]
    out: np.ndarray


@dataclass(frozen=True, repr=False)
class Examination:
    """What `sigmax.doctor` found.

    Attributes:
        findings: causes, the first first; empty for a sound model.
        refused: why nothing can be said; empty where the record can be examined.
        undetermined: what the record does not tell.
        tested: how many hypotheses were tested.
        nis: NIS per measured value of the model as it stands; 1 is expected.
        steps: of the record.
        filter: its name.
        seconds: what it took.
        evidence: the filter's innovations before and after; None where nothing was found.
    """

    findings: tuple[Finding, ...]
    refused: str
    undetermined: tuple[str, ...]
    tested: int
    nis: float
    steps: int
    filter: str
    seconds: float
    evidence: Evidence | None = None

    @property
    def status(self) -> int:
        """0 sound, 1 with findings, 2 not examinable: the exit status of the command."""
        return 2 if self.refused else 1 if self.findings else 0

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data, None in the place of NaN, without the evidence of each step."""
        whole = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("evidence", "findings")}
        findings = [{k: None if v != v else v for k, v in asdict(f).items()} for f in self.findings]
        return whole | {"findings": findings, "status": self.status}

    def __repr__(self) -> str:
        head = f"Examination by {self.filter}: {self.steps:,} steps, NIS per value {self.nis:.3g} where 1 is expected"
        if self.refused:
            return f"{head}\n  not examinable: {self.refused}"
        lines = [head]
        if not self.findings:
            lines.append("  sound: nothing examined explains the record better than the model as it stands")
        for i, f in enumerate(self.findings, 1):
            lines += _lines(i, f)
        if self.undetermined:
            lines.append(f"  not told by the record: {'; '.join(self.undetermined)}")
        lines.append(f"  tested: {self.tested} hypotheses, in {self.seconds:.1f} s")
        return "\n".join(lines)


def _lines(i: int, f: Finding) -> list[str]:
    provisional = " (provisional: found after the ones above)" if f.provisional else ""
    either = "either " if f.either else ""
    lines = [f"  {i}  {either}{f.cause}{f', {f.size}' if f.size else ''}{provisional}"]
    lines += [f"     or {other}: the record cannot tell" for other in f.either]
    if f.kind in ("coarse", "stuck", "copies"):
        lines.append(f"     evidence: the values themselves, {f.gain:.0f} of them")
    else:
        nis = f"{f.nis_before:.3g} → {f.nis_after:.3g}"
        lines.append(f"     evidence: log-likelihood +{f.gain:.1f} by re-running, NIS per value {nis}")
    lines.append(f"     change: {f.change}")
    if f.rivals:
        lines.append(f"     rather than: {'; '.join(f'{what} (−{less:.0f})' for what, less in f.rivals[:2])}")
    return lines
