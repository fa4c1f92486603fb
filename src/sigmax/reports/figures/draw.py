"""What all figures share: colours, times, numbers for JSON, and how many of them."""

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from sigmax.files.units import ANGLE, TURN_RATE, Dimension
from sigmax.records import Outcome, Record
from sigmax.running import Result

Figure = dict[str, Any]
# A filter on the page: the number of its colour, its label, what came of it.
Shown = tuple[int, str, Outcome]

INK, MUTED, TRUTH = "#1f2933", "#6b7785", "#9aa5b1"
# Distinct also to eyes that do not tell red from green (after Okabe and Ito).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#b8860b", "#56b4e9", "#117733", "#882255")
# Values this many times farther from 0 than they are wide are drawn from an origin of their own.
_FAR = 20.0
# Seconds that are those since 1970: from 2001 to 2099.
_UNIX = (1e9, 4.1e9)
# Points a series may have on the page, and all series of one kind together.
_POINTS, _ALL_POINTS = 1200, 120_000


def colour(index: int) -> str:
    """The colour of the index-th filter."""
    return COLOURS[index % len(COLOURS)]


def between(index: int, part: float) -> str:
    """A colour from light (part 0) to dark (1), green, blue or red by the index."""
    red, green, blue = colorsys.hls_to_rgb((0.36, 0.58, 0.0)[index % 3], 0.8 - 0.6 * part, 0.65)
    return "#" + "".join(f"{round(255 * v):02x}" for v in (red, green, blue))


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
    """Seconds of a record for an axis: since its start where that is far from 0, or as instants in UTC."""
    epoch = _epoch(record)
    if epoch is None:
        return plain(np.asarray(seconds) - _start(record))
    # Of the seconds since 1970 a float holds a quarter of a microsecond.
    moments = epoch + pd.to_timedelta(np.round(np.asarray(seconds) * 1e6).astype("int64"), unit="us")
    return [moment.isoformat() for moment in moments.tz_localize(None)]


def time_title(record: Record) -> str:
    """The title of a time axis."""
    if _epoch(record) is not None:
        return "time (UTC)"
    start = _start(record)
    return "time [s]" if start == 0 else f"time since {start:.15g} s [s]"


def _epoch(record: Record) -> pd.Timestamp | None:
    """The instant of time 0: as the record has it, or 1970 where its times can be nothing else."""
    if record.epoch is not None:
        return record.epoch
    times = record.time[record.real]
    return pd.Timestamp(0, tz="UTC") if times.size and _UNIX[0] <= times.min() <= times.max() <= _UNIX[1] else None


def _start(record: Record) -> float:
    """What is taken off times so that they can be read, 0 where they can be read as they are."""
    times = record.time[record.real]
    return origin_of(times) if times.size else 0.0


def origin_of(values: np.ndarray) -> float:
    """A round number near values that lie close together far from 0, else 0: what they are drawn from."""
    shown = np.asarray(values, float)
    shown = shown[np.isfinite(shown)]
    if not len(shown):
        return 0.0
    low, span = float(shown.min()), float(np.ptp(shown))
    if abs(low) < _FAR * max(span, 1e-9):
        return 0.0
    unit = 10.0 ** np.ceil(np.log10(max(span, abs(low) * 1e-9)))
    return float(np.floor(low / unit) * unit)


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
    """Numbers for JSON, null for NaN: with eight digits, and as many more as tell a millionth of their span."""
    numbers = np.asarray(values, float)
    shown = np.isfinite(numbers)
    size = np.abs(numbers[shown])
    digits = np.full(len(size), 8)
    if len(size) and (span := float(np.ptp(numbers[shown]))) > 0:
        more = np.ceil(np.log10(np.maximum(size, 1e-300)) - np.log10(span)) + 6
        digits = np.clip(more, 8, 17).astype(int)
    texts = iter(f"{v:.{d}g}" for v, d in zip(numbers[shown], digits, strict=True))
    return [float(next(texts)) if known else None for known in shown]


def safe(text: str) -> str:
    """Text that plotly.js does not take for markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
