"""Banks of filters against one filter and the optimum, on problems where one filter is far from it.

python benchmarks/bank.py --write docs/bank.md
"""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import sigmax
from report import Section, markdown, show, write
from sigmax.reports.comparison.standing import standings
from sigmax.studies import load_studies

STUDIES = {"single-beacon": 600, "stepanov-scalar": 2000, "quadratic-vector": 600}
FILTERS = {name: sigmax.get(name) for name in ("EKF", "PF", "SRCKFB")} | {
    f"SRCKFB:members={members}": sigmax.bank("SRCKFB", members) for members in (5, 9, 13, 21)
}
BEGIN, END = "<!-- studies: written by bank.py -->", "<!-- end of studies -->"


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the tables between the markers of a page.")] = None,
) -> None:
    """Compare on the single beacon, the scalar examples B and D, and quadratic functions; some six minutes."""
    sections = []
    for name, runs in STUDIES.items():
        for study in load_studies(name):
            if study.name in ("stepanov-A", "stepanov-C"):
                continue
            compared = sigmax.compare(study, FILTERS, runs=runs)
            rows = [
                (
                    s.name,
                    f"{s.distance:.3f}",
                    f"{s.middle:.3f}",
                    f"{100 * (s.outside or 0):.1f} %",
                    f"{s.cost or 0:.1f}",
                    s.word.value,
                )
                for s in standings(compared)
            ]
            section = Section(
                study.title,
                f"{runs} runs.",
                ("filter", "RMSE / optimum", "median / optimum", "outside of 95 %", "cost / EKF", "verdict"),
                rows,
            )
            show(section, Console())
            sections.append(markdown(section))
    if page is not None:
        write(page, "\n".join([f"Made by `python benchmarks/bank.py --write {page}`.\n", *sections]), BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
