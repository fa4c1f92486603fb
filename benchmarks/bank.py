"""Banks of filters against one filter and the optimum, on problems where one filter is far from it.

python benchmarks/bank.py --write docs/bank.md
python benchmarks/bank.py --cost                    time of banks in units of one member, run in turn
"""

import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

import sigmax
from report import Section, markdown, show, write
from sigmax.reports.comparison.standing import standings
from sigmax.studies import Study, load_studies
from sigmax.studies.simulate import draw

STUDIES = {"single-beacon": 600, "stepanov-scalar": 2000, "quadratic-vector": 600}
FILTERS = {name: sigmax.get(name) for name in ("EKF", "PF", "SRCKFB")} | {
    f"SRCKFB:members={members}": sigmax.bank("SRCKFB", members) for members in (5, 9, 13, 21)
}
BEGIN, END = "<!-- studies: written by bank.py -->", "<!-- end of studies -->"


MEMBERS, ROUNDS = (5, 9, 13), 25


def cost(study: Study) -> None:
    """Print what banks take of the processor, in units of one member: the middle of several rounds of 256 tracks."""
    drawn = draw(study, 1, 0)
    model, prior = study.model_and_prior(drawn.mean)
    z = drawn.z if model.several else drawn.z[""]
    filters = [sigmax.get("SRCKFB"), *(sigmax.bank("SRCKFB", members) for members in MEMBERS)]

    def seconds(filter: sigmax.Filter) -> float:
        began = time.process_time()
        sigmax.run(filter, model, prior, z, dt=study.dt, inputs=study.inputs, keep=("mean", "factor"))
        return time.process_time() - began

    _, *rounds = ([seconds(f) for f in filters] for _ in range(ROUNDS + 1))
    times = np.array(rounds)
    ratios = np.median(times[:, 1:] / times[:, :1], axis=0)
    each = ", ".join(f"{r:.1f} with {m}" for r, m in zip(ratios, MEMBERS, strict=True))
    print(f"{study.name}: {each}; one takes {1e9 * times[:, 0].min() / len(drawn.mean) / study.steps:.0f} ns a step")


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the tables between the markers of a page.")] = None,
    cost_alone: Annotated[
        bool, typer.Option("--cost", help="Print the cost in units of one member, and no more.")
    ] = False,
) -> None:
    """Compare on the single beacon, the scalar examples B and D, and quadratic functions; some six minutes."""
    if cost_alone:
        for name in STUDIES:
            for study in load_studies(name):
                cost(study)
        return
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
