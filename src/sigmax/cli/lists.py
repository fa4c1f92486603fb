"""Commands that list what is built in: filters, records, models, studies."""

from rich.console import Console
from rich.table import Table

from sigmax.filters import WEIGHTS, catalogue, get
from sigmax.models.builtin import BUILTIN
from sigmax.records.load import builtin
from sigmax.studies.named import NAMED


def print_filters() -> None:
    """The catalogue as a table."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("name", "rules", "form", "what it is"):
        table.add_column(head, no_wrap=head == "name")
    for name, entry in catalogue().items():
        made = get(name)
        rules = dict.fromkeys(_short(rule) for rule in (made.predict, made.correct))
        parameters = f"; parameters {', '.join(entry.parameters)}" if entry.parameters else ""
        table.add_row(name, " × ".join(rules), made.form.name, entry.about + parameters)
    Console().print(table)
    Console().print(
        f"Every name takes update=…: once, iterated, {', '.join(WEIGHTS)}, as in SRCKFB:update=student.", style="dim"
    )


def _short(rule: object) -> str:
    """The name of a rule and what it was made with."""
    return str(rule).removeprefix("SigmaPoints(").removesuffix(")").removesuffix("(")


def print_records() -> None:
    """The built-in records as a table."""
    _print_about({name: record.about for name, record in builtin().items()})


def print_models() -> None:
    """The built-in models as a table."""
    _print_about({name: make().about for name, make in BUILTIN.items()})


def print_studies() -> None:
    """The named studies as a table."""
    _print_about({name: study.about for name, study in NAMED.items()})


def _print_about(lines: dict[str, str]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("name", no_wrap=True)
    table.add_column("what it is")
    for line in lines.items():
        table.add_row(*line)
    Console().print(table)
