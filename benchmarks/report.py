"""Tables, on the console and in Markdown."""

from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

BEGIN, END = "<!-- results: written by speed.py -->", "<!-- end of results -->"


class Section(NamedTuple):
    """A heading, a sentence, a table; the first column is text, the others are set to the right."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


def show(section: Section, console: Console) -> None:
    """Print a section."""
    table = Table(title=section.title, caption=section.note, title_justify="left", caption_justify="left")
    for k, column in enumerate(section.columns):
        table.add_column(column, justify="right" if _numeric(section, k) else "left", overflow="fold")
    for row in section.rows:
        table.add_row(*row)
    console.print(table, "")


def markdown(section: Section) -> str:
    """A section as Markdown."""
    rule = ["---:" if _numeric(section, k) else ":---" for k in range(len(section.columns))]
    lines = [f"| {' | '.join(cells)} |" for cells in (section.columns, rule, *section.rows)]
    note = [section.note, ""] if section.note else []
    return "\n".join([f"### {section.title}", "", *note, *lines, ""])


def _numeric(section: Section, column: int) -> bool:
    return bool(section.rows) and all(row[column][:1].isdigit() or row[column] in ("", "–") for row in section.rows)


def write(path: Path, text: str, begin: str = BEGIN, end: str = END) -> None:
    """Put `text` between two markers of a page.

    Raises:
        SystemExit: where the page has no markers.
    """
    page = path.read_text(encoding="utf-8")
    if begin not in page or end not in page:
        raise SystemExit(f"{path} has no lines {begin!r} and {end!r} to write between; add them")
    head, rest = page.split(begin, 1)
    tail = rest.split(end, 1)[1]
    path.write_text(f"{head}{begin}\n\n{text}\n{end}{tail}", encoding="utf-8")
