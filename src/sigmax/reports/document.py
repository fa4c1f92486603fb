"""The pages' parts: a document with figures in one file that opens without a network, and what stands in it."""

import gzip
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import sigmax
from sigmax.filters import Filter
from sigmax.reports.figures.draw import Figure


def document(title: str, about: str, sections: Sequence[str], figures: Mapping[str, Figure]) -> str:
    """A page of sections in HTML; places made by `place` are filled with the figures of their names."""
    here = files("sigmax.reports")
    css, unpack, js = (here.joinpath(n).read_text(encoding="utf-8") for n in ("page.css", "unpack.js", "page.js"))
    plotly = here.joinpath("plotly/plotly-cartesian.min.js.gz").read_bytes()
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(title)} – sigmax</title>
<style>{css}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
<p class="quiet">{escape(about)}</p>
{"".join(sections)}
</main>
{_within("plotly", plotly)}
{packed("figures", figures)}
<script>{unpack}</script>
<script>{js}</script>
</body>
</html>
"""


def packed(name: str, content: Any) -> str:
    """An element with JSON, compressed: whatever a name in it holds, it ends no element and begins none."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return _within(name, gzip.compress(text.encode(), mtime=0))


def _within(name: str, compressed: bytes) -> str:
    return f'<script id="{name}" type="application/gzip">{b64encode(compressed).decode()}</script>'


def section(heading: str, about: str, body: str) -> str:
    """A section with a heading and a quiet sentence on how to read it."""
    said = f'<p class="quiet">{about}</p>' if about else ""
    return f"<section><h2>{heading}</h2>{said}{body}</section>"


def place(name: str, figure: str) -> str:
    """Where a figure is drawn; {choice} in the name of the figure is replaced by what was chosen."""
    return f'<div id="{name}" class="plot" data-figure="{figure}"></div>'


def choices(*chosen: tuple[str, str, Sequence[tuple[str, str]], str]) -> str:
    """Choices for the figures of a section.

    Args:
        *chosen: the name of a choice in the names of figures, its label, (value, text) of each option, and the
            value chosen at first. A choice of one is made without asking.
    """
    parts = []
    for name, label, options, first in chosen:
        shown = "".join(
            f'<option value="{escape(value)}"{" selected" if value == first else ""}>{escape(text)}</option>'
            for value, text in options
        )
        hidden = " hidden" if len(options) < 2 else ""
        parts.append(f'<label{hidden}>{escape(label)} <select data-choice="{escape(name)}">{shown}</select></label>')
    return f'<div class="choose">{"".join(parts)}</div>'


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells in HTML, one that becomes a list on a narrow screen."""

    def cells(row: Sequence[str]) -> str:
        return "".join(f'<td data-label="{escape(head)}">{cell}</td>' for head, cell in zip(heads, row, strict=True))

    head = "".join(f"<th>{escape(h)}</th>" for h in heads)
    body = "".join(f"<tr>{cells(row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def lead(headline: str, sentences: Sequence[str], tone: str = "", body: str = "") -> str:
    """The verdict of a page: what it says first, a body in HTML, and what it stands on.

    Args:
        headline: the one sentence.
        sentences: a list under it.
        tone: "" where something can be recommended, "open" where more data may tell, "none" where nothing can.
        body: what stands between the two.
    """
    return (
        f'<section class="{f"verdict {tone}".strip()}"><p class="lead">{escape(headline)}</p>'
        f"{body}{listed(sentences)}</section>"
    )


def listed(sentences: Sequence[str], css: str = "") -> str:
    """Sentences as a list; nothing where there are none."""
    items = "".join(f"<li>{escape(s)}</li>" for s in sentences)
    return f"<ul{f' class={css}' if css else ''}>{items}</ul>" if items else ""


def dotted(label: str, colour: str) -> str:
    """A name with the colour it has in the figures."""
    return f'<span><span class="dot" style="background:{colour}"></span>{escape(label)}</span>'


def graded(word: str, css: str = "bad") -> str:
    """A word in the colour of "good", "near" or "bad"."""
    return f'<span class="{css}">{escape(word)}</span>'


def small(value: str, note: str) -> str:
    """A value with a note below it."""
    return f'<span>{value}<span class="small">{escape(note)}</span></span>'


def filters(heads: Sequence[str], rows: Sequence[Sequence[str]], rules: Sequence[str]) -> str:
    """The table of filters, and the rules by which it is read."""
    reading = "".join(f"<p>{escape(rule)}</p>" for rule in rules)
    how = f'<details class="quiet"><summary>How to read this</summary>{reading}</details>'
    return section("Filters", "", table(heads, rows) + how)


def settings(rows: Sequence[tuple[str, str]], about: str = "") -> str:
    """What was set, by name."""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in rows)
    return section("Settings", about, f"<dl>{items}</dl>")


def parts(filter: Filter) -> str:
    """What a filter is made of, in words."""
    return f"prediction {filter.predict}, correction {filter.correct}, form {filter.form.name}"


def data(source: str, licence: str, notes: Sequence[str]) -> str:
    """Where the data come from, and what a reader should know of them."""
    terms = f"; {escape(licence)}" if licence else ""
    return section("Data", "", f"<p>{escape(source)}{terms}.</p>{listed(notes, 'notes')}")


def versions() -> dict[str, str]:
    """The versions that made a result."""
    return {"sigmax": sigmax.__version__, "jax": version("jax"), "numpy": version("numpy")}
