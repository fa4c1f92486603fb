"""`sigmax filters` and `sigmax records`."""

from rich.console import Console
from rich.table import Table

from sigmax.filters import catalogue, get
from sigmax.records.load import builtin


def print_filters() -> None:
    """The catalogue as a table."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("name", "prediction", "correction", "form", "parameters", "what it is"):
        table.add_column(head, no_wrap=head == "name")
    for name, entry in catalogue().items():
        made = get(name)
        table.add_row(
            name, str(made.predict), str(made.correct), made.form.name, ", ".join(entry.parameters), entry.about
        )
    Console().print(table)


def print_records() -> None:
    """The built-in records as a table."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("name", no_wrap=True)
    table.add_column("what it is")
    for name, record in builtin().items():
        table.add_row(name, record.about)
    Console().print(table)
