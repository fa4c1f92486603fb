"""`sigmax compare`."""

from collections.abc import Sequence
from pathlib import Path

import joblib
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from sigmax.cli.progress import progress_on
from sigmax.errors import InputError
from sigmax.reports.comparison import Standing, Word, files, standings, verdict, write
from sigmax.reports.comparison.verdict import times
from sigmax.reports.folder import check_folder
from sigmax.reports.verdict import significant
from sigmax.studies import Comparison, compare, load_studies
from sigmax.studies.load import parsed_filters
from sigmax.studies.progress import FILE


def compare_study(
    name: str,
    filters: Sequence[str],
    runs: int | None,
    seed: int,
    out: Path | None,
    options: Sequence[str],
    particles: int | None,
    show: Sequence[int],
    workers: int | None,
    chunk: int,
    cluster: str | None,
) -> None:
    """Load the study, run it, write the folder, print what it says.

    Raises:
        InputError: before anything runs, for whatever does not fit.
        SystemExit: with status 1 where no filter could be run.
    """
    console, errors = Console(), Console(stderr=True)
    with errors.status("reading the study"):
        studies = load_studies(name, _options(options))
        asked = [name for text in filters for name in text.split()]
        chosen = [parsed_filters(asked, study) if asked else dict(study.filters) for study in studies]
    folder = out if out is not None else Path("runs") / (studies[0].name if len(studies) == 1 else name)
    names = [study.name for study in studies]
    check_folder(folder, files(names), FILE if len(studies) == 1 else "summary.json")
    done: list[Comparison] = []
    with progress_on(errors) as progress, _on(cluster, workers):
        task = progress.add_task("", total=None)
        for study, these in zip(studies, chosen, strict=True):

            def report(what: str, made: int, of: int, title: str = study.name) -> None:
                progress.update(task, description=escape(f"{title}: {what}"), completed=made, total=of)

            done.append(
                compare(
                    study,
                    these,
                    runs=runs,
                    seed=seed,
                    particles=particles,
                    show=show,
                    workers=workers,
                    chunk=chunk,
                    folder=folder if len(studies) == 1 else folder / study.name,
                    report=report,
                )
            )
        progress.update(task, description="writing the report", completed=0, total=None)
        write(folder, done)
    for c in done:
        for note in c.notes:
            errors.print(escape(f"{c.study.name}: {note}"), highlight=False, soft_wrap=True)
        _print(console, c)
    console.print(f"\nReport: {escape(str(folder / 'report.html'))}", highlight=False, soft_wrap=True)
    if not any(c.measures for c in done):
        raise SystemExit(1)


def _on(cluster: str | None, workers: int | None) -> joblib.parallel_config:
    """What joblib is told of the workers."""
    if cluster is None:
        return joblib.parallel_config(n_jobs=workers or -1)
    try:
        if cluster == "ray":
            import ray
            from ray.util.joblib import register_ray

            # Joins the cluster of RAY_ADDRESS or one of this machine, and starts one where there is none.
            if not ray.is_initialized():
                ray.init(include_dashboard=False, log_to_driver=False, logging_level="ERROR")
            register_ray()
        if cluster == "dask":
            from distributed import Client

            # Without an address a cluster of this machine; with one in the environment, that one.
            Client()
        return joblib.parallel_config(backend=cluster, n_jobs=workers or -1)
    except ImportError as error:
        raise InputError(f"--cluster {cluster} needs a package that is not installed: {error}") from error
    except (ValueError, OSError, RuntimeError) as error:
        raise InputError(f"--cluster {cluster}: {error}") from error


def _options(texts: Sequence[str]) -> dict[str, str]:
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise InputError(f"--set {text!r} should be option=value, as in --set p0=literal")
        found[key.strip()] = value.strip()
    return found


def _print(console: Console, c: Comparison) -> None:
    found = standings(c)
    console.print(comparison_table(c, found, console.width))
    if any(s.outside is not None for s in found):
        console.print(_OUTSIDE, style="dim", highlight=False)
    headline, sentences = verdict(c)
    console.print(f"\n[bold]{escape(headline)}[/bold]", highlight=False)
    for sentence in sentences:
        console.print(escape(sentence), highlight=False)


_OUTSIDE = (
    "outside 95%: how often the truth is outside of the claimed 95 % region, averaged over time, for the whole state "
    "or the component where that is worst; 5 % is honest"
)
# What a narrow terminal has no room for, first to last; names are folded before that.
_DISPENSABLE = ("cost/EKF", "median", "lost", "outside 95%", "RMSE")
_NAME = 8


def comparison_table(c: Comparison, found: Sequence[Standing], width: int) -> Table:
    """The filters of a study with numbers and verdicts; what has no room in this width is left out and named."""
    to = "optimum" if c.optimum is not None else "best"
    heads = ["RMSE", "median", "cost/EKF", "lost", "outside 95%", "verdict"]
    cells = [dict(zip(heads, _cells(s, c), strict=True)) for s in found]
    shown = {head: f"RMSE/{to}" if head == "RMSE" else head for head in heads}
    room = width - min(_NAME, max(len(s.name) for s in found))
    plain = [{h: Text.from_markup(text).plain for h, text in row.items()} for row in (shown, *cells)]
    columns = {h: max(cell_len(row[h]) for row in plain) for h in heads}
    left_out = []
    for head in _DISPENSABLE:
        if sum(columns.values()) + len(columns) > room:
            left_out.append(shown[head])
            del columns[head]
    table = Table(
        box=None,
        pad_edge=False,
        collapse_padding=True,
        header_style="bold",
        title=escape(f"{c.study.title or c.study.name}, {c.runs:,} runs"),
        title_justify="left",
        title_style="bold",
        caption=f"In a wider terminal, and on the page: {', '.join(left_out)}" if left_out else None,
        caption_justify="left",
    )
    table.add_column("filter", overflow="fold")
    for head in columns:
        table.add_column(shown[head], justify="left" if head == "verdict" else "right", no_wrap=True)
    for s, row in zip(found, cells, strict=True):
        table.add_row(escape(s.name), *(row[head] for head in columns))
    return table


_COLOUR = {Word.SOUND: "green", Word.NOT_JUDGED: "default", Word.CAUTIOUS: "yellow", Word.UNKNOWN: "yellow"}


def _cells(s: Standing, c: Comparison) -> list[str]:
    word = f"[{_COLOUR.get(s.word, 'red')}]{s.word.value}[/]"
    if s.failure:
        return [*["–"] * 5, word]
    return [
        times(s.distance),
        times(s.middle),
        "–" if s.cost is None else significant(s.cost),
        f"{s.lost} of {int(c.sums[s.name].runs)}",
        "–" if s.outside is None else f"{s.outside:.0%}",
        word,
    ]
