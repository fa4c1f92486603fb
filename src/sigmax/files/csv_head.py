"""How a text file of a table begins: comments, the names of its columns, what parts them."""

import csv
import gzip
import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

from sigmax.errors import InputError

_DELIMITERS = ",;\t|"
_COMMENTS = ("#", "%", "//")
_LONGEST = 1 << 20


class Head(NamedTuple):
    """The names of the columns, what parts them (" " for any blanks), how many lines there are before the first row."""

    names: list[str]
    delimiter: str
    lines: int


def head_of(path: Path, names: Sequence[str] = ()) -> Head:
    """The head of a text file; a comment with as many names as the first row has numbers is its header, too.

    Args:
        path: the file, packed by gzip or not.
        names: of its columns, where it has no header.

    Raises:
        InputError: for a file that is empty, no text in UTF-8, or without names.
    """
    try:
        with _opened(path) as file:
            found = _head(path, file, list(names))
    except UnicodeDecodeError as error:
        raise InputError(f"{path.name} is no text in UTF-8 ({error.reason}); save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise InputError(f"{path.name} has no header line that can be read: {error}") from error
    check_names(path, found.names)
    return found


def _opened(path: Path) -> IO[str]:
    if path.suffix.casefold() == ".gz":
        return gzip.open(path, "rt", encoding="utf-8-sig", newline="")
    return path.open(encoding="utf-8-sig", newline="")


def _head(path: Path, file: IO[str], given: list[str]) -> Head:
    before, first, comment = 0, file.readline(_LONGEST), ""
    # A line for Excel, blank ones, and comments.
    while first and (not first.strip() or is_comment(first) or first.strip().casefold().startswith("sep=")):
        comment = first if is_comment(first) else comment
        before, first = before + 1, file.readline(_LONGEST)
    if "\0" in first or "\0" in comment:
        raise InputError(f"{path.name} is no text; save it as CSV in UTF-8")
    if given:
        return Head(given, _delimiter(first), before)
    if comment and (found := _named_by(comment, first)):
        return found._replace(lines=before)
    if not first.strip():
        raise InputError(f"{path.name} is empty; it needs a header line with the names of its columns")
    delimiter = _delimiter(first)
    if delimiter == " ":
        return Head(first.split(), delimiter, before + 1)
    # A name in quotation marks may go over several lines.
    rows = csv.reader(itertools.chain([first], file), delimiter=delimiter)
    return Head([name.strip() for name in next(rows)], delimiter, before + rows.line_num)


def _named_by(comment: str, first: str) -> Head | None:
    """The head where a comment names the columns of the first row, which has numbers."""
    delimiter = _delimiter(first if first.strip() else comment)
    bare = comment.strip().lstrip("#%/") if delimiter == " " else comment.strip()
    names = bare.split() if delimiter == " " else [name.strip() for name in bare.split(delimiter)]
    row = first.split() if delimiter == " " else first.strip().split(delimiter)
    if len(names) < 2 or (first.strip() and (len(row) != len(names) or not any(map(_is_number, row)))):
        return None
    return Head(names, delimiter, 0)


def _delimiter(line: str) -> str:
    """The sign that parts a line most often; blanks where there is none."""
    best = max(_DELIMITERS, key=line.count)
    return best if best in line or len(line.split()) < 2 else " "


def is_comment(line: str) -> bool:
    """Whether a line is meant for people alone."""
    return line.lstrip().startswith(_COMMENTS)


def tabulated(path: Path, lines: int) -> tuple[io.BytesIO, list[int]]:
    """A file whose columns are parted by any blanks, behind its first lines, with tabs in their place.

    Comments and empty lines are dropped; their numbers are the second.
    """
    kept, dropped = [], []
    with _opened(path) as file:
        for number, line in enumerate(itertools.islice(file, lines, None), lines + 1):
            if line.strip() and not is_comment(line):
                kept.append("\t".join(line.split()))
            else:
                dropped.append(number)
    return io.BytesIO("\n".join(kept).encode()), dropped


def check_names(path: Path, names: Sequence[str]) -> None:
    """Refuse names of columns that are none.

    Raises:
        InputError: for a name that is there twice, and for numbers in the place of names.
    """
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path.name} has two columns {twice!r}; give each a name of its own")
    if all(_is_number(name) for name in names):
        raise InputError(
            f"{path.name} begins with numbers; it needs a header line with the names of its columns, or in the "
            'description header = ["time", "x", …]'
        )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
