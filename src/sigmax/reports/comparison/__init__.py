"""The report of a study."""

from sigmax.reports.comparison.folder import files, measures_table, summary, write
from sigmax.reports.comparison.page import page
from sigmax.reports.comparison.standing import Standing, Word, standings
from sigmax.reports.comparison.verdict import verdict

__all__ = ["Standing", "Word", "files", "measures_table", "page", "standings", "summary", "verdict", "write"]
