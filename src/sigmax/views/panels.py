"""What a picture of estimates shows, for any library that draws."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.views.series import Series
from sigmax.views.thin import thin

# NIS below it is drawn there.
_LEAST = 0.01
# Names of two components of a position, the one that is drawn to the right first.
_POSITIONS = (
    ("east", "north"),
    ("x", "y"),
    ("px", "py"),
    ("pos_x", "pos_y"),
    ("lon", "lat"),
    ("longitude", "latitude"),
)


class Line(NamedTuple):
    """A line of a panel.

    Attributes:
        name: of the line.
        x: (N,).
        y: (N,), NaN where it is interrupted.
        low: (N,), the lower edge of a band about it, or None.
        high: the upper one.
        style: "line", "points", or "limit" for what others are held against.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    style: str = "line"


class Panel(NamedTuple):
    """One of the diagrams of a picture.

    Attributes:
        x: the title of its axis.
        y: the same.
        lines: what it shows.
        span: the range of y, or None for what the lines need.
        equal: whether both axes have one scale, as a map has.
        log: whether y has a scale of logarithms.
    """

    x: str
    y: str
    lines: tuple[Line, ...]
    span: tuple[float, float] | None = None
    equal: bool = False
    log: bool = False


def panels(series: Series, path: Sequence[str] | None, judged: bool, points: int = 1500) -> list[Panel]:
    """The path, each component with ±2σ, the NIS, probabilities of modes, found noises, of a series of one track.

    Args:
        series: the estimates.
        path: names of the two components of a position; None for such as are known by their names.
        judged: whether an honest filter's NIS is chi-square, so that it can be held against bounds.
        points: that a line may have; where it has more, those that stand out are kept.

    Raises:
        InputError: where `path` names what there is not.
    """
    title = "time (UTC)" if series.dated else "time [s]"
    time = series.time[0]
    found = [_path(series, *pair, points)] if (pair := _pair(series, path)) else []
    for name, values in series.numbers.items():
        y = np.unwrap(values[0]) if name in series.angles else values[0]
        wide = 2 * series.spread[name][0] if name in series.spread else None
        at = thin(y, points)
        band = (None, None) if wide is None else ((y - wide)[at], (y + wide)[at])
        span = None if wide is None else _span(y, wide)
        found.append(Panel(title, _labelled(series, name), (Line(name, time[at], y[at], *band),), span))
    if {"nis", "dof"} <= set(series.steps):
        found += _nis(series.steps["nis"][0], series.steps["dof"][0], time, title, judged, points)
    if series.modes:
        lines = tuple(Line(name, time[at], p[0][at]) for name, p in series.modes.items() for at in [thin(p[0], points)])
        found.append(Panel(title, "probability", lines, (-0.02, 1.02)))
    if series.noises:
        each = [(name, s[0], thin(np.log(s[0]), points)) for name, s in series.noises.items()]
        lines = tuple(Line(name, time[at], s[at]) for name, s, at in each)
        found.append(Panel(title, "variances of noises, times", lines, log=True))
    return found


def _labelled(series: Series, name: str) -> str:
    unit = series.units.get(name, "")
    return f"{name} [{unit}]" if unit else name


def _pair(series: Series, path: Sequence[str] | None) -> tuple[str, str] | None:
    if path is not None:
        if isinstance(path, str) or len(path) != 2:
            raise InputError(f"path must be two names, the one drawn to the right first; it is {path!r}")
        for name in path:
            if name not in series.numbers:
                raise unknown("component", name, series.numbers)
        return path[0], path[1]
    for a, b in _POSITIONS:
        for name in (n for n in series.numbers if n in series.places):
            stem, dot, last = name.rpartition(".")
            if last == a and stem + dot + b in series.places:
                return name, stem + dot + b
    return None


def _path(series: Series, a: str, b: str, points: int) -> Panel:
    x, y = series.numbers[a][0], series.numbers[b][0]
    at = np.union1d(thin(x, points // 2), thin(y, points // 2))
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    lines = [Line("path", x[at], y[at])]
    if len(known):
        lines.append(Line("last", x[known[-1:]], y[known[-1:]], style="points"))
    return Panel(_labelled(series, a), _labelled(series, b), tuple(lines), equal=True)


def _nis(nis: np.ndarray, dof: np.ndarray, time: np.ndarray, title: str, judged: bool, points: int) -> list[Panel]:
    from scipy.special import chdtri  # a fifth of the time of importing this package

    heard = np.flatnonzero((dof > 0) & np.isfinite(nis))
    if not len(heard):
        return []
    # By logarithms: the first of a record is often a hundred times the others.
    nis, dof, time = np.maximum(nis[heard], _LEAST), dof[heard], time[heard]
    at = thin(np.log(nis), points)
    limits = [Line("expected", time[at], dof[at].astype(float), style="limit")]
    if judged:
        limits.append(Line("97.5 of 100 below", time[at], chdtri(dof[at], 0.025), style="limit"))
    span = float(nis.min()) / 2, 2 * max(float(nis.max()), float(chdtri(dof, 0.025).max()))
    return [Panel(title, "NIS", (Line("NIS", time[at], nis[at], style="points"), *limits), span, log=True)]


def _span(y: np.ndarray, wide: np.ndarray) -> tuple[float, float] | None:
    """A range that shows the whole line and the band, but not the width of a wide prior."""
    known = np.isfinite(y) & np.isfinite(wide)
    if not known.any():
        return None
    y, wide = y[known], wide[known]
    low, high = min(y.min(), np.quantile(y - wide, 0.05)), max(y.max(), np.quantile(y + wide, 0.95))
    margin = 0.06 * (high - low) or 1e-6 * max(abs(high), 1.0)
    return float(low - margin), float(high + margin)
