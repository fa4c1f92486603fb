"""The report of a study."""

from sigmax.reports.comparison.folder import files, measures_table, summary, write
from sigmax.reports.comparison.page import page
from sigmax.reports.comparison.standing import Standing, standings, verdict

__all__ = ["Standing", "files", "measures_table", "page", "standings", "summary", "verdict", "write"]
