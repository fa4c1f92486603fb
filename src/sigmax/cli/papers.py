"""`sigmax papers`."""

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from sigmax.papers import PAPERS, rows


def print_papers() -> None:
    """The papers by name."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("name", no_wrap=True)
    table.add_column("paper")
    table.add_column("rows", justify="right")
    for name, paper in PAPERS.items():
        table.add_row(name, paper, str(len(rows(name))))
    Console().print(table)


def print_paper(name: str) -> None:
    """One paper, row by row.

    Raises:
        InputError: for a paper that is not known.
    """
    console = Console(highlight=False)
    found = rows(name)
    console.print(PAPERS[name.casefold()], style="bold")
    for row in found:
        console.print(f"\n{escape(row.row)}", style="bold")
        # In lines of their own, however long: they are there to be copied.
        for line in row.commands or [row.how]:
            console.print(f"  {escape(line)}", style="cyan", soft_wrap=True)
        console.print(Padding(escape(row.verdict.replace("**", "").replace("`", "")), (0, 0, 0, 2)))
