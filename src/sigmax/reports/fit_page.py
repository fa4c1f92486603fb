"""The page and the data of a fit."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

import sigmax
from sigmax.corrections.fit_numbers import RecordFit
from sigmax.fitting import Along, Fit
from sigmax.fitting.result import INTERVAL
from sigmax.reports.document import data, document, lead, place, section, table, versions
from sigmax.reports.figures import Figure, colour
from sigmax.reports.folder import check_folder, write_json
from sigmax.reports.replaced import replaced
from sigmax.views import words

FILES = ("report.html", "summary.json")
# Over the rows of the table of numbers, on the page and in the terminal.
HEADS = ("number", "as it stands", "fitted, ± its standard error")


def write_fit(folder: Path, made: RecordFit) -> None:
    """Write report.html and summary.json; the folder appears whole or not at all.

    Raises:
        InputError: where something else is in the way, or the disk does not take it.
    """
    check_folder(folder, FILES)
    with replaced(folder) as part:
        write_json(part / "summary.json", in_numbers(made) | {"versions": versions()})
        (part / "report.html").write_text(page(made), encoding="utf-8")


def in_numbers(made: RecordFit) -> dict[str, Any]:
    """The fit as data, with the units of its numbers."""
    return {
        "records": [record.name for record in made.records],
        "units": {n.name: n.unit for n in made.numbers},
        **made.fit.to_dict(),
    }


def page(made: RecordFit) -> str:
    """The fit as HTML."""
    fit, first = made.fit, made.records[0]
    title = first.title if len(made.records) == 1 else f"{len(made.records)} records"
    steps = sum(int(record.steps.sum()) for record in made.records)
    headline, sentences = verdict(fit)
    figures: dict[str, Figure] = {}
    sections = [lead(headline, sentences, "" if fit.status == 0 else "open"), _numbers(made)]
    along = ""
    for k, one in enumerate(fit.along):
        figures[f"along/{k}"] = _figure(one, made.numbers[k].unit)
        along += place(f"along-{k}", f"along/{k}")
    about = (
        "The log-likelihood less its maximum, the other numbers going with each as their correlations have it. Where "
        f"it has lost {INTERVAL}, a 95 % interval ends."
    )
    sections += [section("Likelihood along each number", about, along), *_correlations(fit)]
    sections += [data(record.source, record.licence, ()) for record in made.records]
    names = ", ".join(record.name for record in made.records)
    about = f"Fitted by {fit.filter} to {names}: {steps:,} steps. sigmax {sigmax.__version__}."
    return document(f"Fit of {title}", about, sections, figures)


def verdict(fit: Fit) -> tuple[str, list[str]]:
    """What came of it, and what it stands on."""
    gain = fit.log_likelihood - fit.start_log_likelihood
    sentences = [f"Log-likelihood {fit.log_likelihood:,.6g}, {gain:+,.4g} from the numbers as they stand."]
    if fit.held_out is not None:
        change = fit.held_out.after - fit.held_out.before
        better = "better" if change > 0 else "worse"
        sentences.append(
            f"Fitted to the first steps alone it predicts the last {fit.held_out.steps:,} {better} than before: "
            f"log-likelihood {change:+,.4g}."
        )
    sentences += [f"Not determined: {said}." for said in fit.undetermined]
    if not fit.converged:
        return f"The search did not end at a maximum: {fit.message}.", sentences
    return ("All numbers are determined." if not fit.undetermined else "Not every number is determined."), sentences


def rows(made: RecordFit) -> list[tuple[str, str, str]]:
    """Each number in words, under `HEADS`."""
    found = []
    for n in made.numbers:
        value, std = float(made.fit.parameters[n.name]), float(made.fit.std[n.name])
        now = words.measured(value, std if np.isfinite(std) else None, n.unit)
        now += "" if np.isfinite(std) else ", not determined"
        found.append((n.name, words.measured(n.start, None, n.unit), now))
    return found


def _numbers(made: RecordFit) -> str:
    about = "Of a factor 1 is the noise as it stands; it multiplies variances."
    return section("Numbers", about, table(HEADS, [[escape(said) for said in row] for row in rows(made)]))


def _correlations(fit: Fit) -> list[str]:
    C = fit.correlation
    if C is None or len(C) < 2:
        return []
    rows = [[escape(name), *(f"{v:.2f}" if np.isfinite(v) else "–" for v in C[i])] for i, name in enumerate(fit.labels)]
    return [section("Correlations", "", table(("", *map(escape, fit.labels)), rows))]


def _figure(one: Along, unit: str) -> Figure:
    kept = np.isfinite(one.lost)
    x, y = one.values[kept], -one.lost[kept]
    shown = {"type": "scatter", "mode": "lines+markers", "name": "log-likelihood", "x": x.tolist(), "y": y.tolist()}
    ends, level = [x.min(), x.max()], [-INTERVAL] * 2
    edge = {"type": "scatter", "mode": "lines", "name": "95 % interval", "x": ends, "y": level}
    return {
        "data": [
            shown | {"line": {"color": colour(0), "width": 1.6}},
            edge | {"line": {"color": colour(1), "width": 1, "dash": "dot"}},
        ],
        "layout": {
            "xaxis": {"title": {"text": escape(f"{one.name} [{unit}]" if unit else one.name)}},
            "yaxis": {"title": {"text": "log-likelihood"}, "range": [-6.0, 0.4]},
            "height": 300,
        },
    }
