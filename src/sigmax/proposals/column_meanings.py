"""What the columns of a table are likely to mean, from their names and from how their numbers change."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from sigmax.files.table import Table

# No clock has counted so many seconds since 1970 yet.
LATEST = 1e11
# Of a count since 1970 in an unknown unit: nanoseconds of the units, and the dates that it may be of.
_UNITS = (10**9, 10**6, 10**3, 1)
_BETWEEN = pd.Timestamp("1990-01-01", tz="UTC"), pd.Timestamp("2100-01-01", tz="UTC")
# So many times smaller the steps of a target must be than those from one target to another.
_CLEARLY = 5.0


def epoch_unit(largest: float) -> str:
    """The unit of a count since 1970 by its size."""
    return "s" if largest <= LATEST else "ms" if largest < 1e14 else "us" if largest < 1e17 else "ns"


def counted_since_1970(time: np.ndarray, unit: float | None) -> tuple[np.ndarray, pd.Timestamp] | None:
    """Seconds since the first of times that count since 1970, and that instant; None where they do not.

    Args:
        time: as it stands in the table.
        unit: seconds of its unit; None where it is not told, and is that by which all times are of 1990 to 2100.
    """
    for nanoseconds in _UNITS if unit is None else (round(unit * 1e9),):
        low, high = (moment.value / max(nanoseconds, 1) for moment in _BETWEEN)
        if len(time) and low <= time.min() and time.max() <= high:
            first = time.min()
            # A float64 has no room for nanoseconds of today: differences are taken before anything is multiplied.
            return (time - first) * (nanoseconds * 1e-9), pd.Timestamp(
                int(first) * nanoseconds, tz="UTC"
            ) + pd.Timedelta(round((first - int(first)) * nanoseconds), unit="ns")
    return None


def speeds(place: np.ndarray, time: np.ndarray, rows: Sequence[np.ndarray]) -> np.ndarray:
    """Speeds from each whole position (T, d) of a track to its next at another time, m/s."""
    found = []
    for r in rows:
        whole = r[~np.isnan(place[r]).any(1)]
        elapsed, moved = np.diff(time[whole]), np.linalg.norm(np.diff(place[whole], axis=0), axis=1)
        found.append(moved[elapsed > 0] / elapsed[elapsed > 0])
    return np.concatenate(found) if found else np.zeros(0)


def steps(place: np.ndarray, time: np.ndarray, labels: "pd.Series[str] | None") -> float:
    """The median distance from a whole position to the next of the same label in time."""
    codes = np.zeros(len(time), int) if labels is None else pd.factorize(labels)[0]
    order = np.lexsort((np.arange(len(time)), time, codes))
    order = order[~np.isnan(place[order]).any(1)]
    same = np.diff(codes[order]) == 0
    moved = np.linalg.norm(np.diff(place[order], axis=0), axis=1)[same]
    return float(np.median(moved)) if len(moved) else np.inf


def likely_track(table: Table, time: np.ndarray, place: np.ndarray, names: Sequence[str] | None = None) -> str | None:
    """The column by which positions (T, d) fall into paths that hang together; None where there is no such column."""
    alone = steps(place, time, None)
    best: tuple[float, str] | None = None
    for name in table.names if names is None else names:
        labels = labels_of(table, name)
        distinct = labels.nunique()
        if not 1 < distinct <= len(labels) // 2 or not np.isfinite(alone):
            continue
        parted = steps(place, time, labels)
        if parted * _CLEARLY < alone and (best is None or parted < best[0]):
            best = parted, name
    return None if best is None else best[1]


def labels_of(table: Table, name: str) -> "pd.Series[str]":
    """A column as text without blanks around it; none where it is empty."""
    text = table.column(name).astype("string").str.strip()
    return text.mask(text == "")
