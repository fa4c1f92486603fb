"""The figures of a study, as the dictionaries that plotly.js draws."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import bdtr

from sigmax.reports.figures.draw import COLOURS, INK, MUTED, TRUTH, Figure, between, colour, line, pale, plain, safe
from sigmax.studies import Comparison, Measures
from sigmax.studies.measures import claimed_density, histogram
from sigmax.views.thin import stride

_POINTS = 250
_WITHOUT_UNIT = ("ratio", "relative")
_DASHES = ("solid", "dash", "dot", "dashdot")
# What may be shown over time, with the title of its axis.
CURVES = {
    "rmse": "RMSE",
    "relative": "RMSE / that of the first filter",
    "ratio": "real / claimed variance",
    "claimed": "claimed σ",
    "bias": "mean error",
}


def shade(c: Comparison, name: str) -> str:
    """The colour of a filter; from light to dark in a group of its own that has more filters than there are colours."""
    own = [(k, list(names)) for k, names in enumerate(c.study.groups.values()) if name in names]
    if len(own) == 1 and len(own[0][1]) > len(COLOURS):
        k, names = own[0]
        return between(k, names.index(name) / (len(names) - 1))
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
    return f"{c.study.model.deviations[component]}{f' [{unit}]' if unit else ''}"


def readable(c: Comparison) -> list[str]:
    """The filters that axes are made for: those that do not lose most of their runs, or all where all do."""
    kept = [name for name, s in c.sums.items() if 2 * s.lost.sum() <= s.runs]
    return kept or list(c.sums)


def named(c: Comparison, name: str) -> str:
    """A filter for a legend: with the runs it loses where those are most of them."""
    if name in readable(c):
        return name
    return f"{name} (lost {int(c.sums[name].lost.sum()):,} of {int(c.sums[name].runs):,})"


def reach(values: Sequence[np.ndarray], logarithmic: bool) -> tuple[float, float] | None:
    """The ends of an axis on which all of these can be read, logarithms of them where asked for; None without any."""
    flat = np.concatenate([np.ravel(v) for v in values]) if values else np.empty(0)
    flat = flat[np.isfinite(flat) & ((flat > 0) | (not logarithmic))]
    if not len(flat):
        return None
    low, high = (float(v) for v in (flat.min(), flat.max()))
    if logarithmic:
        low, high = float(np.log10(low)), float(np.log10(high))
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _styled(c: Comparison, name: str, x: np.ndarray, y: np.ndarray) -> Figure:
    faint = 1.0 if name in readable(c) else 0.45
    drawn = line(named(c, name), x, y, shade(c, name), width=1.8, opacity=faint)
    # More filters than colours: the line tells them apart.
    drawn["line"]["dash"] = _DASHES[list(c.filters).index(name) // 8 % len(_DASHES)]
    return drawn


def curve_figures(c: Comparison) -> dict[str, Figure]:
    """Each measure of each component over time, for all filters, under "curves/{measure}/{component}"."""
    few = stride(len(c.study.time), _POINTS)
    time = c.study.time[few]
    made: dict[str, Figure] = {}
    for i in range(c.study.model.dim):
        factor, unit = shown_unit(c, i)
        for measure, title in CURVES.items():
            scale = 1.0 if measure in _WITHOUT_UNIT else factor
            data, kept = [], []
            for name, m in c.measures.items():
                value, error = _curve(c, name, m, measure, i)
                if name in readable(c):
                    kept.append(scale * value[few])
                drawn = _styled(c, name, time, scale * value[few])
                drawn["customdata"] = plain(scale * error[few])
                drawn["hovertemplate"] = f"{safe(name)}: %{{y:.4g}} ± %{{customdata:.2g}}<extra></extra>"
                data.append(drawn)
            references = _references(c, measure, i, scale, few)
            data += references
            positive = measure != "bias"
            axis: Figure = {
                "title": {"text": safe(f"{title}{f' [{unit}]' if unit and measure not in _WITHOUT_UNIT else ''}")}
            }
            ends = reach([*kept, *(np.array(r["y"], float) for r in references)], positive)
            if ends is not None and len(kept) < len(c.measures):
                axis["range"] = list(ends)
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


def over_first(c: Comparison, name: str, i: int) -> np.ndarray:
    """The RMSE (T,) of a component over that of the first filter."""
    with np.errstate(invalid="ignore", divide="ignore"):
        value: np.ndarray = c.measures[name].rmse.value[:, i] / next(iter(c.measures.values())).rmse.value[:, i]
    return value


def _curve(c: Comparison, name: str, m: Measures, measure: str, i: int) -> tuple[np.ndarray, np.ndarray]:
    if measure == "relative":
        value = over_first(c, name, i)
        return value, np.full_like(value, np.nan)
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
    if c.optimum is not None and measure not in ("bias", "relative"):
        value, _ = _curve(c, "", c.optimum.limit, measure, i)
        drawn.append(line("optimum", time, scale * value[few], INK, 2.4))
    if c.bound is not None and measure == "rmse":
        drawn.append(line("Cramér–Rao bound", time, scale * c.bound[few, i], TRUTH, 2.4))
        drawn[-1]["line"]["dash"] = "dot"
    return drawn


def consistency_figures(c: Comparison) -> dict[str, Figure]:
    """The share outside of the claimed region, NEES and NIS over time with bounds, under "consistency/{which}"."""
    made = {"consistency/outside": _outside_figure(c)}
    for which, title in (("nees", "NEES per component"), ("nis", "NIS per measured component")):
        bounds = getattr(next(iter(c.measures.values())), which)
        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = (edge / bounds.expected for edge in (bounds.low, bounds.high))
            curves = {name: getattr(m, which).value / getattr(m, which).expected for name, m in c.measures.items()}
        ends = reach([low, high, *(curves[name] for name in readable(c))], True)
        axis: Figure = {"title": {"text": title}, "type": "log", "exponentformat": "power"}
        made[f"consistency/{which}"] = _banded(c, low, high, curves, axis | ({"range": list(ends)} if ends else {}))
    return made


def _outside_figure(c: Comparison) -> Figure:
    """Runs with the truth outside of the claimed 95 % region of the whole state."""
    runs = int(next(iter(c.sums.values())).runs)
    low, high = (np.full(c.study.steps, v) for v in _honest_band(runs))
    curves = {name: m.outside[1, :, 0] for name, m in c.measures.items()}
    axis = {"title": {"text": "share of the runs outside of 95 %"}, "tickformat": ".0%", "rangemode": "tozero"}
    return _banded(c, low, high, curves, axis)


def _honest_band(runs: int) -> tuple[float, float]:
    """Between what shares of runs those of an honest filter lie at 95 of 100 times."""
    low, high = np.searchsorted(bdtr(np.arange(runs + 1), runs, 0.05), (0.025, 0.975))
    return float(low / runs), float(high / runs)


def _banded(c: Comparison, low: np.ndarray, high: np.ndarray, curves: Mapping[str, np.ndarray], axis: Figure) -> Figure:
    """Curves of the filters over time before a grey band."""
    few = stride(len(c.study.time), _POINTS)
    known = few[np.isfinite(low[few]) & np.isfinite(high[few])]
    band = {"type": "scatter", "mode": "lines", "line": {"width": 0}, "fill": "toself", "hoverinfo": "skip"}
    x = [*plain(c.study.time[known]), *plain(c.study.time[known][::-1])]
    edges = np.concatenate([high[known], low[known][::-1]])
    data: list[Figure] = [band | {"x": x, "y": plain(edges), "fillcolor": pale(MUTED, 0.2), "name": "95 % bounds"}]
    data += [_styled(c, name, c.study.time[few], curve[few]) for name, curve in curves.items()]
    return {"data": data, "layout": {"xaxis": {"title": {"text": "time [s]"}}, "yaxis": axis, "height": 420}}


def histogram_figures(c: Comparison) -> dict[str, Figure]:
    """Errors with the Gaussian that the filter claims, under "histogram/{filter}/{component}/{time}"."""
    made = {}
    for k, (name, s) in enumerate(c.sums.items()):
        m = c.measures[name]
        for i in range(c.study.model.dim):
            factor, _ = shown_unit(c, i)
            for t, step in enumerate(c.by.look):
                claimed = float(np.sqrt(m.claimed[step, i, i]))
                real = float(m.rmse.value[step, i])
                # Wide enough for the bulk of the errors; a few runs far off must not flatten the picture.
                width = 4 * max(claimed, min(real, 4 * float(m.median.value[t, i])))
                if not (np.isfinite(width) and width > 0):
                    continue
                density, edges = histogram(s.bins[t, i], float(c.by.scale[t, i]), width)
                x = np.linspace(-width, width, 121)
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
