"""The figures of a study, as the dictionaries that plotly.js draws."""

from collections.abc import Sequence

import numpy as np

from sigmax.reports.comparison.labels import placed
from sigmax.reports.comparison.standing import Standing
from sigmax.reports.figures.draw import INK, MUTED, TRUTH, Figure, colour, line, pale, plain, safe
from sigmax.reports.thin import stride
from sigmax.studies import Comparison, Measures
from sigmax.studies.measures import claimed_density, histogram

_POINTS = 250
_DASHES = ("solid", "dash", "dot", "dashdot")
# What may be shown over time, with the title of its axis.
CURVES = {"rmse": "RMSE", "ratio": "real / claimed variance", "claimed": "claimed σ", "bias": "mean error"}


def shade(c: Comparison, name: str) -> str:
    """The colour of a filter."""
    return colour(list(c.filters).index(name))


def shown_unit(c: Comparison, component: int) -> tuple[float, str]:
    """Factor and unit of a component for people: degrees for angles and their rates."""
    unit = c.study.units[component] if c.study.units else ""
    if c.study.model.angular[component] or unit.startswith("rad"):
        return 180 / np.pi, "°" + unit.removeprefix("rad")
    return 1.0, unit


def label(c: Comparison, component: int) -> str:
    """A component with its unit."""
    unit = shown_unit(c, component)[1]
    return f"{c.study.model.state[component]}{f' [{unit}]' if unit else ''}"


def _styled(c: Comparison, name: str, x: np.ndarray, y: np.ndarray) -> Figure:
    drawn = line(name, x, y, shade(c, name), width=1.8)
    # More filters than colours: the line tells them apart.
    drawn["line"]["dash"] = _DASHES[list(c.filters).index(name) // 8 % len(_DASHES)]
    return drawn


def curve_figures(c: Comparison) -> dict[str, Figure]:
    """Each measure of each component over time, for all filters, under "curves/{measure}/{component}"."""
    few = stride(len(c.study.time), _POINTS)
    time = c.study.time[few]
    made: dict[str, Figure] = {}
    for i in range(c.study.model.size):
        factor, unit = shown_unit(c, i)
        for measure, title in CURVES.items():
            scale = 1.0 if measure == "ratio" else factor
            data = []
            for name, m in c.measures.items():
                value, error = _curve(m, measure, i)
                drawn = _styled(c, name, time, scale * value[few])
                drawn["customdata"] = plain(scale * error[few])
                drawn["hovertemplate"] = f"{safe(name)}: %{{y:.4g}} ± %{{customdata:.2g}}<extra></extra>"
                data.append(drawn)
            data += _references(c, measure, i, scale, few)
            positive = measure != "bias"
            axis = {"title": {"text": safe(f"{title}{f' [{unit}]' if unit and measure != 'ratio' else ''}")}}
            made[f"curves/{measure}/{i}"] = {
                "data": data,
                "layout": {
                    "xaxis": {"title": {"text": "time [s]"}},
                    "yaxis": axis | ({"type": "log", "exponentformat": "power"} if positive else {}),
                    "height": 460,
                    "hovermode": "closest",
                },
            }
    return made


def _curve(m: Measures, measure: str, i: int) -> tuple[np.ndarray, np.ndarray]:
    if measure == "claimed":
        sigma = np.sqrt(m.claimed[:, i, i])
        return sigma, np.full_like(sigma, np.nan)
    value, error = getattr(m, measure)
    return value[:, i], error[:, i]


def _references(c: Comparison, measure: str, i: int, scale: float, few: np.ndarray) -> list[Figure]:
    time = c.study.time[few]
    drawn = []
    if measure == "ratio":
        drawn.append(line("honest", time, np.ones(len(few)), MUTED, 1))
    if c.optimum is not None and measure != "bias":
        value, _ = _curve(c.optimum.check, measure, i)
        drawn.append(line("optimum", time, scale * value[few], INK, 2.4))
    if c.bound is not None and measure == "rmse":
        drawn.append(line("Cramér–Rao bound", time, scale * c.bound[few, i], TRUTH, 2.4))
        drawn[-1]["line"]["dash"] = "dot"
    return drawn


def consistency_figures(c: Comparison) -> dict[str, Figure]:
    """NEES and NIS over time with their bounds, under "consistency/{which}"."""
    few = stride(len(c.study.time), _POINTS)
    time = c.study.time[few]
    made = {}
    for which, title in (("nees", "NEES per component"), ("nis", "NIS per measured component")):
        data: list[Figure] = []
        first = next(iter(c.measures.values()))
        bounds = getattr(first, which)
        known = np.flatnonzero(np.isfinite(bounds.low[few]) & (bounds.expected[few] > 0))
        at = few[known]
        edges = np.concatenate([(bounds.high / bounds.expected)[at], (bounds.low / bounds.expected)[at][::-1]])
        band = {"type": "scatter", "mode": "lines", "line": {"width": 0}, "fill": "toself", "hoverinfo": "skip"}
        x = [*plain(time[known]), *plain(time[known][::-1])]
        data.append(band | {"x": x, "y": plain(edges), "fillcolor": pale(MUTED, 0.2), "name": "95 % bounds"})
        for name, m in c.measures.items():
            told = getattr(m, which)
            with np.errstate(invalid="ignore", divide="ignore"):
                data.append(_styled(c, name, time, (told.value / told.expected)[few]))
        made[f"consistency/{which}"] = {
            "data": data,
            "layout": {
                "xaxis": {"title": {"text": "time [s]"}},
                "yaxis": {"title": {"text": title}, "type": "log", "exponentformat": "power"},
                "height": 420,
            },
        }
    return made


def histogram_figures(c: Comparison) -> dict[str, Figure]:
    """Errors with the Gaussian that the filter claims, under "histogram/{filter}/{component}/{time}"."""
    made = {}
    for k, (name, s) in enumerate(c.sums.items()):
        m = c.measures[name]
        for i in range(c.study.model.size):
            factor, _ = shown_unit(c, i)
            for t, step in enumerate(c.by.look):
                claimed = float(np.sqrt(m.claimed[step, i, i]))
                real = float(m.rmse.value[step, i])
                # Wide enough for the bulk of the errors; a few runs far off must not flatten the picture.
                reach = 4 * max(claimed, min(real, 4 * float(m.median.value[t, i])))
                if not (np.isfinite(reach) and reach > 0):
                    continue
                density, edges = histogram(s.bins[t, i], float(c.by.scale[t, i]), reach)
                x = np.linspace(-reach, reach, 121)
                bell = claimed_density(x, claimed)
                made[f"histogram/{k}/{i}/{t}"] = {
                    "data": [
                        {
                            "type": "bar",
                            "x": plain(factor * (edges[1:] + edges[:-1]) / 2),
                            "y": plain(density / factor),
                            "marker": {"color": pale(shade(c, name), 0.55)},
                            "name": "errors",
                        },
                        line("claimed", factor * x, bell / factor, INK, 1.6),
                    ],
                    "layout": {
                        "bargap": 0.05,
                        "height": 380,
                        "xaxis": {"title": {"text": safe(f"error of {label(c, i)}")}},
                        "yaxis": {"title": {"text": "density"}, "rangemode": "tozero"},
                    },
                }
    return made


def trade_figure(c: Comparison, found: Sequence[Standing]) -> Figure:
    """Cost against accuracy: down and to the left is better."""
    data, names = [], []
    for place, lines in placed(found):
        s = place.standing
        mark = {"color": shade(c, s.name), "size": 13, "symbol": "circle" if s.sound else "x-open"}
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
    return {
        "data": data,
        "layout": {
            "height": 440,
            "xaxis": {"title": {"text": "cost of a step / EKF"}},
            "yaxis": {"title": {"text": f"error / error of {to}"}, "type": "log", "exponentformat": "none"},
            "annotations": names,
        },
    }
