"""`sigmax track` on plots without identities."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sigmax.errors import InputError
from sigmax.records import parse_trial
from sigmax.records.plots import PlotRecord
from sigmax.reports import check_folder
from sigmax.reports.tracking_outcome import TrackingOutcome
from sigmax.reports.tracks_folder import TRACK_FILES, write_tracks
from sigmax.reports.verdict import significant
from sigmax.tracking import Tracker


def track_plots(record: PlotRecord, filters: Sequence[str], out: Path | None) -> None:
    """Track, write and print.

    Raises:
        InputError: before the run, for whatever does not fit.
    """
    if len(filters) > 1:
        raise InputError(f"plots are tracked with one filter at a time; {len(filters)} are given")
    trial = parse_trial(filters[0] if filters else record.filter)
    if trial.fixed:
        raise InputError(f"{trial.name}: fixed= belongs to tracks with a prior, not to plots")
    if not record.scans:
        raise InputError(f"{record.name} has no plots")
    folder = out if out is not None else Path("runs") / record.name
    check_folder(folder, TRACK_FILES)
    cycle = record.cycle(trial.filter)
    tracker = Tracker(cycle, window=record.window)
    console, errors = Console(), Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task(escape(f"{record.name}: {trial.name}"), total=len(record.scans))
        started = time.perf_counter()
        for scan in record.scans:
            tracker.step(scan)
            progress.advance(task)
        seconds = time.perf_counter() - started
        if not tracker.history:
            raise InputError(f"none of the {len(record.scans)} scans could be taken: {dict(tracker.counts)}")
        run = TrackingOutcome(record, trial, cycle, tracker.history, tracker.counts, seconds)
        progress.update(task, description="writing the report")
        write_tracks(folder, run)
    _print(console, run)
    console.print(f"\nReport: {escape(str(folder / 'report.html'))}", highlight=False, soft_wrap=True)


def _print(console: Console, run: TrackingOutcome) -> None:
    record, q = run.record, run.quality
    if record.truth:
        shown = Table(box=None, pad_edge=False, header_style="bold", title=escape(record.title), title_justify="left")
        for head, side in (("target", "left"), ("RMSE", "right"), ("held", "right"), ("tracks", "right")):
            shown.add_column(head, justify=side)  # type: ignore[arg-type]
        for name, rmse in q.rmse.items():
            tracks = dict.fromkeys(i for _, i, _ in q.matched[name])
            error = "–" if np.isnan(rmse) else f"{significant(rmse)} m"
            shown.add_row(escape(name), error, f"{q.held[name]:.0%}", ", ".join(map(str, tracks)) or "–")
        if len(record.truth) <= 40:
            console.print(shown)
        console.print(
            f"\n{q.switches} switches between targets, {q.breaks} breaks, {q.false_tracks} false tracks "
            f"({significant(q.false_per_minute)} a minute)",
            highlight=False,
        )
    console.print(
        f"{len(run.confirmed)} confirmed tracks, {len(run.history)} scans, "
        f"{1e3 * run.seconds / max(len(run.history), 1):.1f} ms a scan",
        highlight=False,
    )
    for h in run.health:
        if h.words:
            console.print(f"[yellow]{escape(h.sensor or 'the sensor')}: {escape(h.words)}[/]", highlight=False)
    told = {k: v for k, v in run.counts.items() if k != "taken"}
    if told:
        console.print(f"scans: {', '.join(f'{v} {k}' for k, v in told.items())}", highlight=False)
    if record.skipped:
        console.print(f"{len(record.skipped)} rows could not be read and were skipped, such as", highlight=False)
        console.print(escape(f"  {record.skipped[0]}"), highlight=False)
