"""Files of data to tables: CSV and Parquet."""

import csv
import gzip
import itertools
from pathlib import Path
from typing import Any, NamedTuple

from sigmax.errors import InputError
from sigmax.records.memory import check_room
from sigmax.records.table import Table

_DELIMITERS = ",;\t|"
_PARQUET = (".parquet", ".pq")
_TABLES = (".csv", ".tsv", ".csv.gz", ".tsv.gz", *_PARQUET)
# What may be a table where a description says so.
_OTHER = (".txt", ".dat", ".txt.gz", ".dat.gz")
# Room that a file takes: text and its numbers by the byte; a column of numbers, its copies and its estimates.
_BY_BYTE, _PACKED, _BY_NUMBER = 6, 8, 48
_LONGEST = 1 << 20


def is_table(path: Path) -> bool:
    """Whether a file is surely one of data, by its name."""
    return path.name.casefold().endswith(_TABLES)


def read_table(path: Path, *, lenient: bool = False, decimal: str = ".") -> Table:
    """A text file with a header line (CSV and the like) or a Parquet file; `lenient` leaves out rows of another length.

    Raises:
        InputError: for a file that is missing, empty, cut off, too large for the memory, or otherwise unreadable.
    """
    if not path.name.casefold().endswith((*_TABLES, *_OTHER)):
        what = "an Excel workbook; save it as CSV" if path.suffix.casefold() in (".xlsx", ".xls") else "another"
        raise InputError(f"{path.name}: data must be a .csv or a .parquet file; this is {what}")
    if path.is_dir():
        raise InputError(f"{path} is a folder; data must be a .csv or a .parquet file")
    if not path.is_file():
        beside = [p.name for p in path.parent.glob("*") if is_table(p)] if path.parent.is_dir() else []
        raise InputError(
            f"there is no file {path}" + (f"; beside it lie {', '.join(sorted(beside))}" if beside else "")
        )
    reader = _read_parquet if path.suffix.casefold() in _PARQUET else _read_csv
    try:
        table = reader(path, lenient, decimal)
    except (OSError, EOFError) as error:
        raise InputError(f"{path.name} cannot be read: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path.name} needs more memory than there is; split it into parts") from error
    if not len(table):
        raise InputError(f"{path.name} has no rows of data")
    return table


class _Head(NamedTuple):
    """The names of the columns, what parts them, and how many lines there are before the first row."""

    names: list[str]
    delimiter: str
    lines: int


def _head(path: Path) -> _Head:
    opened = gzip.open if path.suffix.casefold() == ".gz" else open
    try:
        with opened(path, "rt", encoding="utf-8-sig", newline="") as file:
            before, first = 0, file.readline(_LONGEST)
            if first.strip().casefold().startswith("sep="):
                # A line for Excel.
                before, first = 1, file.readline(_LONGEST)
            if not first.strip():
                raise InputError(f"{path.name} is empty; it needs a header line with the names of its columns")
            if "\0" in first:
                raise InputError(f"{path.name} is no text; save it as CSV in UTF-8")
            delimiter = max(_DELIMITERS, key=first.count)
            # A name in quotation marks may go over several lines.
            rows = csv.reader(itertools.chain([first], file), delimiter=delimiter)
            names = [name.strip() for name in next(rows)]
    except UnicodeDecodeError as error:
        raise InputError(f"{path.name} is no text in UTF-8 ({error.reason}); save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise InputError(f"{path.name} has no header line that can be read: {error}") from error
    _check_names(path, names)
    return _Head(names, delimiter, before + rows.line_num)


def _check_names(path: Path, names: list[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path.name} has two columns {twice!r}; give each a name of its own")
    if all(_is_number(name) for name in names):
        raise InputError(f"{path.name} begins with numbers; it needs a header line with the names of its columns")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_csv(path: Path, lenient: bool, decimal: str) -> Table:
    import pyarrow as pa
    from pyarrow import csv as reader

    packed = _PACKED if path.suffix.casefold() == ".gz" else 1
    check_room(path.name, path.stat().st_size * packed * _BY_BYTE, f"{path.stat().st_size / 1e9:.1f} GB")
    head = _head(path)
    ragged: list[str] = []

    def left_out(row: Any) -> str:
        ragged.append(f"row of {row.actual_columns} columns: {row.text}")
        return "skip"

    parsed = reader.ParseOptions(
        delimiter=head.delimiter, newlines_in_values=True, invalid_row_handler=left_out if lenient else None
    )
    try:
        # Text throughout: what is a number is decided where the row can be quoted.
        read = reader.read_csv(
            str(path),
            read_options=reader.ReadOptions(column_names=head.names, skip_rows=head.lines, use_threads=False),
            parse_options=parsed,
            convert_options=reader.ConvertOptions(column_types=dict.fromkeys(head.names, pa.string())),
        )
    except pa.ArrowInvalid as error:
        reason = str(error).removeprefix("CSV parse error: ")
        if reason == "Empty CSV file" or reason.startswith("Could not skip initial"):
            raise InputError(f"{path.name} has a header line and no rows of data") from error
        if "UTF8" in reason:
            raise InputError(f"{path.name} is no text in UTF-8 ({reason}); save it as CSV in UTF-8") from error
        if "straddling" in reason:
            raise InputError(
                f"{path.name} has a row without end: a quotation mark may be missing ({reason})"
            ) from error
        raise InputError(
            f"{path.name} is ragged or cut off: {reason}; every row needs the {len(head.names)} columns of the header"
        ) from error
    return Table(path, read.to_pandas(), head.lines + 1, tuple(ragged), decimal)


def _read_parquet(path: Path, lenient: bool, decimal: str) -> Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            about = file.metadata
        check_room(path.name, about.num_rows * about.num_columns * _BY_NUMBER, f"{about.num_rows:,} rows")
        # An index of pandas is a column like any other.
        read = parquet.read_table(path).to_pandas(ignore_metadata=True)
    except (pa.ArrowException, OSError, KeyError) as error:
        if isinstance(error, MemoryError):
            raise
        reason = (str(error).split(". ")[0].splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{path.name} is not a whole Parquet file ({reason}); it may have been cut off while it was written: "
            "write it again"
        ) from error
    read.columns = read.columns.map(str)
    _check_names(path, [*read.columns, ""])
    return Table(path, read, 1, (), decimal)
