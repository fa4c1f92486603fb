"""Cost against accuracy, as the dictionary that plotly.js draws."""

from collections.abc import Sequence

import numpy as np

from sigmax.reports.comparison.figures import shade
from sigmax.reports.comparison.labels import placed
from sigmax.reports.comparison.standing import Standing, Word
from sigmax.reports.figures.draw import MUTED, Figure, plain, safe
from sigmax.studies import Comparison


def symbol(s: Standing) -> str:
    """The mark of a filter in the chart: to take, not known, to avoid."""
    return "circle" if s.word.usable else "circle-open" if s.word is Word.UNKNOWN else "x-open"


def trade_figure(c: Comparison, found: Sequence[Standing]) -> Figure:
    """Cost against accuracy: down and to the left is better."""
    data, names = [], []
    for place, lines in placed(found):
        s = place.standing
        mark = {"color": shade(c, s.name), "size": 13, "symbol": symbol(s)}
        names.append(
            {
                "text": safe(s.name),
                "x": place.cost,
                # On a logarithmic axis annotations stand at the logarithm.
                "y": float(np.log10(place.distance)),
                "xanchor": "left",
                "ax": 8,
                "ay": -12 - 14 * lines,
                "arrowhead": 0,
                "arrowwidth": 0.6,
                "arrowcolor": MUTED if lines else "rgba(0,0,0,0)",
                "font": {"size": 10, "color": MUTED},
            }
        )
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": safe(s.name),
                "x": plain([place.cost]),
                "y": plain([place.distance]),
                "marker": mark | {"line": {"width": 2, "color": shade(c, s.name)}},
                "hovertemplate": f"{safe(s.name)}: %{{y:.3f}} at %{{x:.2f}} × the EKF's cost<extra></extra>",
            }
        )
    to = "the optimum" if c.optimum is not None else "the best"
    across: Figure = {"title": {"text": "cost of a step / EKF"}}
    up: Figure = {"title": {"text": f"error / error of {to}"}, "type": "log", "exponentformat": "none"}
    if data:
        # Room for names to the right; and a single filter, or several that are alike, is no reason for a microscope.
        costs, errors = zip(*((one.cost, one.distance) for one, _ in placed(found)), strict=True)
        wide, high = max(max(costs) - min(costs), 0.1), max(float(np.log10(max(errors) / min(errors))), 0.02)
        across["range"] = [min(costs) - 0.08 * wide, max(costs) + 0.2 * wide]
        up["range"] = [float(np.log10(min(errors))) - 0.1 * high, float(np.log10(max(errors))) + 0.15 * high]
    return {
        "data": data,
        "layout": {
            "height": 440,
            "xaxis": across,
            "yaxis": up,
            "annotations": names,
        },
    }
