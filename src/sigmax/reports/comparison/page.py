"""The page of a study: the verdict first, then what it stands on."""

from collections.abc import Sequence
from html import escape

import numpy as np

import sigmax
from sigmax.reports.comparison.figures import (
    CURVES,
    consistency_figures,
    curve_figures,
    histogram_figures,
    label,
    shade,
    shown_unit,
)
from sigmax.reports.comparison.grouped import chart_figures, charts_section, cost_figures, group_choices
from sigmax.reports.comparison.single_runs import single_figures, single_section
from sigmax.reports.comparison.standing import FAR, Standing, Word, standings
from sigmax.reports.comparison.trade import trade_figure
from sigmax.reports.comparison.verdict import RULES, facet, times, verdict
from sigmax.reports.document import (
    choices,
    document,
    dotted,
    filters,
    graded,
    lead,
    parts,
    place,
    section,
    settings,
    small,
    table,
    versions,
)
from sigmax.reports.figures.draw import Figure
from sigmax.reports.verdict import significant
from sigmax.studies import Comparison, Measures
from sigmax.studies.sums import LOST


def page(comparisons: Sequence[Comparison]) -> str:
    """The report of one or several studies as HTML."""
    figures: dict[str, Figure] = {}
    sections = []
    for k, c in enumerate(comparisons):
        mark = f"{k}/" if len(comparisons) > 1 else ""
        if len(comparisons) > 1:
            sections.append(f"<h1>{escape(c.study.title)}</h1>")
        told, drawn = _one(c, mark)
        sections += told
        figures |= {mark + name: figure for name, figure in drawn.items()}
    first = comparisons[0]
    title = first.study.title if len(comparisons) == 1 else f"{len(comparisons)} studies"
    about = f"{', '.join(c.study.name for c in comparisons)}: {first.runs:,} runs, seed {first.seed}."
    return document(title or first.study.name, f"{about} Compared with sigmax {sigmax.__version__}.", sections, figures)


def _one(c: Comparison, mark: str) -> tuple[list[str], dict[str, Figure]]:
    found = standings(c)
    sections = [_verdict(c, found), _table(c, found)]
    figures: dict[str, Figure] = {}
    if c.measures:
        figures = {"trade": trade_figure(c, found), **curve_figures(c), **consistency_figures(c)}
        figures |= histogram_figures(c) | cost_figures(c)
        sections += [_trade(found, mark), _curves(c, mark), _consistency(c, mark), _histograms(c, mark)]
        sections += [_lost(c), _cost(c, mark)]
    if c.shown:
        figures |= single_figures(c)
        sections.append(single_section(c, mark))
    if c.study.charts is not None:
        figures |= chart_figures(c.study.charts(c.extra))
        sections.append(charts_section(c.study.charts(c.extra), mark))
    sections.append(_settings(c))
    return sections, figures


_CLASS = {Word.SOUND: "good", Word.NOT_JUDGED: "", Word.CAUTIOUS: "near", Word.UNKNOWN: "near"}


def _verdict(c: Comparison, found: Sequence[Standing]) -> str:
    headline, sentences = verdict(c)
    words = {s.word for s in found}
    if words & {Word.SOUND, Word.NOT_JUDGED}:
        return lead(headline, sentences)
    return lead(headline, sentences, "open" if words & {Word.CAUTIOUS, Word.UNKNOWN} else "none")


def _named(c: Comparison, name: str) -> str:
    return dotted(name, shade(c, name))


def _table(c: Comparison, found: Sequence[Standing]) -> str:
    to = "optimum" if c.optimum is not None else "best"
    heads = ["filter", f"RMSE / {to}", f"median / {to}", "cost / EKF", "lost", "far off", "outside 95 %", "verdict"]
    rows = []
    for s in found:
        word = graded(s.word.value, _CLASS.get(s.word, "bad"))
        if s.failure:
            rows.append([_named(c, s.name), *["–"] * 6, word])
            continue
        lost = f"{s.lost:,} of {int(c.sums[s.name].runs):,}"
        rows.append(
            [
                _named(c, s.name),
                times(s.distance),
                times(s.middle),
                "–" if s.cost is None else significant(s.cost),
                graded(lost) if s.word is Word.LOSSY else lost,
                "–" if s.honest is None else f"{s.honest.far:.0%}",
                _outside(c, s),
                word,
            ]
        )
    return filters(heads, rows, RULES)


def _outside(c: Comparison, s: Standing) -> str:
    """How often the truth is outside of the claimed 95 % region, where that is worst, on average over time."""
    if s.honest is None or s.outside is None:
        return "–"
    return small(f"{s.outside:.0%}", facet(s.honest.worst, c))


def _trade(found: Sequence[Standing], mark: str) -> str:
    far = [s.name for s in found if s.distance is not None and not s.distance <= FAR]
    beyond = f" Beyond the picture: {escape(', '.join(far))}." if far else ""
    return section(
        "Cost against accuracy",
        f"Down and to the left is better. A cross marks a filter to avoid, an open circle one not known.{beyond}",
        place(f"{mark}trade", f"{mark}trade"),
    )


def _component_options(c: Comparison) -> list[tuple[str, str]]:
    return [(str(i), label(c, i)) for i in range(c.study.model.dim)]


def _curves(c: Comparison, mark: str) -> str:
    asked = choices(
        ("measure", "show", list(CURVES.items()), "rmse"),
        ("component", "of", _component_options(c), "0"),
    )
    said = "Over all runs, the lost ones too; touch a point for its Monte Carlo error."
    if c.no_bound:
        said += f" There is no Cramér–Rao bound: {escape(c.no_bound)}."
    return section("Errors over time", said, asked + place(f"{mark}curves", f"{mark}curves/{{measure}}/{{component}}"))


def _consistency(c: Comparison, mark: str) -> str:
    shown = [("outside", "share outside of 95 %"), ("nees", "mean NEES"), ("nis", "mean NIS")]
    asked = choices(("which", "show", shown, "outside"))
    said = (
        "Runs with the truth outside of the claimed 95 % region of the whole state; and errors (NEES) and innovations "
        "(NIS) in units of what the filter claims, on average. An honest filter stays about 5 %, or about 1, mostly "
        "within the grey band (95 % at each time); above it claims too much, below it too little. A single lost run "
        "can lift a mean, but not a share."
    )
    if c.study.unasked:
        said += f" This is not judged: {escape(c.study.unasked)}."
    return section(
        "Can the covariance be believed?",
        said,
        asked + place(f"{mark}consistency", f"{mark}consistency/{{which}}"),
    )


def _histograms(c: Comparison, mark: str) -> str:
    names = list(c.sums)
    times = [(str(t), f"{significant(float(c.study.time[step]))} s") for t, step in enumerate(c.by.look)]
    asked = choices(
        ("filter", "filter", [(str(k), name) for k, name in enumerate(names)], "0"),
        ("component", "component", _component_options(c), "0"),
        ("time", "at", times, times[0][0]),
    )
    return section(
        "Errors and what is claimed",
        "How the errors are distributed over the runs, and the Gaussian of the mean covariance that the filter claims.",
        asked + place(f"{mark}histogram", f"{mark}histogram/{{filter}}/{{component}}/{{time}}") + _largest(c),
    )


def _largest(c: Comparison) -> str:
    """The largest error of all runs and times, with the time at which it was made; > a thousand times the least."""
    rows = []
    most = FAR * np.min([m.largest.max(axis=0) for m in c.measures.values()], axis=0)
    for name, m in c.measures.items():
        steps = m.largest.argmax(axis=0)
        cells = [
            small(
                ("> " if m.largest[k, i] > most[i] else "")
                + significant(float(shown_unit(c, i)[0] * min(m.largest[k, i], most[i]))),
                f"{c.study.time[k]:g} s",
            )
            for i, k in enumerate(steps)
        ]
        rows.append([_named(c, name), *cells])
    return table(["largest error", *(label(c, i) for i in range(c.study.model.dim))], rows)


def _lost(c: Comparison) -> str:
    def share(m: Measures, reason: str) -> str:
        figure = m.lost[reason]
        return f"{100 * figure.value:.2g} ± {100 * figure.error:.1g} %" if figure.value > 0 else "0"

    rows = [[_named(c, name), *(share(m, reason) for reason in (*LOST, "all"))] for name, m in c.measures.items()]
    limits = ", ".join(
        f"{name} {significant(float(limit))}" for name, limit in zip(c.study.model.deviations, c.by.limit, strict=True)
    )
    escaped = f" The truth of {c.escaped} runs escaped; they are left out." if c.escaped else ""
    return section(
        "Lost runs",
        f"Failed: a step had no valid covariance. Mirrored: ended nearer to the mirror image of the truth. "
        f"Diverged: ended farther off than {escape(limits)} (SI).{escaped}",
        table(["filter", *LOST, "all"], rows),
    )


def _cost(c: Comparison, mark: str) -> str:
    rows = []
    for name, cost in c.costs.items():
        calls = " + ".join("–" if n is None else str(n) for n in cost.evaluations)
        rows.append(
            [
                _named(c, name),
                *(significant(float(v)) for v in cost.relative),
                f"{1e6 * (cost.predict + cost.update):.3f} µs",
                f"{significant((cost.predict + cost.update) * c.study.steps * c.runs, 2)} s",
                calls,
                f"{c.prepared.get(name, 0.0):.2f} s",
            ]
        )
    return section(
        "Cost",
        "Time of prediction, correction and both, divided by the EKF's, all filters taking turns; a step of one track "
        "in a large batch, and all steps of all runs at that pace; evaluations of motion + sensor in a step, of the "
        "part that is evaluated most often (derivatives in a direction count as one).",
        table(["filter", "predict", "correct", "total", "a step", "all runs", "evaluations", "compiled in"], rows)
        + choices(("group", "filters", group_choices(c), "0"))
        + place(f"{mark}cost", f"{mark}cost/{{group}}"),
    )


def _settings(c: Comparison) -> str:
    study = c.study
    deviation = ", ".join(significant(float(v)) for v in np.sqrt(np.diag(study.prior.cov)))
    rows = [
        ("steps", f"{study.steps}, {significant(float(study.elapsed.mean()))} s apart on average"),
        ("detection", ", ".join(f"{s or 'sensor'} {p:g}" for s, p in study.detections.items())),
        ("prior", f"{', '.join(significant(float(v), 6) for v in study.prior.mean)}; σ {deviation} (SI, radians)"),
    ]
    rows += [(name, parts(c.filters[name])) for name in c.filters]
    rows += [("versions", ", ".join(f"{k} {v}" for k, v in versions().items())), ("took", f"{c.seconds:.1f} s")]
    return settings(rows, " ".join(escape(text) for text in study.about))
