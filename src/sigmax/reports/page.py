"""The page: everything in one file that opens without a network."""

from collections.abc import Sequence
from html import escape

import numpy as np

import sigmax
from sigmax.algebra.factor import Diagonal
from sigmax.modelling.noise import Noise
from sigmax.models import SwitchingModel
from sigmax.records import Outcome, Record
from sigmax.reports.document import (
    choices,
    data,
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
from sigmax.reports.examination_section import TrackExamination, examination_section
from sigmax.reports.figures import (
    Figure,
    Shown,
    colour,
    component_figure,
    limit,
    modes_figure,
    nis_figure,
    path_figure,
    shown_in,
    weights_figure,
)
from sigmax.reports.grade import Grade, grade
from sigmax.reports.score import Score
from sigmax.reports.verdict import RULES, best, nis_in_words, significant, verdict
from sigmax.reports.weight_counts import WeightCounts
from sigmax.spaces import in_world_axes, readable

# Tracks whose components are drawn; the folder's estimates hold all of them.
_TRACKS = 24
_CLASS = {Grade.CONSISTENT: "good"} | dict.fromkeys((Grade.NEAR, Grade.HEAVY, Grade.CAUTIOUS, Grade.UNKNOWN), "near")


def page(
    record: Record, outcomes: Sequence[Outcome], scores: Sequence[Score], examined: TrackExamination | None = None
) -> str:
    """The report as HTML."""
    ran = [(i, s.label, o) for i, (o, s) in enumerate(zip(outcomes, scores, strict=True)) if o.result is not None]
    chosen = best(scores)
    advised = next((i for i, s in enumerate(scores) if s is chosen), ran[0][0] if ran else 0)
    figures: dict[str, Figure] = {}
    sections = [_verdict(record, scores), _table(scores), *examination_section(record, examined, figures)]
    apart = {i for i, s in enumerate(scores) if not grade(s).believable}
    path = path_figure(record, ran, advised, apart) if ran else None
    if path is not None:
        figures["path"] = path
        sections.append(_path(record, scores[advised]))
    if ran:
        sections.append(_components(record, ran, advised, figures))
        found = nis_figure(record, ran)
        if found is not None:
            figures["nis"], window = found
            sections.append(_nis(window, len(record.tracks)))
        result = outcomes[advised].result
        modes = None if result is None else modes_figure(record, result)
        if modes is not None:
            figures["modes"] = modes
            sections.append(_modes(record, scores[advised]))
        weights = weights_figure(record, ran)
        if weights is not None:
            figures["weights"] = weights
            sections.append(_weights(scores))
    sections += [
        _settings(record, outcomes, scores),
        data(record.source, record.licence, (*record.doubts, *record.notes)),
    ]
    tracks = "" if len(record.tracks) == 1 else f"{len(record.tracks)} tracks, "
    about = f"Record {record.name}: {tracks}{int(record.steps.sum()):,} steps, {_duration(record)}."
    return document(record.title, f"{about} Tracked with sigmax {sigmax.__version__}.", sections, figures)


def _duration(record: Record) -> str:
    seconds = float((record.time[np.arange(len(record.steps)), record.steps - 1] - record.time[:, 0]).max())
    for unit, size in (("days", 86400 * 2), ("hours", 3600 * 2), ("minutes", 60 * 2)):
        if seconds >= size:
            return f"{significant(2 * seconds / size)} {unit}"
    return f"{significant(seconds)} s"


def _verdict(record: Record, scores: Sequence[Score]) -> str:
    headline, sentences = verdict(scores)
    chosen = best(scores)
    if chosen is not None and chosen.constants:
        found = [_estimate(record, name, *value) for name, value in chosen.constants.items()]
        sentences = [*sentences, f"{chosen.label} found {', '.join(found)}."]
    grades = {grade(s) for s in scores}
    if chosen is not None and grade(chosen).believable:
        return lead(headline, sentences)
    unsettled = grades & {Grade.HEAVY, Grade.CAUTIOUS, Grade.UNKNOWN}
    return lead(headline, sentences, "open" if unsettled else "none")


def _estimate(record: Record, name: str, mean: float, deviation: float) -> str:
    factor, unit = shown_in(record.components[name])
    digits = max(0, 1 - int(np.floor(np.log10(deviation * factor)))) if deviation > 0 else 4
    return f"{name} = {mean * factor:.{digits}f} ± {deviation * factor:.{digits}f}{f' {unit}' if unit else ''}"


def _table(scores: Sequence[Score]) -> str:
    truth = any(s.rmse_position_m is not None for s in scores)
    position = ["position RMSE"] if truth else []
    heads = ["filter", *position, "mean NIS", "run time", "faults", "covariance"]
    rows = []
    for i, s in enumerate(scores):
        label = dotted(s.label, colour(i))
        if s.failure:
            rows.append([label, *["–"] * (len(heads) - 2), graded("failed")])
            continue
        mean, expected = nis_in_words(s)
        far = [f"{significant(s.rmse_position_m)} m" if s.rmse_position_m is not None else "–"] if truth else []
        word = graded(grade(s).value, _CLASS.get(grade(s), "bad"))
        rows.append([label, *far, small(mean, f"expected {expected}"), _seconds(s), str(s.faults), word])
    return filters(heads, rows, RULES)


def _seconds(score: Score) -> str:
    if score.compile_seconds is None:
        note = "with compiling"
    elif score.compile_seconds < 0.05:
        note = "compiled before"
    else:
        note = f"+ {significant(score.compile_seconds, 2)} s compiling"
    return small(f"{significant(score.seconds or 0.0, 2)} s", note)


def _path(record: Record, advised: Score) -> str:
    third = " Seen from above." if len(record.position) > 2 else ""
    many = " Long paths are drawn at evenly spaced steps." if record.steps.max() > limit(1) else ""
    return section(
        "Path",
        f"Ellipses hold two standard deviations of {escape(advised.label)} at some of its steps.{third}{many} "
        "Touch a name to show or hide it; drag to zoom, double click to return.",
        place("path", "path"),
    )


def _components(record: Record, ran: Sequence[Shown], advised: int, figures: dict[str, Figure]) -> str:
    tracks = min(len(record.tracks), _TRACKS)
    points = limit(len(ran) * tracks * len(record.components))
    for index, _, outcome in ran:
        for track in range(tracks):
            figures[f"components/{index}/{track}"] = component_figure(record, outcome, track, index, points)
    chosen = choices(
        ("filter", "filter", [(str(i), label) for i, label, _ in ran], str(advised)),
        ("track", "track", [(str(k), record.tracks[k]) for k in range(tracks)], "0"),
    )
    more = (
        f" The first {tracks} of {len(record.tracks)} tracks are here, all of them in estimates.parquet."
        if tracks < len(record.tracks)
        else ""
    )
    thinned = (
        f" Long series are thinned to {points} points: the least and the largest of equal stretches."
        if record.steps.max() > points
        else ""
    )
    known = ~np.isnan(record.truth[record.real]).all(0)
    what = (
        "The error of each component"
        if known.all()
        else "Each component's error, or the component itself where there is no truth,"
        if known.any()
        else "Each component"
    )
    return section(
        "Components",
        f"{what} with the ±2σ the filter claims.{more}{thinned}",
        chosen + place("components", "components/{filter}/{track}"),
    )


def _nis(window: int, tracks: int) -> str:
    pooled = " of all tracks together" if tracks > 1 else ""
    return section(
        "Can the covariance be believed?",
        f"NIS divided by the number of measured components, averaged over the last {window} times with a "
        f"measurement{pooled}. An honest filter stays about 1, mostly within the grey band (95 %).",
        place("nis", "nis"),
    )


def _modes(record: Record, score: Score) -> str:
    rows = [[escape(name), f"{100 * share:.1f} %"] for name, share in score.modes.items()]
    of = " of the first track" if len(record.tracks) > 1 else ""
    return section(
        "Which mode",
        f"The probability of each mode at each step{of}, given what was measured until then, by {escape(score.label)}. "
        "The table has the share of all steps.",
        table(("mode", "share"), rows) + place("modes", "modes"),
    )


def _weights(scores: Sequence[Score]) -> str:
    rows = [
        [dotted(s.label, colour(i)), escape(sensor), f"{w.measurements:,}", _share(w.lowered, w), _share(w.refused, w)]
        for i, s in enumerate(scores)
        for sensor, w in s.weighed.items()
    ]
    heads = ("filter", "sensor", "measurements", "less than half their weight", "refused")
    return section(
        "What was not taken in full",
        "The weight of each measurement: a robust update divides its variance by it. 1 counts in full, 0 is refused.",
        table(heads, rows) + place("weights", "weights"),
    )


def _share(count: int, of: WeightCounts) -> str:
    return small(f"{count:,}", f"{100 * count / max(of.measurements, 1):.1f} %")


def _settings(record: Record, outcomes: Sequence[Outcome], scores: Sequence[Score]) -> str:
    model = record.model
    mean, cov = np.atleast_2d(record.prior.mean)[0], np.asarray(record.prior.cov).reshape(-1, model.dim, model.dim)[0]
    cov = in_world_axes(model.space, mean, in_world_axes(model.space, mean, cov).T)

    def started(names: Sequence[str], mean: np.ndarray, cov: np.ndarray) -> str:
        found = zip(names, mean, np.sqrt(np.diag(cov)), strict=True)
        return ", ".join(_estimate(record, str(n), m, s) for n, m, s in found)

    each = " of the first track" if len(record.tracks) > 1 else ""
    rows = [(f"prior{each}", started(model.deviations, readable(model.space, mean), cov))]
    modes = model.modes if isinstance(model, SwitchingModel) else {"": model}
    rows += [(f"noise of the motion{f' in {n}' if n else ''}, per second", _noise(m.Q)) for n, m in modes.items()]
    first = next(iter(modes.values()))
    if model.bias is not None:
        offsets = model.bias.prior
        rows.append(("prior of the bias", started(model.bias.names, offsets.mean, offsets.cov)))
        rows.append(("noise of the bias, per second", _noise(model.bias.Q)))
    rows += [(f"noise of {s or 'the sensor'}", _noise(R)) for s, R in first.R.items()]
    rows += [(s.label, parts(o.trial.filter)) for o, s in zip(outcomes, scores, strict=True)]
    rows.append(("versions", ", ".join(f"{name} {value}" for name, value in versions().items())))
    return settings(rows)


def _noise(given: Noise) -> str:
    if callable(given):
        return "a function"
    if isinstance(given, Diagonal):
        return "standard deviations " + ", ".join(f"{v:.4g}" for v in np.sqrt(np.asarray(given.entries)))
    return "covariance " + str(np.asarray(given).round(9).tolist())
