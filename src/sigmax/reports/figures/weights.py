"""Weights of measurements over time."""

from collections.abc import Sequence

import numpy as np

from sigmax.records import Record
from sigmax.reports.figures.draw import Figure, Shown, colour, limit, line, moments, result_of, time_title
from sigmax.reports.weight_counts import least_weights
from sigmax.views.thin import thin


def weights_figure(record: Record, ran: Sequence[Shown]) -> Figure | None:
    """The weights of robust filters, a point for each measurement; None where no filter weighs."""
    weighing = [(index, label, found) for index, label, o in ran if (found := least_weights(record, result_of(o)))]
    points = limit(sum(len(found) for _, _, found in weighing))
    data: list[Figure] = []
    for index, label, found in weighing:
        for sensor, weight in found.items():
            heard = np.isfinite(weight)
            order = np.argsort(record.time[heard], kind="stable")
            when, w = record.time[heard][order], weight[heard][order]
            few = thin(w, points)
            name = f"{label}, {sensor}" if sensor else label
            marker = {"size": 5, "color": colour(index), "symbol": len(data) % 8}
            points_of = line(name, moments(record, when[few]), w[few], colour(index), width=1)
            data.append(points_of | {"mode": "markers", "marker": marker})
    if not data:
        return None
    layout = {
        "xaxis": {"title": {"text": time_title(record)}},
        "yaxis": {"title": {"text": "weight"}, "range": [-0.05, 1.05]},
        "height": 320,
    }
    return {"data": data, "layout": layout}
