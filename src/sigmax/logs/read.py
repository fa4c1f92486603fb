"""A log as tables by name: of topics, messages, groups, whatever its format has."""

import importlib
import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sigmax.errors import InputError
from sigmax.logs.formats import Format

if TYPE_CHECKING:
    import pandas as pd


class Log(NamedTuple):
    """What a log holds.

    Attributes:
        tables: by name; where a format has its own times they are the column `time`.
        notes: what a reader of the results should know, such as lines that were left out.
    """

    tables: "Mapping[str, pd.DataFrame]"
    notes: tuple[str, ...] = ()


def read_log(path: Path, format: Format) -> Log:
    """The tables of a log that have rows.

    Raises:
        InputError: for a package that is missing, a file that is empty, cut off or of another format, no rows.
    """
    missing = [pip for name, pip in format.packages if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"{path.name}: reading {format.name} takes {' and '.join(missing)}; install it with: "
            f'pip install "sigmax[logs]", or pip install {" ".join(missing)}'
        )
    if path.is_file() and not path.stat().st_size:
        raise InputError(f"{path.name} is empty")
    reader = importlib.import_module(f"{__package__}.{format.module}")
    try:
        log: Log = reader.tables(path)
    except (InputError, MemoryError):
        raise
    # The packages answer damaged files with errors of every kind.
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise InputError(
            f"{path.name} is not a whole file of {format.name} ({reason}); it may have been cut off while it was "
            "written, or be of another format"
        ) from error
    kept = {name: table for name, table in log.tables.items() if len(table)}
    if not kept:
        notes = f": {log.notes[0]}" if log.notes else ""
        raise InputError(f"{path.name} has no rows of data{notes}")
    return Log(kept, log.notes)
