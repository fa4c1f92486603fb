"""The section of a page on what is wrong with the model."""

from html import escape
from typing import NamedTuple

from sigmax.examination import Examination, Finding
from sigmax.records import Record
from sigmax.reports.document import place, section, table
from sigmax.reports.figures import Figure, examination_figures
from sigmax.reports.verdict import significant


class TrackExamination(NamedTuple):
    """What the doctor said of one track of a record, and by which filter."""

    track: int
    label: str
    examination: Examination


def examination_section(record: Record, examined: TrackExamination | None, figures: dict[str, Figure]) -> list[str]:
    """The section, none where nothing was examined; its figures are added to those of the page."""
    if examined is None:
        return []
    found = examined.examination
    of = f" of the track {record.tracks[examined.track]}" if len(record.tracks) > 1 else ""
    about = f"The doctor examined the model by {escape(examined.label)} on the record{escape(of)}"
    if found.refused:
        said = f"{about}. It cannot be examined: {escape(found.refused)}."
        return [section("What is wrong with the model", said, "")]
    if not found.findings:
        said = f"{about}: nothing of {found.tested} hypotheses explains it better than the model as it stands."
        return [section("What is wrong with the model", said, "")]
    body = table(("cause", "size", "evidence", "what mends it"), [_row(f) for f in found.findings])
    if found.evidence is not None:
        figures["examined/nis"], figures["examined/residual"], window = examination_figures(
            record, examined.track, found.evidence
        )
        about += f". Below: NIS over the last {window} steps, and the innovations that gave the first cause away"
        body += place("examined-nis", "examined/nis") + place("examined-residual", "examined/residual")
    return [section("What is wrong with the model", f"{about}.", body)]


def _row(f: Finding) -> list[str]:
    causes = " or ".join((f.cause, *f.either)) if f.either else f.cause
    later = " (provisional: found after the ones above)" if f.provisional else ""
    gain = f"log-likelihood +{significant(f.gain)}, " if f.kind not in ("coarse", "stuck", "copies") else ""
    nis = f"{gain}NIS per value {significant(f.nis_before)} → {significant(f.nis_after)}"
    return [escape(causes + later), escape(f.size or "–"), escape(nis), escape(f.change)]
