"""`sigmax fit`."""

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sigmax.cli.descriptions import Beside
from sigmax.corrections.fit_numbers import RecordFit, fit_numbers
from sigmax.corrections.fit_toml import fitted
from sigmax.reports.fit_page import FILES, HEADS, in_numbers, rows, verdict, write_fit
from sigmax.reports.folder import check_folder

_FITTED = Beside("fitted", "fit")


def fit_records(
    names: Sequence[str],
    free: Sequence[str],
    filter: str | None,
    hold_out: float,
    by_em: bool,
    as_json: bool,
    write: bool,
    out: Path | None,
) -> None:
    """Fit numbers of records and print them; write the page, and descriptions with them, if wished.

    Raises:
        InputError: for whatever is not known, is no record, or would be written over.
        SystemExit: with 1 where a number is not determined.
    """
    console, errors = Console(), Console(stderr=True)
    targets = {name: _FITTED.target(name) for name in names} if write else {}
    if out is not None:
        check_folder(out, FILES)
    with errors.status("reading the record") as status:

        def say(done: str) -> None:
            status.update(escape(f"fitting, {done}"))

        made = fit_numbers(names, free, filter=filter, hold_out=hold_out, by_em=by_em, progress=say)
    if as_json:
        print(json.dumps(in_numbers(made), indent=2, allow_nan=False))
    else:
        _print(console, made)
    if out is not None:
        write_fit(out, made)
        errors.print(escape(f"written: {out / 'report.html'}"), highlight=False, soft_wrap=True)
    values = {n: (float(made.fit.parameters[n.name]), float(made.fit.std[n.name])) for n in made.numbers}
    for name, target in targets.items():
        path = Path(name)
        _FITTED.write(path, target, fitted(path, made.trial, values), errors)
    raise SystemExit(made.fit.status)


def _print(console: Console, made: RecordFit) -> None:
    fit = made.fit
    listed = ", ".join(record.title for record in made.records)
    shown = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0))
    for head in HEADS:
        shown.add_column(head)
    for n, (name, before, now) in zip(made.numbers, rows(made), strict=True):
        kind = " (factor of variances)" if n.kind == "factor" else ""
        shown.add_row(escape(f"{name}{kind}"), before, escape(now))
    console.print(f"[bold]{escape(listed)}[/]\nby {escape(fit.filter)}", highlight=False, soft_wrap=True)
    console.print(shown)
    headline, sentences = verdict(fit)
    correlated = [f"Correlated: {said}." for said in fit.correlated()]
    for sentence in (headline, *sentences, *correlated):
        console.print(escape(sentence), highlight=False, soft_wrap=True)
