"""The path: filters, truth, landmarks and ellipses."""

from collections.abc import Collection, Sequence

import numpy as np

from sigmax.files.frame import Placed
from sigmax.records import Backdrop, Record
from sigmax.reports.component_estimates import row_of
from sigmax.reports.figures.draw import (
    INK,
    MUTED,
    TRUTH,
    Figure,
    Shown,
    colour,
    joined,
    limit,
    line,
    origin_of,
    pale,
    plain,
    result_of,
    safe,
)
from sigmax.running import Result
from sigmax.spaces import in_world_axes
from sigmax.views.thin import stride

_ELLIPSES = 36
# Ellipses are drawn as polygons of so many points.
_CORNERS = 32
_KILOMETRES_FROM = 20_000.0
# Heights on the page.
_CELLS = 20_000


def path_figure(record: Record, ran: Sequence[Shown], advised: int, apart: Collection[int]) -> Figure | None:
    """The paths of all filters with truth, landmarks and the 2σ ellipses of the advised filter.

    `ran` holds colour number, label and outcome; the advised one and those `apart` are shown at once,
    the others when they are asked for. None where the position has fewer than two components.
    """
    if len(record.position) < 2:
        return None
    a, b = record.position[:2]
    # Maps have north above.
    if record.placed is not None:
        a, b = record.placed.at[:2]
    elif [str(record.model.state[i]) for i in (a, b)] == ["north", "east"]:
        a, b = b, a
    names = [str(record.model.state[i]) for i in (a, b)]
    backdrop = record.backdrop
    offset = np.zeros(1) if backdrop is None else backdrop.offset

    origin = {a: 0.0, b: 0.0}
    if backdrop is None:
        means = [result_of(o).mean[record.real] for _, _, o in ran]
        origin = {i: origin_of(np.concatenate([mean[:, i] for mean in means])) for i in (a, b)}

    def placed(values: np.ndarray, component: int) -> np.ndarray:
        """A component of positions (B, T, n) where it is drawn."""
        where = record.position.index(component)
        moved = values[..., component] - origin[component]
        return moved if backdrop is None else moved + offset[..., where]

    if backdrop is not None:
        names = ["east", "north"]
    points = limit(len(ran) * len(record.tracks))
    rows = [(k, stride(int(n), points)) for k, n in enumerate(record.steps)]
    extent = max(float(np.ptp(placed(result_of(o).mean, i)[record.real])) for _, _, o in ran for i in (a, b))
    scale, unit = (1e-3, "km") if extent > _KILOMETRES_FROM else (1.0, "m")
    data: list[Figure] = []
    if backdrop is not None:
        data.append(_heights(backdrop, scale))
        x, y = (joined([offset[k, r, j] * scale for k, r in rows]) for j in (0, 1))
        data.append(
            line(backdrop.label, x, y, MUTED, width=1.5) | {"line": {"color": INK, "width": 1.5, "dash": "dot"}}
        )
    if not np.isnan(record.truth[..., [a, b]]).all():
        x, y = (joined([placed(record.truth, i)[k, r] * scale for k, r in rows]) for i in (a, b))
        data.append(line("truth", x, y, TRUTH, width=4, opacity=0.6))
    for index, label, outcome in sorted(ran, key=lambda one: one[0] == advised):
        mean = result_of(outcome).mean
        x, y = (joined([placed(mean, i)[k, r] * scale for k, r in rows]) for i in (a, b))
        drawn = line(label, x, y, colour(index), *((1.8, 1.0) if index == advised else (1.0, 0.75)))
        # Filters that agree would lie on top of one another.
        if record.placed is not None:
            drawn |= _places_to_show(record.placed, mean, rows)
        data.append(drawn if index == advised or index in apart else drawn | {"visible": "legendonly"})
    for index, label, outcome in ran:
        if index == advised:
            x, y = _ellipses(record, result_of(outcome), (a, b), np.array([origin[a], origin[b]]), scale)
            outline = line(f"2σ of {label}", x, y, INK, width=1.2)
            data.append(outline | {"hoverinfo": "skip", "fill": "toself", "fillcolor": pale(colour(index), 0.35)})
    if record.landmarks:
        swapped = ((1, a), (0, b)) if record.position[0] == b else ((0, a), (1, b))
        at = [[(place[i] - origin[j]) * scale for place in record.landmarks.values()] for i, j in swapped]
        data.append(
            {
                "type": "scatter",
                "mode": "markers+text",
                "name": "landmarks",
                "x": plain(at[0]),
                "y": plain(at[1]),
                "text": [safe(name) for name in record.landmarks],
                "textposition": "top center",
                "textfont": {"color": MUTED, "size": 11},
                "cliponaxis": False,
                "marker": {"symbol": "triangle-up", "size": 11, "color": INK},
                "hoverinfo": "text",
                "showlegend": False,
            }
        )
    return {
        "data": data,
        "layout": {
            "xaxis": {"title": {"text": _titled(names[0], origin[a], unit)}},
            "yaxis": {"title": {"text": _titled(names[1], origin[b], unit)}, "scaleanchor": "x", "scaleratio": 1},
            "height": 560,
        },
    }


def _places_to_show(placed: Placed, mean: np.ndarray, rows: Sequence[tuple[int, np.ndarray]]) -> Figure:
    """What the pointer shows of each point: latitude and longitude."""
    degrees = np.degrees(placed.places(mean)[..., :2])
    texts = [[f"{lat:.6f}°, {lon:.6f}°" for lat, lon in degrees[k, r].tolist()] for k, r in rows]
    told = [text for track in texts for text in (*track, "")][:-1]
    return {"text": told, "hovertemplate": "%{text}<br>%{x:.1f}, %{y:.1f}"}


def _titled(name: str, origin: float, unit: str) -> str:
    """The title of an axis, with what is taken off its values."""
    taken = f" {'−' if origin > 0 else '+'} {abs(origin):,.0f} m" if origin else ""
    return safe(f"{name}{taken} [{unit}]")


def _heights(backdrop: Backdrop, scale: float) -> Figure:
    """The map as a picture of heights, thinned to what a page can hold."""
    step = max(1, round(float(np.sqrt(backdrop.heights.size / _CELLS))))
    shown = backdrop.heights[::step, ::step]
    along = [backdrop.origin[k] + backdrop.spacing[k] * step * np.arange(shown.shape[1 - k]) for k in (0, 1)]
    return {
        "type": "heatmap",
        "x": plain(along[0] * scale),
        "y": plain(along[1] * scale),
        "z": [plain(np.round(row)) for row in shown],
        "colorscale": [[0, "#dfe8d5"], [0.35, "#c9c79c"], [0.7, "#b59a6d"], [1, "#f4f1ea"]],
        "colorbar": {"title": {"text": "height [m]"}, "thickness": 12, "x": 1.02},
        "hovertemplate": "%{z:.0f} m<extra></extra>",
        "name": "height",
        "showlegend": False,
    }


def _ellipses(
    record: Record, result: Result, places: tuple[int, int], origin: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Outlines of the 2σ ellipses along all tracks."""
    each = max(3, _ELLIPSES // len(record.tracks))
    shown = range(min(len(record.tracks), 4 * _ELLIPSES))
    turn = np.linspace(0, 2 * np.pi, _CORNERS)
    circle = 2 * np.stack([np.cos(turn), np.sin(turn)])
    outlines = []
    space, mean, factor = record.model.space, np.asarray(result.mean), np.asarray(result.factor)
    rows = [row_of(record, place) for place in places]
    for k in shown:
        for step in stride(int(record.steps[k]), each):
            S = in_world_axes(space, mean[k, step], factor[k, step])[rows]
            values, vectors = np.linalg.eigh(S @ S.T)
            ellipse = (vectors * np.sqrt(np.maximum(values, 0))) @ circle
            centre = (result.mean[k, step][list(places)] - origin)[:, None]
            if record.backdrop is not None:
                centre = centre + record.backdrop.offset[k, step][:, None]
            outlines.append((centre + ellipse) * scale)
    return joined([o[0] for o in outlines]), joined([o[1] for o in outlines])
