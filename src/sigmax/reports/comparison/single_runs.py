"""Single runs of a study over time: truth, measurements, and each filter's estimate with ±2σ."""

from typing import Any

import numpy as np

from sigmax.reports.comparison.figures import label, shade, shown_unit
from sigmax.reports.document import choices, place, section
from sigmax.reports.figures.draw import INK, MUTED, Figure, line, pale, plain, safe
from sigmax.studies import Comparison
from sigmax.studies.single_run import SingleRun
from sigmax.views.draw import draw
from sigmax.views.panels import Line, Panel


def single_figures(c: Comparison) -> dict[str, Figure]:
    """Under "single/{run}/{component}", the components of the state first, then those of the measurements."""
    made: dict[str, Figure] = {}
    for run in c.shown:
        for i in range(c.study.model.dim):
            factor, _ = shown_unit(c, i)
            time = c.study.time
            data: list[Figure] = [line("truth", time, factor * run.truth[:, i], INK, 2.4)]
            for name, mean in run.mean.items():
                middle, width = factor * mean[:, i], 2 * factor * run.std[name][:, i]
                edges = np.concatenate([middle + width, (middle - width)[::-1]])
                band: Figure = {
                    "type": "scatter",
                    "mode": "lines",
                    "line": {"width": 0},
                    "fill": "toself",
                    "hoverinfo": "skip",
                }
                band |= {"x": [*plain(time), *plain(time[::-1])], "y": plain(edges), "showlegend": False}
                group: Figure = {"legendgroup": name}
                data += [band | group | {"fillcolor": pale(shade(c, name), 0.12)}]
                data += [line(name, time, middle, shade(c, name), width=1.4) | group]
            made[f"single/{run.run}/{i}"] = _laid_out(data, label(c, i))
        for k, (name, values) in enumerate(measured(c, run)):
            points: Figure = {"type": "scatter", "mode": "markers", "marker": {"color": MUTED, "size": 4}}
            points |= {"x": plain(c.study.time), "y": plain(values), "name": safe(name)}
            made[f"single/{run.run}/{c.study.model.dim + k}"] = _laid_out([points], name)
    return made


def _laid_out(data: list[Figure], title: str) -> Figure:
    axes: Figure = {"xaxis": {"title": {"text": "time [s]"}}, "yaxis": {"title": {"text": safe(title)}}}
    return {"data": data, "layout": axes | {"height": 440, "hovermode": "closest"}}


def measured(c: Comparison, run: SingleRun) -> list[tuple[str, np.ndarray]]:
    """Each measured component of each sensor with its values (T,), angles in degrees."""
    found = []
    for sensor, z in run.z.items():
        names = c.study.model.measurement[sensor] or [f"z{k}" for k in range(z.shape[1])]
        turning = c.study.model.measured_angular(sensor, z.shape[1])
        for k, name in enumerate(names):
            factor, unit = (180 / np.pi, " [°]") if turning[k] else (1.0, "")
            found.append((f"measured {f'{sensor} ' if sensor else ''}{name}{unit}", factor * z[:, k]))
    return found


def single_picture(c: Comparison, run: SingleRun) -> Any:
    """The same as one picture of Matplotlib."""
    shown = []
    time = c.study.time
    for i in range(c.study.model.dim):
        factor, _ = shown_unit(c, i)
        lines = [Line("truth", time, factor * run.truth[:, i], style="limit")]
        for name, mean in run.mean.items():
            middle, width = factor * mean[:, i], 2 * factor * run.std[name][:, i]
            lines.append(Line(name, time, middle, middle - width, middle + width))
        shown.append(Panel("time [s]", label(c, i), tuple(lines)))
    for name, values in measured(c, run):
        shown.append(Panel("time [s]", name, (Line(name, time, values, style="points"),)))
    return draw(shown, f"{c.study.title}, run {run.run}", "matplotlib")


def single_section(c: Comparison, mark: str) -> str:
    """Estimates over time of the runs that were kept whole."""
    names = [*(label(c, i) for i in range(c.study.model.dim)), *(name for name, _ in measured(c, c.shown[0]))]
    runs = [(str(run.run), str(run.run)) for run in c.shown]
    asked = choices(
        ("run", "run", runs, runs[0][0]), ("of", "of", [(str(k), name) for k, name in enumerate(names)], "0")
    )
    return section(
        "Single runs",
        "The truth, and what each filter estimates with ±2σ as it claims; touch its name to hide a filter.",
        asked + place(f"{mark}single", f"{mark}single/{{run}}/{{of}}"),
    )
