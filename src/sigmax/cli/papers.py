"""`sigmax papers`."""

from rich.console import Console
from rich.markup import escape
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
    found = rows(name)
    table = Table(pad_edge=False, header_style="bold", show_lines=True, title=PAPERS[name.casefold()])
    table.add_column("row of the paper", ratio=3)
    table.add_column("command or call", ratio=3, overflow="fold")
    table.add_column("verdict, with our figure", ratio=4)
    for row in found:
        table.add_row(
            escape(row.row), escape("\n".join(row.commands) or row.how), escape(row.verdict.replace("**", ""))
        )
    Console().print(table, highlight=False)
