"""Pictures that show filters side by side: errors by group, against the first filter, and what a step costs."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sigmax.reports.comparison.figures import label, over_first, reach, readable, shade, shown_unit
from sigmax.reports.document import choices, place, section
from sigmax.reports.figures.draw import Figure, colour, plain, safe
from sigmax.studies import Comparison
from sigmax.studies.study import Charts

# Letters of a name in a picture.
_ROOM = 40
# Parts of a step, as `Cost.relative` has them, and how dark they are drawn.
PARTS = {"predict": 0.4, "correct": 0.7, "total": 1.0}


def groups(c: Comparison) -> dict[str, list[str]]:
    """The filters of each group that ran; all of them in one where the study names no groups."""
    asked = c.study.groups or {"": tuple(c.measures)}
    found = {group: [name for name in names if name in c.measures] for group, names in asked.items()}
    return {group: names for group, names in found.items() if names} or {"": list(c.measures)}


def errors_picture(c: Comparison) -> Any:
    """RMSE on linear axes, a column for each group."""

    def curve(name: str, i: int) -> np.ndarray:
        value: np.ndarray = shown_unit(c, i)[0] * c.measures[name].rmse.value[:, i]
        return value

    return _columns(c, curve, lambda i: label(c, i))


def relative_picture(c: Comparison) -> Any:
    """RMSE divided by that of the first filter, a column for each group."""
    first = next(iter(c.measures))
    return _columns(c, lambda name, i: over_first(c, name, i), lambda i: f"{c.study.model.deviations[i]} / {first}")


def within_picture(c: Comparison) -> Any:
    """RMSE divided by that of the first filter of the group, a column for each group."""
    firsts = {name: names[0] for names in groups(c).values() for name in names}

    def curve(name: str, i: int) -> np.ndarray:
        value: np.ndarray = over_first(c, name, i) / over_first(c, firsts[name], i)
        return value

    return _columns(c, curve, lambda i: f"{c.study.model.deviations[i]} / first")


def _axes(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple[Any, Any]:
    from matplotlib import figure  # takes longer to load than most commands take

    canvas = figure.Figure(figsize=size, layout="constrained")
    return canvas, canvas.subplots(rows, columns, squeeze=False, **shared)


def _columns(c: Comparison, curve: Callable[[str, int], np.ndarray], title: Callable[[int], str]) -> Any:
    shown, n = groups(c), c.study.model.dim
    size = (1.2 + 4.6 * len(shown), 1.4 + 1.7 * n)
    figure, axes = _axes(n, len(shown), size, sharex=True, sharey="row")
    for k, (group, names) in enumerate(shown.items()):
        for i in range(n):
            for name in names:
                axes[i, k].plot(c.study.time, curve(name, i), color=shade(c, name), label=_short(name), linewidth=1.2)
        axes[0, k].set_title(_short(group))
        axes[-1, k].set_xlabel("time [s]")
        axes[0, k].legend(fontsize=6, ncols=2 if len(names) > 5 else 1)
    kept = set(readable(c))
    for i in range(n):
        ends = reach([curve(name, i) for names in shown.values() for name in names if name in kept], False)
        if ends is not None:
            axes[i, 0].set_ylim(max(ends[0], 0), ends[1])
        axes[i, 0].set_ylabel(_short(title(i)))
    return figure


def _short(text: str) -> str:
    """A name that leaves room for what it names, with no mathematics in it."""
    return (text if len(text) <= _ROOM else f"{text[: _ROOM - 1]}…").replace("$", r"\$")


def cost_picture(c: Comparison) -> Any:
    """Prediction, correction and both in units of the EKF's, as bars, a row for each group."""
    shown = groups(c)
    figure, axes = _axes(len(shown), 1, (9, 0.8 + 2.6 * len(shown)))
    for ax, (group, names) in zip(axes[:, 0], shown.items(), strict=True):
        at = np.arange(len(names))
        for k, (part, strength) in enumerate(PARTS.items()):
            values = [float(c.costs[name].relative[k]) for name in names]
            ax.bar(at + 0.27 * (k - 1), values, 0.25, color="#0072b2", alpha=strength, label=part)
        ax.axhline(1.0, color="k", linewidth=1)
        ax.set_xticks(at, [_short(name) for name in names], rotation=30, ha="right", fontsize=8)
        ax.set_ylabel("time / EKF's")
        ax.set_title(_short(group))
        ax.grid(visible=False, axis="x")
    axes[0, 0].legend(fontsize=8)
    return figure


def cost_figures(c: Comparison) -> dict[str, Figure]:
    """The same for the page, under "cost/{group}"."""
    made: dict[str, Figure] = {}
    for k, names in enumerate(groups(c).values()):
        bars = [
            {
                "type": "bar",
                "name": part,
                "x": [safe(name) for name in names],
                "y": plain([float(c.costs[name].relative[at]) for name in names]),
                "marker": {"color": "#0072b2", "opacity": strength},
            }
            for at, (part, strength) in enumerate(PARTS.items())
        ]
        level = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1, "line": {"width": 1}}
        layout: Figure = {"barmode": "group", "height": 380, "shapes": [level]}
        made[f"cost/{k}"] = {"data": bars, "layout": layout | {"yaxis": {"title": {"text": "time / EKF's"}}}}
    return made


def chart_figures(charts: Charts) -> dict[str, Figure]:
    """Bars of what a study finds besides, under "chart/{number}"."""
    return {
        f"chart/{k}": {
            "data": [
                {
                    "type": "bar",
                    "name": name,
                    "x": [safe(label) for label in values],
                    "y": plain(list(values.values())),
                    "marker": {"color": colour(place)},
                }
                for place, (name, values) in enumerate(series.items())
            ],
            "layout": {"barmode": "group", "height": 360, "yaxis": {"title": {"text": safe(title)}}},
        }
        for k, (title, series) in enumerate(charts.items())
    }


def group_choices(c: Comparison) -> Sequence[tuple[str, str]]:
    """The groups for a menu: their numbers and names."""
    return [(str(k), group or "all") for k, group in enumerate(groups(c))]


def charts_section(charts: Charts, mark: str) -> str:
    """A section with a menu of them."""
    asked = choices(("chart", "show", [(str(k), title) for k, title in enumerate(charts)], "0"))
    return section(", ".join(charts), "", asked + place(f"{mark}chart", f"{mark}chart/{{chart}}"))
