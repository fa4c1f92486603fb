"""The folder of a study: a page, figures, all numbers, and the sums from which it can be continued."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.reports.comparison.page import page
from sigmax.reports.comparison.pictures import pictures
from sigmax.reports.comparison.standing import Standing, standings
from sigmax.reports.comparison.verdict import facet, verdict
from sigmax.reports.document import versions
from sigmax.reports.folder import write_json
from sigmax.reports.replaced import replaced
from sigmax.studies import Comparison, Figure, Measures
from sigmax.studies.progress import FILE


def files(names: Sequence[str]) -> list[str]:
    """What such a folder may consist of, for studies of these names."""
    return ["report.html", "summary.json", "measures.parquet", "figures", FILE, *(names if len(names) > 1 else ())]


def write(folder: Path, comparisons: Sequence[Comparison]) -> None:
    """Write report.html, summary.json, measures.parquet and figures; the folder appears whole or not at all.

    Raises:
        InputError: where the disk does not take it.
    """
    alone = len(comparisons) == 1
    with replaced(folder) as part:
        for c in comparisons:
            inside = part if alone else part / c.study.name
            sums = (folder if alone else folder / c.study.name) / FILE
            inside.mkdir(exist_ok=True)
            if c.measures:
                pictures(inside / "figures", c, standings(c))
            if sums.exists():
                shutil.copy2(sums, inside / FILE)
        pd.concat([measures_table(c) for c in comparisons], ignore_index=True).to_parquet(part / "measures.parquet")
        told = [summary(c) for c in comparisons]
        whole = {"studies": {t["study"]: t for t in told}, "versions": versions()}
        write_json(part / "summary.json", told[0] if alone else whole)
        (part / "report.html").write_text(page(comparisons), encoding="utf-8")


def summary(c: Comparison) -> dict[str, Any]:
    """The content of summary.json: SI units and radians, null where there is no number."""
    found = {s.name: s for s in standings(c)}
    times = {f"{c.study.time[step]:g}": int(step) for step in c.by.look}
    state = [str(name) for name in c.study.model.deviations]

    def by_component(of: np.ndarray) -> dict[str, Any]:
        return {n: {t: _number(of[step, i]) for t, step in times.items()} for i, n in enumerate(state)}

    def looked(of: np.ndarray) -> dict[str, Any]:
        return {n: {t: _number(of[k, i]) for k, t in enumerate(times)} for i, n in enumerate(state)}

    headline, sentences = verdict(c)
    return {
        "study": c.study.name,
        "title": c.study.title,
        "verdict": headline,
        "because": sentences,
        "verdicts": {name: _verdict(s, c) for name, s in found.items()},
        "not_judged": c.study.unasked or None,
        "runs": c.runs,
        "escaped": c.escaped,
        "seed": c.seed,
        "units": dict(zip(state, c.study.units, strict=True)) if c.study.units else {},
        "filters": {name: str(f) for name, f in c.filters.items()},
        "failures": c.failures,
        "rmse": {name: by_component(m.rmse.value) for name, m in c.measures.items()},
        "rmse_error": {name: by_component(m.rmse.error) for name, m in c.measures.items()},
        "median": {name: looked(m.median.value) for name, m in c.measures.items()},
        "median_error": {name: looked(m.median.error) for name, m in c.measures.items()},
        "largest_error": {name: by_component(m.largest) for name, m in c.measures.items()},
        "real_over_claimed_error": {name: by_component(m.ratio.error) for name, m in c.measures.items()},
        "real_over_claimed": {name: by_component(m.ratio.value) for name, m in c.measures.items()},
        "nees": {name: _by_time(m.nees.value, times) for name, m in c.measures.items()},
        "outside_95": {name: _by_time(m.outside[1, :, 0], times) for name, m in c.measures.items()},
        "nis": {name: _by_time(m.nis.value, times) for name, m in c.measures.items()},
        "lost": {name: _number(m.lost["all"].value) for name, m in c.measures.items()},
        "lost_by_reason": {
            name: {reason: _number(f.value) for reason, f in m.lost.items()} for name, m in c.measures.items()
        },
        "relative_cost": {name: _number(cost.relative[2]) for name, cost in c.costs.items()},
        "relative_cost_of": {
            name: {"predict": _number(cost.relative[0]), "update": _number(cost.relative[1])}
            for name, cost in c.costs.items()
        },
        "step_seconds": {
            name: {"predict": _number(cost.predict), "update": _number(cost.update)} for name, cost in c.costs.items()
        },
        "evaluations": {name: list(cost.evaluations) for name, cost in c.costs.items()},
        "compile_seconds": {name: _number(seconds) for name, seconds in c.prepared.items()},
        "distance": {name: _number(s.distance) for name, s in found.items()},
        "distance_of_medians": {name: _number(s.middle) for name, s in found.items()},
        "distance_to": "optimum" if c.optimum is not None else "best",
        "optimum": None if c.optimum is None else by_component(c.optimum.limit.rmse.value),
        "optimum_real_over_claimed": None
        if c.optimum is None
        else {"value": by_component(c.optimum.limit.ratio.value), "error": by_component(c.optimum.limit.ratio.error)},
        "bound": None if c.bound is None else by_component(c.bound),
        "no_bound": c.no_bound or None,
        **c.extra,
        "versions": versions(),
    }


def _verdict(s: Standing, c: Comparison) -> dict[str, Any]:
    """What is said of one filter, and where its errors are worst in comparison with what it claims."""
    about: dict[str, Any] = {"verdict": s.word.value, "runs_that_would_tell": s.needed}
    if s.failure:
        return about
    about |= {"lost": s.lost, "runs": int(c.sums[s.name].runs), "nees_of_the_middle_run": _number(s.typical)}
    if s.honest is not None:
        h = s.honest
        about["outside_95"] = {"of": facet(h.worst, c), "share": h.outside}
        about["far_off"] = h.far
        about["judged_by"] = {
            "of": "runs far off" if h.facet is None else facet(h.facet, c),
            "share": h.share,
            "limit": h.limit,
            "time": None if h.step is None else float(c.study.time[h.step]),
        }
    return about


def _by_time(of: np.ndarray, times: dict[str, int]) -> dict[str, Any]:
    return {t: _number(of[step]) for t, step in times.items()}


def _number(value: Any) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def measures_table(c: Comparison) -> pd.DataFrame:
    """All measures over time, a row for each filter, time and component."""
    shown: dict[str, Measures] = dict(c.measures)
    if c.optimum is not None:
        shown |= {"optimum": c.optimum.limit}
    tables = []
    T, n = c.study.steps, c.study.model.dim
    for name, m in shown.items():
        columns: dict[str, Any] = {
            "study": c.study.name,
            "filter": name,
            "time": np.repeat(c.study.time, n),
            "component": np.tile([str(component) for component in c.study.model.deviations], T),
        }
        for measure in ("rmse", "bias", "ratio"):
            figure: Figure = getattr(m, measure)
            columns |= {measure: figure.value.ravel(), f"{measure}_error": figure.error.ravel()}
        median = np.full((2, T, n), np.nan)
        median[:, c.by.look] = m.median
        columns |= {"median": median[0].ravel(), "median_error": median[1].ravel()}
        columns["real_std"] = np.sqrt(np.einsum("tii->ti", m.real)).ravel()
        columns["claimed_std"] = np.sqrt(np.einsum("tii->ti", m.claimed)).ravel()
        columns["largest_error"] = m.largest.ravel()
        columns["outside_95"] = m.outside[1, :, 1:].ravel()
        columns["outside_95_whole"] = np.repeat(m.outside[1, :, 0], n)
        for measure in ("nees", "nis"):
            told = getattr(m, measure)
            for field, value in told._asdict().items():
                key = measure if field == "value" else f"{measure}_{field}"
                columns[key] = np.repeat(value, n)
        if c.bound is not None:
            columns["bound"] = c.bound.ravel()
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame({"study": [], "filter": []})
