"""The components over time, with what the filter claims."""

import numpy as np

from sigmax.records import Outcome, Record
from sigmax.reports.component_estimates import component_estimates
from sigmax.reports.figures.draw import INK, Figure, colour, pale, plain, result_of, safe, shown_in, time_title, times
from sigmax.views.thin import thin


def component_figure(record: Record, outcome: Outcome, track: int, index: int, points: int) -> Figure:
    """Each component over time for one filter and track: its error where there is truth, else itself, with ±2σ."""
    result, T = result_of(outcome), int(record.steps[track])
    rows = list(component_estimates(record, result))
    n = len(rows)
    gap = 0.045
    height = (1 - gap * (n - 1)) / n
    data: list[Figure] = []
    layout: Figure = {"height": 60 + 150 * n, "showlegend": False}
    for i, one in enumerate(rows):
        factor, unit = shown_in(one.dimension)
        mean, deviation, error = (a[track, :T] for a in (one.mean, one.deviation, one.error))
        known = not np.isnan(error).all()
        # An angle on its own runs on over ±π.
        alone = np.unwrap(mean) if one.angular else mean
        value, middle = (error, np.zeros(T)) if known else (alone, alone)
        at = thin(value, points)
        x = times(record, track, at)
        low, high = (factor * (middle + s * deviation)[at] for s in (-2, 2))
        axis = "" if i == 0 else str(i + 1)
        axes = {"xaxis": "x", "yaxis": f"y{axis}"}
        band = {"type": "scatter", "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "x": x, **axes}
        data.append(band | {"y": plain(low)})
        data.append(band | {"y": plain(high), "fill": "tonexty", "fillcolor": pale(colour(index))})
        line = {"color": colour(index), "width": 1.3}
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": x,
                "y": plain(factor * value[at]),
                "line": line,
                "name": safe(one.name),
                **axes,
            }
        )
        top = 1 - i * (height + gap)
        title = safe(f"{'error of ' if known else ''}{one.name}{f' [{unit}]' if unit else ''}")
        ticks = {"exponentformat": "none", "separatethousands": True}
        shown = {"domain": [max(top - height, 0), top], "range": _range(low, high, factor * value)}
        layout[f"yaxis{axis}"] = shown | ticks
        layout.setdefault("annotations", []).append(
            {
                "text": title,
                "xref": "paper",
                "yref": "paper",
                "x": 0,
                "y": top,
                "xanchor": "left",
                "yanchor": "bottom",
                "showarrow": False,
                "font": {"size": 12, "color": INK},
            }
        )
    layout["xaxis"] = {"title": {"text": time_title(record)}, "anchor": f"y{n if n > 1 else ''}"}
    return {"data": data, "layout": layout}


def _range(low: np.ndarray, high: np.ndarray, value: np.ndarray) -> list[float]:
    """An axis that shows the whole series and the band, but not the width of a wide prior."""
    reach = [np.nanmin(value), np.nanmax(value), *np.nanquantile(low, [0.05]), *np.nanquantile(high, [0.95])]
    margin = 0.06 * (max(reach) - min(reach)) or 1.0
    return [float(min(reach) - margin), float(max(reach) + margin)]
