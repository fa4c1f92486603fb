"""What all figures share: colours, times, numbers for JSON, and how many of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from sigmax.records import Outcome, Record
from sigmax.records.units import ANGLE, TURN_RATE, Dimension
from sigmax.running import Result

Figure = dict[str, Any]
# A filter on the page: the number of its colour, its label, what came of it.
Shown = tuple[int, str, Outcome]

INK, MUTED, TRUTH = "#1f2933", "#6b7785", "#9aa5b1"
# Distinct also to eyes that do not tell red from green (after Okabe and Ito).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#b8860b", "#56b4e9", "#117733", "#882255")
# Points a series may have on the page, and all series of one kind together.
_POINTS, _ALL_POINTS = 1200, 120_000


def colour(index: int) -> str:
    """The colour of the index-th filter."""
    return COLOURS[index % len(COLOURS)]


def limit(series: int) -> int:
    """How many points each of so many series may have."""
    return max(60, min(_POINTS, _ALL_POINTS // max(series, 1)))


def pale(shade: str, strength: float = 0.16) -> str:
    """The same colour, to be seen through."""
    red, green, blue = (int(shade[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{strength})"


def shown_in(dimension: Dimension) -> tuple[float, str]:
    """Factor and unit for people: degrees for angles, SI for the rest."""
    if dimension in (ANGLE, TURN_RATE):
        return 180 / np.pi, "°" if dimension == ANGLE else "°/s"
    return 1.0, dimension.symbol


def times(record: Record, track: int, rows: np.ndarray) -> list[Any]:
    """Times of a track for an axis."""
    return moments(record, record.time[track, rows])


def moments(record: Record, seconds: np.ndarray) -> list[Any]:
    """Seconds of a record for an axis: as they are, or as instants in UTC."""
    if record.epoch is None:
        return plain(seconds)
    moments = record.epoch + pd.to_timedelta(np.round(seconds * 1e9).astype("int64"), unit="ns")
    return [moment.isoformat() for moment in moments.tz_localize(None)]


def time_title(record: Record) -> str:
    """The title of a time axis."""
    return "time [s]" if record.epoch is None else "time (UTC)"


def line(name: str, x: Any, y: Any, shade: str, width: float, opacity: float = 1.0) -> Figure:
    """A line through points."""
    line = {"color": shade, "width": width}
    at = x if isinstance(x, list) else plain(x)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": safe(name),
        "x": at,
        "y": plain(y),
        "line": line,
        "opacity": opacity,
    }


def result_of(outcome: Outcome) -> Result:
    """The result of an outcome that has one."""
    assert outcome.result is not None
    return outcome.result


def joined(pieces: Sequence[np.ndarray]) -> np.ndarray:
    """Pieces one after another with a gap between them."""
    return np.concatenate([part for piece in pieces for part in (piece, [np.nan])])[:-1]


def plain(values: Any) -> list[float | None]:
    """Numbers for JSON, eight digits, null for NaN."""
    return [float(f"{v:.8g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def safe(text: str) -> str:
    """Text that plotly.js does not take for markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
