"""`sigmax track`."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sigmax.cli import NO_RESULT, WRONG_INPUT
from sigmax.cli.doctor import examine_worst, no_tracks, proposal
from sigmax.cli.progress import progress_on
from sigmax.errors import InputError
from sigmax.files.read_table import is_table
from sigmax.proposals.suggest import propose
from sigmax.records import Outcome, Record, check, load, load_plots, parse_trial, robust_trial, track
from sigmax.records.beginning import WORDS, from_measurements
from sigmax.records.load import description_of
from sigmax.reports import Grade, Score, check_folder, grade, score, verdict, write
from sigmax.reports.verdict import best_of_heavy_tails, nis_in_words, significant

# Seconds of a run that is repeated to find robust updates.
_QUICK = 5.0
# The last places of so many tracks are told.
_PLACES = 5
_COLOUR = {Grade.CONSISTENT: "green"} | dict.fromkeys(
    (Grade.NEAR, Grade.HEAVY, Grade.CAUTIOUS, Grade.UNKNOWN), "yellow"
)


def track_record(
    name: str | Record,
    filters: Sequence[str],
    out: Path | None,
    data: Path | None = None,
    prior: str | None = None,
    examine: bool = False,
) -> None:
    """Load, check, run, examine the model if wished, write and print.

    Raises:
        InputError: before any filter runs, for whatever does not fit.
        SystemExit: with status 1 where every filter failed or broke down at every step.
    """
    console, errors = Console(), Console(stderr=True)
    if isinstance(name, str) and is_table(Path(name)):
        _propose(Path(name))
    trials = tuple(dict.fromkeys(parse_trial(text) for text in filters))
    with errors.status("reading the record"):
        plots = load_plots(name, data) if isinstance(name, str) else None
    if prior not in (None, WORDS):
        raise InputError(f"--prior says {WORDS!r}, or is left out; it is {prior!r}")
    if plots is not None:
        if prior is not None:
            raise InputError("--prior belongs to a record of tracks; plots begin tracks by themselves")
        if examine:
            raise no_tracks(str(name))
        from sigmax.cli.plots import track_plots

        track_plots(plots, filters, out)
        return
    with errors.status("reading the record"):
        record = load(name) if isinstance(name, str) else name
        if prior is not None:
            record = from_measurements(
                record, np.broadcast_to(record.prior.mean, (len(record.tracks), record.model.size))
            )
        trials = trials or record.trials
        folder = out if out is not None else Path("runs") / record.name
        check_folder(folder)
        check(record, trials)
    for doubt in record.doubts:
        errors.print(f"[yellow]{escape(doubt)}[/]", highlight=False, soft_wrap=True)
    outcomes: list[Outcome] = []
    with progress_on(errors) as progress:
        task = progress.add_task("", total=len(trials))
        for trial in trials:
            progress.update(task, description=escape(f"{record.name}: {record.label(trial)}"))
            outcomes.append(track(record, trial))
            progress.advance(task)
        scores = [score(record, outcome) for outcome in outcomes]
        heavy = best_of_heavy_tails(scores)
        if heavy is not None:
            progress.update(task, description="heavy tails: a robust update for each sensor")
            more = _robust(record, outcomes[scores.index(heavy)])
            if more is not None:
                outcomes.append(more[0])
                scores.append(more[1])
        examined = None
        if examine:
            progress.update(task, description="what is wrong with the model")
            examined = examine_worst(record, outcomes[: len(trials)], scores)
        progress.update(task, description="writing the report")
        if any(outcome.result is not None for outcome in outcomes):
            write(folder, record, outcomes, scores, examined)
    console.print(_table(record, scores))
    headline, sentences = verdict(scores)
    console.print(f"\n[bold]{escape(headline)}[/bold]", highlight=False)
    for sentence in sentences:
        console.print(escape(sentence), highlight=False)
    for sentence in _last_places(record, outcomes):
        console.print(escape(sentence), highlight=False)
    if examined is not None:
        of = f"{record.tracks[examined.track]}, " if len(record.tracks) > 1 else ""
        console.print(f"\n{escape(of)}{escape(repr(examined.examination))}", highlight=False, soft_wrap=True)
    elif examine:
        errors.print("the doctor knows neither this model nor these filters: nothing was examined", highlight=False)
    elif isinstance(name, str) and (command := proposal(name, prior, record, outcomes[: len(trials)], scores)):
        console.print(f"\nWhat is wrong with the model: {escape(command)}", highlight=False, soft_wrap=True)
    if any(outcome.result is not None for outcome in outcomes):
        console.print(f"\nReport: {escape(str(folder / 'report.html'))}", highlight=False, soft_wrap=True)
    if not any(_worked(record, outcome) for outcome in outcomes):
        errors.print("sigmax: no filter gave a result: none could correct with any measurement", highlight=False)
        raise SystemExit(NO_RESULT)


def _robust(record: Record, outcome: Outcome) -> tuple[Outcome, Score] | None:
    """The trial of an outcome with robust updates: if it runs quickly, and its covariance can be believed then."""
    trial = robust_trial(record, outcome.trial) if outcome.seconds < _QUICK else None
    if trial is None:
        return None
    found = track(record, trial)
    scored = score(record, found)
    return (found, scored) if grade(scored).believable else None


def _propose(path: Path) -> NoReturn:
    """Print a description of a file of data, and to standard error what it rests on.

    Raises:
        SystemExit: always; nothing was tracked.
    """
    toml, remarks = propose(path)
    print(toml, end="")
    beside = description_of(path)
    sentences = "".join(f"  {remark}\n" for remark in remarks)
    print(
        f"sigmax: {path} holds data; what is tracked is a short TOML file that says what they mean. The proposal above "
        f"goes to standard output:\n{sentences}"
        f"  To take it: sigmax track {shlex.quote(str(path))} > {shlex.quote(str(beside))}; correct it; "
        f"sigmax track {shlex.quote(str(beside))}",
        file=sys.stderr,
    )
    raise SystemExit(WRONG_INPUT)


def _last_places(record: Record, outcomes: Sequence[Outcome]) -> list[str]:
    """Where tracks end on the Earth, by the first filter that gave a result."""
    ran = next((outcome for outcome in outcomes if outcome.result is not None), None)
    if record.placed is None or ran is None or ran.result is None:
        return []
    ends = np.asarray(ran.result.mean)[np.arange(len(record.tracks)), record.steps - 1][:_PLACES]
    columns = record.placed.columns(ends)
    told = []
    for k, name in enumerate(record.tracks[:_PLACES]):
        lat, lon = (float(columns[angle][0][k]) for angle in ("latitude", "longitude"))
        height = f", {columns['height'][0][k]:.0f} m" if "height" in columns else ""
        told.append(f"{name}: {lat:.6f}°, {lon:.6f}°{height}")
    more = f"; and {len(record.tracks) - _PLACES} more" if len(record.tracks) > _PLACES else ""
    return [f"The last place by {ran.trial.name} of {'; '.join(told)}{more}."]


def _worked(record: Record, outcome: Outcome) -> bool:
    """Whether a filter corrected with a measurement anywhere, or none broke down for want of any."""
    if outcome.result is None:
        return False
    by_sensor = record.z.values() if isinstance(record.z, dict) else [record.z]
    measured = record.real & np.any([~np.isnan(z).all(-1) for z in by_sensor], axis=0)
    return bool(outcome.result.ok[measured].any() or outcome.result.ok[record.real].all())


def _table(record: Record, scores: Sequence[Score]) -> Table:
    truth = any(s.rmse_position_m is not None for s in scores)
    table = Table(
        box=None,
        pad_edge=False,
        collapse_padding=True,
        header_style="bold",
        title=escape(record.title),
        title_justify="left",
        title_style="bold",
    )
    table.add_column("filter", overflow="fold")
    faulty = any(s.faults for s in scores)
    for head in (*(("RMSE",) if truth else ()), "mean NIS", "expected", "run", *(("faults",) if faulty else ())):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("covariance")
    for s in scores:
        graded = grade(s)
        table.add_row(
            escape(s.label),
            *((_shown(s.rmse_position_m, "m"),) if truth else ()),
            *nis_in_words(s),
            _shown(s.seconds, "s", 2),
            *((str(s.faults),) if faulty else ()),
            f"[{_COLOUR.get(graded, 'red')}]{graded.value}[/]",
        )
    return table


def _shown(value: float | None, unit: str = "", digits: int = 3) -> str:
    return "–" if value is None else f"{significant(value, digits)} {unit}".strip()
