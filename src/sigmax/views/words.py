"""Numbers and lines for people."""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

Rows = Sequence[tuple[str, str]]


def measured(value: float, deviation: float | None, unit: str = "") -> str:
    """A number with its standard deviation, with as many digits as that one leaves meaning to."""
    unit = f" {unit}" if unit else ""
    if deviation is None or not np.isfinite(value) or not 1e-9 < deviation < 1e9:
        return f"{value:,.6g}{'' if deviation is None else f' ± {deviation:.2g}'}{unit}"
    digits = int(np.clip(1 - np.floor(np.log10(deviation)), 0, 10))
    return f"{value:,.{digits}f} ± {deviation:,.{digits}f}{unit}"


def spread(deviation: float, unit: str = "") -> str:
    """A standard deviation alone."""
    return f"± {deviation:.2g}{f' {unit}' if unit else ''}"


def counted(n: int, what: str) -> str:
    """A number of things."""
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def text(title: str, rows: Rows) -> str:
    """A title and rows of a name and what is said of it, one below the other."""
    wide = max((len(name) for name, _ in rows), default=0)
    return "\n".join([title, *(f"  {name:<{wide}}  {said}" for name, said in rows)])


def html(title: str, rows: Rows, below: str = "") -> str:
    """The same as a table of HTML, with more HTML below it."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th><td style="text-align:left">{escape(said)}</td></tr>'
        for name, said in rows
    )
    return f"<div><b>{escape(title)}</b><table>{cells}</table>{below}</div>"


def span(time: Any) -> str:
    """From when to when."""
    first, last = time.min(), time.max()
    if time.ndim == 0:
        return f"{np.datetime_as_string(first, 'ms')} UTC" if time.dtype.kind == "M" else f"{first:.6g} s"
    if time.dtype.kind == "M":
        return f"{np.datetime_as_string(first, 's')} to {np.datetime_as_string(last, 's')} UTC"
    return f"{first:.6g} to {last:.6g} s"
