"""Probabilities of the modes over time."""

import numpy as np

from sigmax.records import Record
from sigmax.reports.figures.draw import Figure, colour, limit, line, moments, time_title
from sigmax.running import Result
from sigmax.views.thin import thin


def modes_figure(record: Record, result: Result) -> Figure | None:
    """The probability of each mode, of the first track; None where the model has no modes."""
    if not result.modes:
        return None
    real = record.real[0]
    probability, when = np.asarray(result.probability)[0][real], record.time[0][real]
    points = limit(len(result.modes))
    data = []
    for k, name in enumerate(result.modes):
        few = thin(probability[:, k], points)
        data.append(line(name, moments(record, when[few]), probability[few, k], colour(k), width=1.5))
    layout = {
        "xaxis": {"title": {"text": time_title(record)}},
        "yaxis": {"title": {"text": "probability"}, "range": [-0.02, 1.02]},
        "height": 320,
    }
    return {"data": data, "layout": layout}
