"""Reports: scores, a verdict in words, and the folder with estimates, summary and page."""

from sigmax.reports.examination_section import TrackExamination
from sigmax.reports.folder import check_folder, write
from sigmax.reports.grade import Grade, grade
from sigmax.reports.score import Score, score
from sigmax.reports.verdict import verdict

__all__ = [
    "Grade",
    "Score",
    "TrackExamination",
    "check_folder",
    "grade",
    "score",
    "verdict",
    "write",
]
