"""Reading CSV and Parquet: columns as numbers, times and names, with errors that quote row and value."""

import csv
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.errors import InputError, unknown

_EMPTY = {"", "nan", "na", "n/a", "null", "none"}
_DELIMITERS = ",;\t"


@dataclass(frozen=True)
class Table:
    """The columns of a file.

    Attributes:
        path: the file.
        columns: by name, as pandas holds them; those of a CSV file are text.
        first_row: the number by which a reader finds the first row of data: 2 below a header line.
        ragged: rows of another length that were left out, quoted.
    """

    path: Path
    columns: pd.DataFrame
    first_row: int
    ragged: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.columns)

    def row(self, index: int) -> int:
        """The number of a row for people."""
        return index + self.first_row

    def column(self, name: str) -> "pd.Series[Any]":
        """A column.

        Raises:
            InputError: where there is none of this name, with the nearest ones.
        """
        if name not in self.columns:
            raise InputError(f"{self.path.name}: {unknown('column', name, map(str, self.columns))}")
        return self.columns[name]

    def numbers(self, name: str) -> np.ndarray:
        """A column as floats, NaN where it is empty.

        Raises:
            InputError: for text where a number belongs and for infinities, with row and value.
        """
        values, wrong = self._parsed(name)
        self._refuse(name, wrong, "where a number belongs; correct it, or leave it empty if it is missing")
        self._refuse(name, np.isinf(values), "which is not finite; leave it empty if it is missing")
        return values

    def _parsed(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Floats, NaN where there is none, and where text stands in the place of a number."""
        series = self.column(name)
        if pd.api.types.is_bool_dtype(series) or not (
            pd.api.types.is_numeric_dtype(series) or pd.api.types.is_string_dtype(series) or series.dtype == object
        ):
            raise InputError(f"{self.path.name}: column {name!r} holds {series.dtype}, numbers belong there")
        if pd.api.types.is_numeric_dtype(series):
            return series.to_numpy(float, na_value=np.nan), np.zeros(len(series), bool)
        stripped = series.astype("string").str.strip()
        values = pd.to_numeric(stripped, errors="coerce").to_numpy(float, na_value=np.nan)
        return values, np.isnan(values) & ~(stripped.isna() | stripped.str.casefold().isin(_EMPTY)).to_numpy(bool)

    def readable(self, numbers: Collection[str], time: str) -> tuple["Table", tuple[str, ...]]:
        """The rows whose numbers and time can be read, and the others quoted.

        Raises:
            InputError: where there is no such column.
        """
        wrong = np.zeros(len(self), bool)
        for name in numbers:
            values, text = self._parsed(name)
            wrong |= text | np.isinf(values)
        series = self.column(time)
        as_number = pd.to_numeric(series, errors="coerce") if not pd.api.types.is_datetime64_any_dtype(series) else None
        if as_number is not None and as_number.notna().any():
            wrong |= ~np.isfinite(as_number.to_numpy(float, na_value=np.nan))
        else:
            wrong |= pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601").isna().to_numpy(bool)
        shown = [f"row {self.row(int(i))}: {','.join(map(str, self.columns.iloc[i]))}" for i in np.flatnonzero(wrong)]
        return Table(self.path, self.columns[~wrong].reset_index(drop=True), self.first_row), (*self.ragged, *shown)

    def times(self, name: str) -> tuple[np.ndarray, pd.Timestamp | None]:
        """A column as numbers as they stand and None; or of ISO timestamps, as seconds since the first, and that.

        Raises:
            InputError: for what is neither, and for a row without time.
        """
        series = self.column(name)
        if not pd.api.types.is_numeric_dtype(series):
            text = series.astype("string") if series.dtype == object else series
            numeric = (
                not pd.api.types.is_datetime64_any_dtype(series) and pd.to_numeric(text, errors="coerce").notna().any()
            )
            if not numeric:
                return self._instants(name, text)
        values = self.numbers(name)
        self._refuse(name, np.isnan(values), "where a time belongs; every row needs one")
        return values, None

    def _instants(self, name: str, series: "pd.Series[Any]") -> tuple[np.ndarray, pd.Timestamp]:
        moments = pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601")
        wrong = moments.isna().to_numpy(bool)
        self._refuse(name, wrong, "where a time belongs: seconds, or a timestamp such as 2024-05-01T12:00:00.5Z")
        nanoseconds = moments.to_numpy("datetime64[ns]").astype(np.int64)
        return (nanoseconds - nanoseconds.min()) * 1e-9, moments.min()

    def _refuse(self, name: str, wrong: np.ndarray, why: str) -> None:
        if wrong.any():
            index = int(np.flatnonzero(wrong)[0])
            value = self.columns[name].iloc[index]
            more = f" (and {wrong.sum() - 1} more rows like it)" if wrong.sum() > 1 else ""
            shown = "nothing" if pd.isna(value) or value == "" else repr(value)
            raise InputError(f"{self.path.name}, row {self.row(index)}: column {name!r} has {shown} {why}{more}")


def read_table(path: Path, *, lenient: bool = False) -> Table:
    """A .csv file (with a header line) or a .parquet file; `lenient` leaves out rows of another length.

    Raises:
        InputError: for a file that is missing, empty, cut off, or otherwise unreadable.
    """
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    reader = readers.get(path.suffix.casefold())
    if reader is None:
        raise InputError(f"{path.name}: data must be a .csv or a .parquet file")
    if not path.is_file():
        beside = (
            [p.name for p in path.parent.glob("*") if p.suffix.casefold() in readers] if path.parent.is_dir() else []
        )
        raise InputError(
            f"there is no file {path}" + (f"; beside it lie {', '.join(sorted(beside))}" if beside else "")
        )
    try:
        table = reader(path, lenient)
    except OSError as error:
        raise InputError(f"{path.name} cannot be read: {error}") from error
    if not len(table):
        raise InputError(f"{path.name} has no rows of data")
    return table


def _read_csv(path: Path, lenient: bool) -> Table:
    import pyarrow as pa
    from pyarrow import csv as reader

    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            first = file.readline()
    except UnicodeDecodeError as error:
        raise InputError(f"{path.name} is no text in UTF-8 ({error.reason}); save it as CSV in UTF-8") from error
    if not first.strip():
        raise InputError(f"{path.name} is empty; it needs a header line with the names of its columns")
    delimiter = max(_DELIMITERS, key=first.count)
    names = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path.name} has two columns {twice!r}; give each a name of its own")
    ragged: list[str] = []

    def left_out(row: Any) -> str:
        ragged.append(f"row of {row.actual_columns} columns: {row.text}")
        return "skip"

    try:
        # Text throughout: what is a number is decided where the row can be quoted.
        read = reader.read_csv(
            path,
            read_options=reader.ReadOptions(column_names=names, skip_rows=1, use_threads=False),
            parse_options=reader.ParseOptions(delimiter=delimiter, invalid_row_handler=left_out if lenient else None),
            convert_options=reader.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
    except pa.ArrowInvalid as error:
        reason = str(error).removeprefix("CSV parse error: ")
        if reason == "Empty CSV file":
            raise InputError(f"{path.name} has a header line and no rows of data") from error
        raise InputError(
            f"{path.name} is ragged or cut off: {reason}; every row needs the {len(names)} columns of the header"
        ) from error
    return Table(path, read.to_pandas(), 2, tuple(ragged))


def _read_parquet(path: Path, lenient: bool) -> Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        read = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        reason = str(error).split(". ")[0].splitlines()[0]
        raise InputError(
            f"{path.name} is not a whole Parquet file ({reason}); it may have been cut off while it was written: "
            "write it again"
        ) from error
    return Table(path, read.to_pandas(), first_row=1)
