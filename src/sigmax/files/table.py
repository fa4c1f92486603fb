"""Columns of a table as numbers, times and names, with errors that quote row and value."""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.errors import InputError, unknown

_EMPTY = {"", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "nat", "null", "none", "-", "--"}
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}((\.\d{3})+,\d*|(,\d{3})+\.\d*|(\.\d{3}){2,}|(,\d{3}){2,}|([' ]\d{3})+[.,]?\d*)")
_ISO = "seconds, or a timestamp such as 2024-05-01T12:00:00.5Z"


@dataclass(frozen=True)
class Table:
    """The columns of a file.

    Attributes:
        path: the file.
        columns: by name, as pandas holds them; those of a CSV file are text.
        first_row: the number by which a reader finds the first row of data: 2 below a header line.
        ragged: rows of another length that were left out, quoted.
        decimal: the sign before the decimals of numbers that are text, a point or a comma.
        notes: what a reader of the results should know of how it was read.
        left_out: numbers of rows, for people, that were left out before.
        label: what a row that was joined from several files is called, by its index.
    """

    path: Path
    columns: pd.DataFrame
    first_row: int
    ragged: tuple[str, ...] = ()
    decimal: str = "."
    notes: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()
    label: Callable[[int], str] | None = None

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(map(str, self.columns))

    def row(self, index: int) -> int | str:
        """The number of a row for people; of several files, with the name of its own."""
        if self.label is not None:
            return self.label(index)
        number = index + self.first_row
        for skipped in self.left_out:
            number += skipped <= number
        return number

    def column(self, name: str) -> "pd.Series[Any]":
        """A column.

        Raises:
            InputError: where there is none of this name, with the nearest ones.
        """
        if name not in self.columns:
            raise InputError(f"{self.path.name}: {unknown('column', name, self.names)}")
        return self.columns[name]

    def numbers(self, name: str, missing: Sequence[float] = ()) -> np.ndarray:
        """A column as floats, NaN where it is empty or one of those that mean `missing`.

        Raises:
            InputError: for text where a number belongs and for infinities, with row and value.
        """
        values, wrong = self._parsed(name, missing)
        self._refuse(name, wrong, "where a number belongs; correct it, or leave it empty if it is missing")
        self._refuse(name, np.isinf(values), "which is not finite; leave it empty if it is missing")
        return values

    def _parsed(self, name: str, missing: Sequence[float] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Floats, NaN where there is none, and where text stands in the place of a number."""
        series = self.column(name)
        if isinstance(series.dtype, pd.CategoricalDtype):
            series = series.astype(series.cat.categories.dtype)
        if pd.api.types.is_bool_dtype(series) or not (
            pd.api.types.is_numeric_dtype(series) or pd.api.types.is_string_dtype(series) or series.dtype == object
        ):
            raise InputError(f"{self.path.name}: column {name!r} holds {series.dtype}, numbers belong there")
        if pd.api.types.is_complex_dtype(series):
            raise InputError(f"{self.path.name}: column {name!r} holds complex numbers, real ones belong there")
        if pd.api.types.is_numeric_dtype(series):
            values, wrong = series.to_numpy(float, na_value=np.nan), np.zeros(len(series), bool)
        else:
            values, wrong = self._from_text(series)
        return np.where(np.isin(values, missing), np.nan, values), wrong

    def _from_text(self, series: "pd.Series[Any]") -> tuple[np.ndarray, np.ndarray]:
        text = series.astype("string").str.strip()
        if self.decimal == ",":
            text = text.str.replace(".", "x", regex=False).str.replace(",", ".", regex=False)
        values = pd.to_numeric(text, errors="coerce").to_numpy(float, na_value=np.nan)
        return values, np.isnan(values) & ~(text.isna() | text.str.casefold().isin(_EMPTY)).to_numpy(bool)

    def readable(self, numbers: Collection[str], time: str, format: str = "") -> tuple["Table", tuple[str, ...]]:
        """The rows whose numbers and time can be read, and the others quoted.

        Raises:
            InputError: where there is no such column.
        """
        wrong = np.zeros(len(self), bool)
        for name in numbers:
            values, text = self._parsed(name)
            wrong |= text | np.isinf(values)
        if self._counts(time, format):
            values, text = self._parsed(time)
            wrong |= ~np.isfinite(values)
        else:
            wrong |= self._moments(time, format).isna().to_numpy(bool)
        shown = [f"row {self.row(int(i))}: {','.join(map(str, self.columns.iloc[i]))}" for i in np.flatnonzero(wrong)]
        return replace(self, columns=self.columns[~wrong].reset_index(drop=True), ragged=()), (*self.ragged, *shown)

    def times(self, name: str, format: str = "") -> tuple[np.ndarray, pd.Timestamp | None]:
        """A column as numbers as they stand and None; or of dates, as seconds since the first, and that.

        Dates without a zone are in UTC. They are written as ISO 8601 has it, or as `format` says (see strftime).
        Times of day without a date count on: one that falls by more than half a day is of the next day.

        Raises:
            InputError: for what is neither, and for a row without time.
        """
        series = self.column(name)
        if pd.api.types.is_timedelta64_dtype(series):
            values = series.dt.total_seconds().to_numpy(float)
        elif self._counts(name, format):
            values = self.numbers(name)
        else:
            moments = self._moments(name, format)
            example = f"a date such as {pd.Timestamp(0).strftime(format)}" if format else _ISO
            self._refuse(name, moments.isna().to_numpy(bool), f"where a time belongs: {example}")
            nanoseconds = moments.to_numpy("datetime64[ns]").astype(np.int64)
            if period := clock_period(format):
                nanoseconds = _counting_on(nanoseconds, period * 10**9)
            return (nanoseconds - nanoseconds.min()) * 1e-9, pd.Timestamp(int(nanoseconds.min()), tz="UTC")
        self._refuse(name, np.isnan(values), "where a time belongs; every row needs one")
        return values, None

    def _counts(self, name: str, format: str) -> bool:
        """Whether a column of times holds numbers rather than dates."""
        series = self.column(name)
        if pd.api.types.is_numeric_dtype(series) or format:
            return not format
        dates = pd.api.types.is_datetime64_any_dtype(series)
        return not dates and bool(np.isfinite(self._parsed(name)[0]).any())

    def _moments(self, name: str, format: str) -> "pd.Series[pd.Timestamp]":
        """The instants of a column of dates, none where it has something else."""
        series = self.column(name)
        if not pd.api.types.is_datetime64_any_dtype(series):
            series = series.astype("string").str.strip()
        try:
            return pd.to_datetime(series, errors="coerce", utc=True, format=format or "ISO8601")
        except ValueError as error:
            raise InputError(f"the format {format!r} of the time: {error}") from error

    def _refuse(self, name: str, wrong: np.ndarray, why: str) -> None:
        if wrong.any():
            index = int(np.flatnonzero(wrong)[0])
            value = self.columns[name].iloc[index]
            more = f" (and {wrong.sum() - 1} more rows like it)" if wrong.sum() > 1 else ""
            empty = value is None or (pd.api.types.is_scalar(value) and pd.isna(value)) or str(value).strip() == ""
            shown = "nothing" if empty else repr(value)
            if self.decimal == "." and isinstance(value, str) and _DECIMAL_COMMA.fullmatch(value.strip()):
                why = f'{why}. If its comma is a decimal one, write decimal = "," at the top of the description'
            if isinstance(value, str) and is_grouped(value.strip()):
                why += grouped_hint(value.strip())
            raise InputError(f"{self.path.name}, row {self.row(index)}: column {name!r} has {shown} {why}{more}")


def is_grouped(text: str) -> bool:
    """Whether a text is a number with a sign between its thousands, such as 1.234,5 or 1,234.5."""
    return _GROUPED.fullmatch(text) is not None


def grouped_hint(text: str) -> str:
    """What to do about it."""
    comma = "," in text and text.rfind(",") > text.rfind(".") and text.count(",") == 1
    more = ', and the decimal comma is said by decimal = ","' if comma else ""
    return f": no sign may stand between thousands{more}; write {_plain(text)} for it"


def _plain(text: str) -> str:
    decimal = max(text.rfind("."), text.rfind(","))
    if decimal >= 0 and text.count(text[decimal]) > 1:
        decimal = -1
    keep = [c for k, c in enumerate(text) if c.isdigit() or c in "+-" or k == decimal]
    return "".join(keep)


def clock_period(format: str) -> int:
    """Seconds after which a time of this format comes again, as 86400 of a time of day; 0 where it has a date."""
    if not format or re.search("%[-#]?[bBcdDeFgGhjmsxyY]", format):
        return 0
    has = set(re.findall("%[-#]?([A-Za-z])", format))
    if has & {"H", "T", "R", "X", "r", "k"} or has >= {"I", "p"}:
        return 86400
    return 43200 if "I" in has else 3600 if "M" in has else 60


def _counting_on(clock: np.ndarray, period: int) -> np.ndarray:
    """Times of a clock that begins anew, as times that go on.

    One that falls by more than half a period is of the next. One that rises by so much goes back to the period before,
    as a late row and the beginning of another track do, unless that would be well before the first row.
    """
    steps = np.zeros(len(clock), np.int64)
    lap = 0
    for row in np.flatnonzero(np.abs(np.diff(clock)) > period // 2) + 1:
        if clock[row] < clock[row - 1]:
            steps[row] = 1
        elif lap and clock[row] + (lap - 1) * period >= clock[0] - period // 4:
            steps[row] = -1
        lap += steps[row]
    return clock + np.cumsum(steps) * period
