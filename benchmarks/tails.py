"""Robust updates on recorded ranges: as they are, and with one of ten too long.

python benchmarks/tails.py --write docs/updates.md
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import sigmax
from report import Section, markdown, show, write
from sigmax.running import fit_tails
from uwb import DATA, Run, hanyang, labyrinth, plaza, score

SHARE, SHORTEST, LONGEST = 0.1, 0.5, 5.0
RECORDS: dict[str, Callable[[], Run]] = {
    "labyrinth": lambda: labyrinth(DATA / "labyrinth_uwb"),
    "hanyang": lambda: hanyang(DATA / "hanyang_uwb"),
    "plaza1": lambda: plaza(1),
    "plaza2": lambda: plaza(2),
}
UPDATES = ("once", "student", "huber", "gate")
BEGIN, END = "<!-- tails: written by tails.py -->", "<!-- end of tails -->"


def with_detours(run: Run) -> Run:
    """A record of which one range of ten is up to five metres too long, as if reflected."""
    rng = np.random.default_rng(0)

    def lengthened(z: np.ndarray) -> np.ndarray:
        return np.where(rng.random(z.shape) < SHARE, z + rng.uniform(SHORTEST, LONGEST, z.shape), z)

    z: Any = {k: lengthened(v) for k, v in run.z.items()} if isinstance(run.z, dict) else lengthened(run.z)
    return run._replace(z=z)


def compared() -> Iterator[tuple[str, ...]]:
    """A row for each record, as it is and with detours."""
    for name, load in track(RECORDS.items(), "tails", len(RECORDS)):
        recorded = load()
        for what, run in (("as recorded", recorded), ("detours", with_detours(recorded))):
            model = run.models["bias"]
            found = fit_tails("SRCKFB", model, run.prior, run.z, dt=run.dt, inputs=run.inputs)
            errors = [score(sigmax.get("SRCKFB", update=u), run, model)[0] for u in UPDATES]
            yield name, what, *(f"{e:.3f}" for e in (*errors, score(found, run, model)[0])), str(found.update or "once")


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
) -> None:
    """Track four records with every update and with those that `fit_tails` finds; takes about two minutes."""
    section = Section(
        "Recorded ranges",
        "SRCKFB, a bias on each range; rmse of the position in m. Detours: one range of ten is 0.5 to 5 m too long.",
        ("record", "ranges", *UPDATES, "fit_tails", "what it found"),
        list(compared()),
    )
    show(section, Console())
    if page is not None:
        text = [f"Made by `python benchmarks/tails.py --write {page}`.", "", markdown(section)]
        write(page, "\n".join(text), BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
