"""NIS against its bounds."""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from sigmax.records import Record
from sigmax.reports.figures.draw import MUTED, Figure, Shown, colour, limit, line, moments, plain, result_of, time_title
from sigmax.reports.weight_counts import judged_nis
from sigmax.views.thin import stride, thin


def nis_figure(record: Record, ran: Sequence[Shown]) -> tuple[Figure, int] | None:
    """NIS per measured component, averaged over a moving window, against its 95 % bounds; and the window's times."""
    data: list[Figure] = []
    bounds: Figure | None = None
    window, lowest, largest = 1, 1.0, 1.0
    for index, label, outcome in ran:
        result = result_of(outcome)
        heard = (result.dof > 0) & record.real
        if not heard.any():
            continue
        # Tracks and sensors that report at the same time are one.
        when, at = np.unique(record.time[heard], return_inverse=True)
        nis, dof = (np.bincount(at, v[heard].astype(float)) for v in (judged_nis(result), result.dof))
        window = max(len(when) // 40, min(10, len(when)))
        sums = [_moving(v, window) for v in (nis, dof)]
        y, when = sums[0] / sums[1], when[window - 1 :]
        lowest, largest = min(lowest, float(y[y > 0].min(initial=1.0))), max(largest, float(y.max()))
        at = thin(np.log(np.maximum(y, 1e-12)), limit(len(ran)))
        data.append(line(label, moments(record, when[at]), y[at], colour(index), width=1.6))
        if bounds is None:
            few = stride(len(when), 200)
            edges = [chdtri(sums[1][few], q) / sums[1][few] for q in (0.025, 0.975)]
            x = moments(record, when[few])
            band = {"type": "scatter", "x": [*x, *x[::-1]], "y": plain(np.concatenate([edges[0], edges[1][::-1]]))}
            style = {"mode": "lines", "line": {"width": 0}, "fill": "toself", "fillcolor": "rgba(107,119,133,0.2)"}
            bounds = band | style | {"name": "95 % bounds", "hoverinfo": "skip"}
            expected = line("expected: 1", [x[0], x[-1]], np.ones(2), MUTED, width=1)
            expected["line"]["dash"] = "dot"
            expected["showlegend"] = False
            data.insert(0, expected)
            lowest, largest = min(lowest, float(edges[1].min())), max(largest, float(edges[0].max()))
    if bounds is None:
        return None
    ends = float(np.log10(max(lowest, 1e-12) / 1.4)), float(np.log10(max(largest, 2) * 1.4))
    between = (1, 2, 5) if ends[1] - ends[0] < 4 else (1,)
    ticks = [m * 10.0**e for e in range(int(np.floor(ends[0])), int(np.ceil(ends[1])) + 1) for m in between]
    axis = {
        "type": "log",
        "range": list(ends),
        "tickvals": ticks,
        "ticktext": [f"{tick:g}" for tick in ticks],
    }
    layout = {
        "xaxis": {"title": {"text": time_title(record)}},
        "yaxis": axis | {"title": {"text": "NIS per measured component"}},
        "height": 400,
    }
    return {"data": [bounds, *data], "layout": layout}, window


def _moving(values: np.ndarray, window: int) -> np.ndarray:
    """Sums over a moving window."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return total[window:] - total[:-window]
