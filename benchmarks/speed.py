"""Speed of this library against dynamax, FilterPy, turbo-ckf and Stone Soup, all in one run.

python benchmarks/speed.py --write benchmarks/README.md
"""

import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

import yardsticks
from answers import RMSE_FACTOR, TOLERANCE, Answers
from contenders import Entry
from fresh import CACHED, Process, first_results, help_text
from machine import description
from measure import Timing, ratio, round_robin, spread
from report import Section, markdown, show, write
from scenario import LIVE_STEPS, STEPS, Estimate, Record, record
from targets import targets

LIBRARIES = {
    "sigmax": "sigmax",
    "dynamax": "dynamax",
    "filterpy": "FilterPy",
    "turbo_ckf": "turbo-ckf",
    "stonesoup": "Stone Soup",
}
# Rounds and calls within a round: batch, one track, live, one core, fresh processes, help text.
FULL = {"batch": (4, 1), "offline": (7, 10), "live": (7, 3), "core": (7, 3), "first": (3, 1), "help": (7, 1)}
QUICK = {"batch": (2, 1), "offline": (3, 3), "live": (2, 1), "core": (3, 3), "first": (1, 1), "help": (2, 1)}
# With --quick the filters that no other library has, and the variants, are left out.
QUICK_LEAVES_OUT = ("sigmax SRECKFB", "sigmax CKF", "sigmax SRUKFB", "sigmax SREKFB", "all parts", "by hand", "XLA")
TITLES = {"batch": "A batch of {tracks} tracks", "offline": "One track, offline", "live": "One step, live"}


def load(console: Console) -> dict[str, ModuleType]:
    """The contenders that are installed; a line for each that is not."""
    found = {}
    for module, name in LIBRARIES.items():
        try:
            found[module] = import_module(f"contenders.{module}")
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] != module:
                raise
            console.print(f"[yellow]{name} is not installed and is left out; pip install 'sigmax\\[bench]'[/]")
    return found


def timed(
    what: str, entries: list[Entry], plan: tuple[int, int], answers: Answers, progress: Progress
) -> dict[str, Timing]:
    """Time one discipline under a progress bar."""
    rounds, repeats = plan
    bar = progress.add_task(what, total=len(entries) * (rounds + 1))
    return round_robin(entries, rounds, repeats, ticker(progress, bar, what), answers.look)


def taking_part(what: str, libraries: dict[str, ModuleType], z: np.ndarray, quick: bool) -> list[Entry]:
    """The entries of all libraries that know a discipline."""
    entries = [e for library in libraries.values() if hasattr(library, what) for e in getattr(library, what)(z)]
    return [e for e in entries if not (quick and e.name.endswith(QUICK_LEAVES_OUT))]


def ticker(progress: Progress, bar: object, what: str) -> Callable[[str], None]:
    """What moves a progress bar on."""

    def tick(name: str) -> None:
        progress.update(bar, description=f"{what}: {name}", advance=1)  # type: ignore[arg-type]

    return tick


def base(timings: dict[str, Timing], kind: str) -> Timing:
    """Whom the entries of a kind are compared with: the first of this library's, SRCKFB unless it is an EKF."""
    wanted = "sigmax EKF" if kind == "EKF" else "sigmax SRCKFB"
    return next(t for name, t in timings.items() if name.startswith(wanted))


def discipline(what: str, timings: dict[str, Timing], tracks: int, rounds: int) -> Section:
    """Absolute times beside ratios."""
    rows = []
    steps = LIVE_STEPS if what == "live" else STEPS
    for name, timing in timings.items():
        own = base(timings, timing.entry.kind)
        times = f"{ratio(timing, own)} × {own.entry.name.split()[1].rstrip(',')}" if timing is not own else "1"
        each = spread(timing.seconds * 1e6 / steps / (tracks if what == "batch" else 1))
        rows.append(
            (name, str(each), times, f"{np.median(timing.cores):.1f}", f"{timing.first:.2f}", timing.entry.gives)
        )
    unit = "µs per track and step" if what == "batch" else "µs per step"
    note = (
        f"Median (least–greatest) of {rounds} rounds, {steps} steps a track. A filter without a like is compared with "
        "SRCKFB; above 1 is slower. First call: compilation included, where there is one."
    )
    columns = ("", unit, "time, in this library's", "cores busy", "first call, s", "returns")
    return Section(TITLES[what].format(tracks=tracks), note, columns, rows)


def fresh_section(processes: dict[str, Process], rounds: int) -> Section:
    """Time to first result."""
    rows = []
    for library, process in processes.items():

        def part(name: str, process: Process = process) -> str:
            return f"{np.median([told[name] for told in process.told]):.2f}"

        again = f"{np.median([told['second run'] for told in process.told]) * 1e3:.1f}"
        name = str(process.told[0]["filter"])
        assert name.startswith(LIBRARIES[library.split(",")[0]])
        name += ", compiled before" * (library == CACHED)
        rows.append((name, str(spread(process.seconds)), part("import"), part("first run"), again))
    note = (
        f"A new process that imports the library and filters one track; median (least–greatest) of {rounds}. "
        "Compiled before: the steps of the filter are in the cache on disk, which for the line above is empty."
    )
    return Section(
        "Time to first result", note, ("", "whole process, s", "import, s", "first run, s", "second run, ms"), rows
    )


def answer_section(answers: dict[str, Answers]) -> Section:
    """What everybody computed."""
    rows = []
    for what, seen in answers.items():
        for answer in seen.seen:
            same = "–" if answer.reference == answer.entry.name else f"{answer.apart:.1e} from {answer.reference}"
            verdict = "as it should" if answer.good else "NOT THE SAME"
            rows.append((what, answer.entry.name, f"{answer.rmse:.2f}", same, verdict))
    note = (
        f"Filters of one kind must agree to {TOLERANCE:.0e} of a standard deviation in every mean and covariance of "
        f"every track and step; all must be as far from the truth, to a factor of {RMSE_FACTOR}."
    )
    return Section("The answers", note, ("", "", "position RMSE, m", "largest difference, σ", ""), rows)


def main(
    page: Annotated[
        Path | None, typer.Option("--write", help="Put the tables between the markers of this page.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer tracks and rounds: under a minute, rougher.")] = False,
) -> None:
    """Measure everything in one run and print it."""
    console, plan, tracks = Console(), QUICK if quick else FULL, 1024 if quick else 4096
    if not console.is_terminal:
        console = Console(width=160)
    load_average = os.getloadavg()[0]
    libraries = load(console)
    data, one = record(tracks), record(1, LIVE_STEPS)
    tasks = {
        "batch": data,
        "offline": Record(data.truth[0], data.z[0]),
        "live": Record(one.truth[0], one.z[0]),
    }
    results, answers = {}, {}
    columns = SpinnerColumn(), TextColumn("{task.description:60}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console) as progress:
        for what in TITLES:
            answers[what] = Answers(tasks[what].truth)
            entries = taking_part(what, libraries, tasks[what].z, quick)
            results[what] = timed(what, entries, plan[what], answers[what], progress)
        bar = progress.add_task("one core", total=yardsticks.LINES * (plan["core"][0] + 1))
        core = yardsticks.per_core(data.z, *plan["core"], ticker(progress, bar, "one core"))
        for name, means in core.means.items():
            entry = Entry(name, "CKF", "mean", lambda means=means: Estimate(means, None))
            answers["batch"].look(entry, entry.run())
        rounds = plan["first"][0]
        bar = progress.add_task("fresh", total=rounds * (len(libraries) + 1))
        processes = first_results(list(libraries), rounds, ticker(progress, bar, "fresh process"))
        bar = progress.add_task("help", total=plan["help"][0])
        help_seconds = help_text(plan["help"][0], ticker(progress, bar, "help"))
    sections = [
        targets(results, core.seconds, processes, help_seconds),
        *(discipline(what, results[what], tracks, plan[what][0]) for what in TITLES),
        yardsticks.section(core, tracks, plan["core"][0]),
        fresh_section(processes, rounds),
        answer_section(answers),
        Section("The machine", "", ("", ""), description(load_average)),
    ]
    for section in sections:
        show(section, console)
    if page is not None:
        command = "python benchmarks/speed.py" + " --quick" * quick + f" --write {page}"
        write(page, "\n".join([f"Made by `{command}`.", "", *map(markdown, sections)]))
        console.print(f"written to {page}")
    wrong = [answer.entry.name for seen in answers.values() for answer in seen.seen if not answer.good]
    if wrong:
        console.print(f"[red]not the same answer as the others: {', '.join(wrong)}[/]")
        sys.exit(1)


if __name__ == "__main__":
    typer.run(main)
