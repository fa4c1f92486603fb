"""The figures of a study as PNG and SVG, for papers and slides."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogFormatter

from sigmax.reports.comparison.figures import label, named, reach, readable, shade, shown_unit
from sigmax.reports.comparison.grouped import cost_picture, errors_picture, relative_picture, within_picture
from sigmax.reports.comparison.labels import placed
from sigmax.reports.comparison.single_runs import single_picture
from sigmax.reports.comparison.standing import Standing
from sigmax.reports.comparison.trade import symbol
from sigmax.reports.verdict import significant
from sigmax.studies import Comparison
from sigmax.studies.measures import claimed_density, histogram

# Letters of a name.
_LONG = 44
_STYLES = ("-", "--", ":", "-.")


def pictures(folder: Path, c: Comparison, found: Sequence[Standing]) -> None:
    """Write rmse, relative, cost, consistency, histograms, trade and groups, each as PNG and SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, Callable[[], Any]] = {
        "rmse": lambda: _rmse(c),
        "relative": lambda: relative_picture(c),
        "cost": lambda: cost_picture(c),
        "consistency": lambda: _consistency(c),
        "histograms": lambda: _histograms(c),
        "trade": lambda: _trade(c, found),
    }
    if c.study.groups:
        drawn |= {"groups": lambda: errors_picture(c), "within": lambda: within_picture(c)}
    drawn |= {f"run-{run.run}": partial(single_picture, c, run) for run in c.shown}
    with plt.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "sigmax"}):
        for name, draw in drawn.items():
            figure = draw()
            figure.draw_without_rendering()
            figure.set_layout_engine(None)  # it is laid out, once for both files
            figure.savefig(folder / f"{name}.png", dpi=130)
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


def _style(c: Comparison, name: str) -> dict[str, Any]:
    return {"color": shade(c, name), "linestyle": _STYLES[list(c.filters).index(name) // 8 % 4], "linewidth": 1.2}


def _rmse(c: Comparison) -> Any:
    n = c.study.model.dim
    figure, axes = plt.subplots(n, 1, figsize=(8, 1.2 + 2.0 * n), sharex=True, squeeze=False, layout="constrained")
    for i, ax in enumerate(axes[:, 0]):
        factor, _ = shown_unit(c, i)
        for name, m in c.measures.items():
            ax.plot(c.study.time, factor * m.rmse.value[:, i], label=_plain(named(c, name)), **_style(c, name))
        if c.optimum is not None:
            ax.plot(c.study.time, factor * c.optimum.limit.rmse.value[:, i], "k", linewidth=2, label="optimum")
        if c.bound is not None:
            ax.plot(c.study.time, factor * c.bound[:, i], color="0.6", linestyle=":", linewidth=2, label="bound")
        _logarithmic(ax, [factor * c.measures[name].rmse.value[:, i] for name in readable(c)])
        ax.set_ylabel(_plain(label(c, i)))
    axes[-1, 0].set_xlabel("time [s]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=8)
    return figure


def _consistency(c: Comparison) -> Any:
    figure, axes = plt.subplots(3, 1, figsize=(8, 8), sharex=True, layout="constrained")
    for name, m in c.measures.items():
        axes[0].plot(c.study.time, 100 * m.outside[1, :, 0], label=_plain(named(c, name)), **_style(c, name))
    axes[0].axhline(5.0, color="0.4", linewidth=0.8)
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("outside of 95 % [%]")
    for ax, which in zip(axes[1:], ("nees", "nis"), strict=True):
        kept = []
        for name, m in c.measures.items():
            told = getattr(m, which)
            with np.errstate(invalid="ignore", divide="ignore"):
                ratio = told.value / told.expected
            kept += [ratio] if name in readable(c) else []
            ax.plot(c.study.time, ratio, **_style(c, name))
        ax.axhline(1.0, color="0.4", linewidth=0.8)
        _logarithmic(ax, kept)
        ax.set_ylabel(f"{which.upper()} / expected")
    axes[-1].set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=8)
    return figure


def _histograms(c: Comparison) -> Any:
    """The first component that filters differ most in, at the times looked at, for each filter a row."""
    names, L = list(c.measures), len(c.by.look)
    worst = np.array([np.nan_to_num(c.measures[k].ratio.value[c.by.look], posinf=1e9).max(0) for k in readable(c)])
    i = int(worst.max(0).argmax())
    factor, _ = shown_unit(c, i)
    figure, ax = plt.subplots(figsize=(2.2 * L + 0.8, 0.8 + 1.2 * len(names)), layout="constrained")
    # Cells of one plot, each over its own reach: as many small plots take many seconds to draw.
    for t, step in enumerate(c.by.look):
        ax.text(t + 0.5, -0.08, f"{c.study.time[step]:g} s", ha="center", va="bottom")
        for row, name in enumerate(names):
            m = c.measures[name]
            claimed = float(np.sqrt(m.claimed[step, i, i]))
            width = 4 * max(claimed, 2 * float(m.median.value[t, i]))
            if not (np.isfinite(width) and width > 0):
                continue
            density, edges = histogram(c.sums[name].bins[t, i], float(c.by.scale[t, i]), width)
            x = np.linspace(-width, width, 200)
            gaussian = claimed_density(x, claimed) if claimed > 0 else np.zeros(200)
            high, foot = 1.25 * max(density.max(), gaussian.max()), row + 0.8
            across = t + 0.5 + 0.45 * edges / width
            ax.stairs(foot - 0.8 * density / high, across, baseline=foot, fill=True, color=shade(c, name), alpha=0.5)
            ax.plot(t + 0.5 + 0.45 * x / width, foot - 0.8 * gaussian / high, "k", linewidth=0.9)
            ax.text(t + 0.5, row + 0.97, f"±{significant(factor * width)}", ha="center", va="bottom", fontsize=7)
    ax.set(
        xlim=(0, L),
        ylim=(len(names), -0.3),
        xticks=[],
        yticks=np.arange(len(names)) + 0.6,
        yticklabels=[_plain(named(c, name).replace(" (", "\n(")) for name in names],
    )
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for side in ax.spines.values():
        side.set_visible(False)
    ax.set_xlabel(
        f"error of {_plain(label(c, i))}, from - to + what stands below; line: the Gaussian that the filter claims"
    )
    return figure


def _plain(text: str) -> str:
    """Text that matplotlib does not take for a formula, and that leaves room for the picture."""
    short = text if len(text) <= _LONG else f"{text[: _LONG - 1]}…"
    return short.replace("$", r"\$")


def _logarithmic(ax: Any, shown: Sequence[np.ndarray] = ()) -> None:
    """With plain numbers at the ticks, for formulas take seconds to set; wide enough for what is to be read."""
    ax.set_yscale("log")
    ends = reach(shown, True)
    if ends is not None:
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, 10 ** ends[0]), min(high, 10 ** ends[1]))
    ax.yaxis.set_major_formatter(LogFormatter())
    ax.yaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(1.5, 0.5)))


def _trade(c: Comparison, found: Sequence[Standing]) -> Any:
    figure, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for place, lines in placed(found):
        s, at = place.standing, (place.cost, place.distance)
        mark = {"circle": "o", "circle-open": "o", "x-open": "x"}[symbol(s)]
        inside = "none" if symbol(s) == "circle-open" else shade(c, s.name)
        ax.plot(*at, mark, color=shade(c, s.name), markersize=8, markerfacecolor=inside)
        leader = (
            {"arrowstyle": "-", "color": "0.7", "linewidth": 0.6, "shrinkB": 4, "relpos": (0, 0)} if lines else None
        )
        ax.annotate(
            _plain(s.name), at, xytext=(6, 4 + 10 * lines), textcoords="offset points", fontsize=8, arrowprops=leader
        )
    ax.margins(y=0.12)
    _logarithmic(ax)
    ax.set_xlabel("cost of a step / EKF")
    ax.set_ylabel("error / error of " + ("the optimum" if c.optimum is not None else "the best"))
    return figure
