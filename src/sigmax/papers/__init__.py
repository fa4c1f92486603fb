"""The papers that filters come from, row by row: what stands there, what shows it, what comes of it.

A paper's table is a Markdown file of its name beside this one; the page of the documentation shows the same file.
"""

import re
from pathlib import Path
from typing import NamedTuple

from sigmax.errors import unknown

PAPERS = {
    "sobolev": "A. A. Sobolev, comparison of nonlinear Kalman filters for track processing (in Russian)",
    "stepanov": "O. A. Stepanov et al., polynomial filtering with quadratic nonlinearities (in Russian), 2021",
    "zhang": "L. Zhang et al., two-stage high-degree cubature information filter, Acta Electronica Sinica 2019",
    "belov": "R. V. Belov et al., a cheaper unscented transform by permuting the state (in Russian), 2019",
}


class Row(NamedTuple):
    """A row of a paper: where it stands and what it says, commands or calls, and the verdict with our figure."""

    row: str
    how: str
    verdict: str

    @property
    def commands(self) -> list[str]:
        """What is to be typed, in the order of the row; empty where nothing can be run."""
        return re.findall(r"`([^`]+)`", self.how)


def table(paper: str) -> str:
    """The table of a paper, in Markdown.

    Raises:
        InputError: for a paper that is not known.
    """
    known = {name.casefold(): name for name in PAPERS}
    if paper.casefold() not in known:
        raise unknown("paper", paper, PAPERS)
    return (Path(__file__).parent / f"{known[paper.casefold()]}.md").read_text(encoding="utf-8")


def rows(paper: str) -> list[Row]:
    """The rows of a paper.

    Raises:
        InputError: for a paper that is not known.
    """
    lines = [line for line in table(paper).splitlines() if line.startswith("|")]
    cells = [re.split(r"(?<!\\)\|", line.strip()[1:-1]) for line in lines[2:]]
    return [Row(*(cell.strip().replace(r"\|", "|") for cell in row)) for row in cells]
