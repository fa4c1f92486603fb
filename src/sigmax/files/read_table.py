"""Files of data to tables: CSV, Parquet, and logs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sigmax.errors import InputError, unknown
from sigmax.files.csv_head import check_names, head_of, is_comment, tabulated
from sigmax.files.description import Description
from sigmax.files.memory import check_room
from sigmax.files.table import Table
from sigmax.logs import FORMATS, Log, format_of, read_log

_PARQUET = (".parquet", ".pq")
_TABLES = (".csv", ".tsv", ".csv.gz", ".tsv.gz", *_PARQUET)
# What may be a table where a description says so.
_OTHER = (".txt", ".dat", ".txt.gz", ".dat.gz")
# Room that a file takes: text and its numbers by the byte, or a log; a column of numbers, its copies and estimates.
_BY_BYTE, _PACKED, _BY_NUMBER, _BY_BYTE_OF_LOG = 6, 8, 48, 12
# The tables of each log by their names.
Logs = dict[Path, dict[str, Table]]


def is_table(path: Path) -> bool:
    """Whether a file is surely one of data, by its name, or a log by how it begins."""
    return path.name.casefold().endswith(_TABLES) or format_of(path) is not None


def read_table(
    path: Path,
    *,
    table: str = "",
    lenient: bool = False,
    decimal: str = ".",
    header: Sequence[str] = (),
    logs: Logs | None = None,
) -> Table:
    """A text file with a header line (CSV and the like), a Parquet file, or a table of a log.

    Args:
        path: the file.
        table: its name in the log, where there are several.
        lenient: leaves out rows of another length.
        decimal: the sign before the decimals of numbers that are text.
        header: the names of the columns of a text file that does not begin with them.
        logs: those that were read before; a log that is not among them is added.

    Raises:
        InputError: for a file that is missing, empty, cut off, too large for the memory, or otherwise unreadable.
    """
    found = _read(path, lenient, decimal, header, {} if logs is None else logs)
    if table and table not in found:
        if len(found) == 1 and not format_of(path):
            raise InputError(f"{path.name} is one table without a name; drop table = {table!r}")
        raise InputError(f"{path.name}: {unknown('table', table, found)}")
    if not table and len(found) > 1:
        raise InputError(f'{path.name} has several tables; write which one, table = "…": {", ".join(found)}')
    return found[table] if table else next(iter(found.values()))


def read_tables(path: Path, *, decimal: str = ".") -> dict[str, Table]:
    """All tables of a file by their names; "" of one that has no name.

    Raises:
        InputError: as `read_table`.
    """
    return _read(path, False, decimal, (), {})


def _read(path: Path, lenient: bool, decimal: str, header: Sequence[str], logs: Logs) -> dict[str, Table]:
    if path in logs:
        return logs[path]
    format = format_of(path)
    if format is None:
        _check_is_table(path)
    elif path.is_dir() and format.module != "ros":
        raise InputError(f"{path} is a folder; data must be a file")
    if not path.exists():
        beside = [p.name for p in path.parent.glob("*") if is_table(p)] if path.parent.is_dir() else []
        raise InputError(
            f"there is no file {path}" + (f"; beside it lie {', '.join(sorted(beside))}" if beside else "")
        )
    try:
        if format is not None:
            check_room(path.name, path.stat().st_size * _BY_BYTE_OF_LOG, f"{path.stat().st_size / 1e9:.1f} GB")
            logs[path] = _of_log(path, read_log(path, format))
            return logs[path]
        reader = _read_parquet if path.suffix.casefold() in _PARQUET else _read_csv
        table = reader(path, lenient, decimal, header)
    except (OSError, EOFError) as error:
        raise InputError(f"{path.name} cannot be read: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path.name} needs more memory than there is; split it into parts") from error
    if not len(table):
        raise InputError(f"{path.name} has no rows of data")
    return {"": table}


def _check_is_table(path: Path) -> None:
    if not path.name.casefold().endswith((*_TABLES, *_OTHER)):
        what = "an Excel workbook; save it as CSV" if path.suffix.casefold() in (".xlsx", ".xls") else "another"
        logs = ", ".join(format.name for format in FORMATS)
        raise InputError(f"{path.name}: data must be a .csv or a .parquet file, or a log ({logs}); this is {what}")
    if path.is_dir():
        raise InputError(f"{path} is a folder; data must be a .csv or a .parquet file")


def _of_log(path: Path, log: Log) -> dict[str, Table]:
    for table in log.tables.values():
        table.columns = table.columns.map(str)
    return {name: Table(path, table, 1, notes=log.notes) for name, table in log.tables.items()}


def _read_csv(path: Path, lenient: bool, decimal: str, names: Sequence[str]) -> Table:
    import pyarrow as pa
    from pyarrow import csv as reader

    packed = _PACKED if path.suffix.casefold() == ".gz" else 1
    check_room(path.name, path.stat().st_size * packed * _BY_BYTE, f"{path.stat().st_size / 1e9:.1f} GB")
    head = head_of(path, names)
    ragged: list[str] = []
    comments: list[int] = []

    def left_out(row: Any) -> str:
        if is_comment(row.text):
            comments.append(int(row.number))
            return "skip"
        if lenient:
            ragged.append(f"row of {row.actual_columns} columns: {row.text}")
        return "skip" if lenient else "error"

    source: Any = str(path)
    skipped, delimiter = head.lines, head.delimiter
    if delimiter == " ":
        source, comments = tabulated(path, skipped)
        skipped, delimiter = 0, "\t"
    parsed = reader.ParseOptions(delimiter=delimiter, newlines_in_values=True, invalid_row_handler=left_out)
    try:
        # Text throughout: what is a number is decided where the row can be quoted.
        read = reader.read_csv(
            source,
            read_options=reader.ReadOptions(column_names=head.names, skip_rows=skipped, use_threads=False),
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
    return Table(path, read.to_pandas(), head.lines + 1, tuple(ragged), decimal, left_out=tuple(comments))


def _read_parquet(path: Path, lenient: bool, decimal: str, names: Sequence[str]) -> Table:
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
    check_names(path, [*read.columns, ""])
    return Table(path, read, 1, (), decimal)


def data_of(description: Description, folder: Path, *, lenient: bool = False, logs: Logs | None = None) -> Table:
    """The table that a description in a folder is of.

    Raises:
        InputError: as `read_table`.
    """
    return read_table(
        folder / description.data,
        table=description.table,
        lenient=lenient,
        decimal=description.decimal,
        header=description.header,
        logs=logs,
    )
