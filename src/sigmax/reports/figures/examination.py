"""What gave a cause away: NIS before and after, and the residuals of one component."""

import numpy as np

from sigmax.examination import Evidence
from sigmax.records import Record
from sigmax.reports.figures.draw import MUTED, Figure, colour, limit, line, time_title, times
from sigmax.views.thin import thin


def examination_figures(record: Record, track: int, evidence: Evidence) -> tuple[Figure, Figure, int]:
    """NIS over a moving window, the residuals, and how many steps the window has."""
    heard = np.flatnonzero(evidence.dof > 0)
    window = max(len(heard) // 40, min(10, len(heard)))
    data = []
    for i, name in enumerate(("as it stands", "with what was found")):
        sums = [np.cumsum(np.concatenate([[0.0], v[heard]])) for v in (evidence.nis[i], evidence.dof)]
        nis, dof = (v[window:] - v[:-window] for v in sums)
        y, at = nis / dof, heard[window - 1 :]
        few = thin(np.log(np.maximum(y, 1e-12)), limit(2))
        data.append(line(name, times(record, track, at[few]), y[few], colour(1 - i), width=1.6))
    ends = times(record, track, heard[[window - 1, -1]])
    expected = line("expected: 1", ends, np.ones(2), MUTED, width=1)
    expected["line"]["dash"] = "dot"
    layout = {
        "xaxis": {"title": {"text": time_title(record)}},
        "yaxis": {"type": "log", "title": {"text": "NIS per measured component"}},
        "height": 340,
    }
    return {"data": [*data, expected], "layout": layout}, _residuals(record, track, evidence), window


def _residuals(record: Record, track: int, evidence: Evidence) -> Figure:
    data = []
    for i, name in enumerate(("as it stands", "with what was found")):
        rows = np.flatnonzero(np.isfinite(evidence.residual[i]) & ~evidence.out)
        few = rows[thin(evidence.residual[i][rows], limit(2))]
        points = line(name, times(record, track, few), evidence.residual[i][few], colour(1 - i), width=1, opacity=0.7)
        data.append(points | {"mode": "markers", "marker": {"size": 4, "color": colour(1 - i)}})
    far = np.flatnonzero(evidence.out & np.isfinite(evidence.residual[1]))
    if len(far):
        far = far[thin(evidence.residual[1][far], limit(2))]
        points = line("left out", times(record, track, far), evidence.residual[1][far], colour(3), width=1)
        data.append(points | {"mode": "markers", "marker": {"size": 8, "color": colour(3), "symbol": "x"}})
    layout = {
        "xaxis": {"title": {"text": time_title(record)}},
        "yaxis": {"title": {"text": f"innovation of {evidence.component} [σ]"}},
        "height": 340,
    }
    return {"data": data, "layout": layout}
