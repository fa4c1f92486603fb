"""Panels drawn by Plotly or by Matplotlib, each imported when it is used."""

import io
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from sigmax.errors import unknown
from sigmax.views.panels import Line, Panel
from sigmax.views.series import needed

# Distinct also to eyes that do not tell red from green (after Okabe and Ito).
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#b8860b", "#56b4e9", "#117733", "#882255")
_LIMIT, _BAND = "#6b7785", 0.16
_WIDE, _HIGH = 8.0, 1.9  # inches: of the picture, and of a panel


def draw(panels: Sequence[Panel], title: str, library: str) -> Any:
    """A figure of "plotly" or "matplotlib".

    Raises:
        InputError: for another library, or one that is not installed.
    """
    if library not in _LIBRARIES:
        raise unknown("library", library, _LIBRARIES)
    return _LIBRARIES[library](panels, title)


def _plotly(panels: Sequence[Panel], title: str) -> Any:
    go, subplots = (needed(f"plotly.{part}", "plot()") for part in ("graph_objects", "subplots"))
    heights = [2.2 if panel.equal else 1.0 for panel in panels] or None
    rows = max(len(panels), 1)
    figure = subplots.make_subplots(rows=rows, cols=1, row_heights=heights, vertical_spacing=0.3 / rows)
    for row, panel in enumerate(panels, 1):
        for shade, line in _coloured(panel):
            if line.low is not None and line.high is not None:
                edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
                figure.add_trace(go.Scatter(x=line.x, y=line.low, **edge), row=row, col=1)
                filled = {"fill": "tonexty", "fillcolor": _seen_through(shade)}
                figure.add_trace(go.Scatter(x=line.x, y=line.high, **edge, **filled), row=row, col=1)
            style: dict[str, Any] = {"mode": "lines", "line": {"color": shade, "width": 1.5}}
            if line.style == "points":
                style = {"mode": "markers", "marker": {"color": shade, "size": 5}}
            elif line.style == "limit":
                style["line"] |= {"dash": "dot", "width": 1}
            named = {"name": escape(line.name, quote=False), "showlegend": len(panel.lines) > 1 and not panel.equal}
            figure.add_trace(go.Scatter(x=line.x, y=line.y, **named, **style), row=row, col=1)
        axis = figure.layout[f"xaxis{row if row > 1 else ''}"]
        figure.update_xaxes(title_text=escape(panel.x, quote=False), row=row, col=1)
        if panel is not panels[-1] and panel.x == panels[-1].x:
            axis.matches, axis.title.text = f"x{len(panels)}", None
        span = np.log10(panel.span) if panel.log and panel.span else panel.span
        scale = {"type": "log", "dtick": 1} if panel.log else {}
        figure.update_yaxes(title_text=escape(panel.y, quote=False), range=span, row=row, col=1, **scale)
        if panel.equal:
            figure.update_yaxes(scaleanchor=f"x{row if row > 1 else ''}", row=row, col=1)
    height = 90 + 150 * sum(heights or [1])
    figure.update_layout(title_text=escape(title, quote=False), template="plotly_white", height=height)
    return figure


def _matplotlib(panels: Sequence[Panel], title: str) -> Any:
    return _on_canvas(needed("matplotlib.pyplot", "plot()").figure, panels, title)


def _on_canvas(make: Any, panels: Sequence[Panel], title: str) -> Any:
    heights = [2.2 if panel.equal else 1.0 for panel in panels] or [1.0]
    figure = make(figsize=(_WIDE, 0.6 + _HIGH * sum(heights)), layout="constrained")
    figure.suptitle(title, fontsize=11, parse_math=False)
    axes = figure.subplots(len(heights), 1, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for panel, ax in zip(panels, axes, strict=False):
        shared = panel is not panels[-1] and panel.x == panels[-1].x
        for shade, line in _coloured(panel):
            if line.low is not None and line.high is not None:
                ax.fill_between(line.x, line.low, line.high, color=shade, alpha=_BAND, linewidth=0)
            kind = {"points": {"ls": "", "marker": ".", "ms": 4}, "limit": {"ls": ":", "lw": 1}}
            (drawn,) = ax.plot(line.x, line.y, color=shade, **kind.get(line.style, {"lw": 1.3}))
            # A label that begins with _ is none to Matplotlib.
            drawn.set_label(line.name.replace("_", "\u200b_", 1) if line.name.startswith("_") else line.name)
        ax.set_xlabel("" if shared else panel.x, parse_math=False)
        ax.set_ylabel(panel.y, parse_math=False)
        ax.grid(alpha=0.25)
        if panel.log:
            ax.set_yscale("log")
        else:
            ax.ticklabel_format(axis="y", useOffset=False)
        if panel.span:
            ax.set_ylim(*panel.span)
        if panel.equal:
            ax.set_aspect("equal", adjustable="datalim")
        elif len(panel.lines) > 1:
            legend = ax.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), ncols=4, frameon=False)
            for text in legend.get_texts():
                text.set_parse_math(False)
    return figure


def image(panels: Sequence[Panel], title: str) -> str:
    """The picture as an image element of HTML, in which nothing can be run.

    Raises:
        InputError: where Matplotlib is not installed.
    """
    figure = _on_canvas(needed("matplotlib.figure", "a picture in a notebook").Figure, panels, title)
    content = io.BytesIO()
    figure.savefig(content, format="svg")
    return f'<img alt="{escape(title)}" src="data:image/svg+xml;base64,{b64encode(content.getvalue()).decode()}">'


def _coloured(panel: Panel) -> list[tuple[str, Line]]:
    shades = iter(_COLOURS * (1 + len(panel.lines) // len(_COLOURS)))
    return [(_LIMIT if line.style == "limit" else next(shades), line) for line in panel.lines]


def _seen_through(shade: str) -> str:
    red, green, blue = (int(shade[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{_BAND})"


_LIBRARIES = {"plotly": _plotly, "matplotlib": _matplotlib}
