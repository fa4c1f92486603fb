"""The page of tracks: a map with a scrubber over time, the life of every track, errors, sensors."""

from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

import sigmax
from sigmax.reports.document import data, document, dotted, graded, lead, packed, place, section, table
from sigmax.reports.figures.draw import COLOURS, MUTED, Figure, line, safe
from sigmax.reports.tracking_outcome import TrackingOutcome
from sigmax.reports.verdict import significant
from sigmax.views.thin import stride

# What the page may hold.
_PLOTS, _TRACKS, _POINTS = 30_000, 400, 60_000


def tracks_page(run: TrackingOutcome) -> str:
    """The report as HTML."""
    record = run.record
    figures: dict[str, Figure] = {"life": _life(run)}
    sections = [_verdict(run), _map(run), section("Life of the tracks", _LIFE, place("life", "life"))]
    if record.truth:
        figures["error"] = _errors(run)
        sections.append(
            section("Distance from the truth", "Of the matched track, target by target.", place("error", "error"))
        )
    sections += [_sensors(run), _data(run)]
    about = (
        f"Record {record.name}: {len(run.history):,} scans over {significant(run.quality.minutes)} minutes, "
        f"{len(run.confirmed)} confirmed tracks, filter {run.trial.name}. Tracked with sigmax {sigmax.__version__}."
    )
    return document(record.title, about, sections, figures)


_LIFE = "A bar from the confirmation of a track to its end, in the colour of the target it followed; grey: of none."


def _verdict(run: TrackingOutcome) -> str:
    q = run.quality
    if not run.record.truth:
        return section("Tracks", "", f"<p>{len(run.confirmed)} confirmed tracks; no truth to compare with.</p>")
    rows = []
    for i, t in enumerate(run.record.truth):
        rmse = "–" if np.isnan(q.rmse[t.name]) else f"{significant(q.rmse[t.name])} m"
        tracks = ", ".join(map(str, dict.fromkeys(i for _, i, _ in q.matched[t.name]))) or "–"
        rows.append([dotted(t.name, COLOURS[i % len(COLOURS)]), rmse, f"{q.held[t.name]:.0%}", tracks])
    lost = [
        f"{x.target} had no track from {x.start:.0f} to {x.end:.0f} s. Scans with a plot nearer to it "
        f"than {significant(run.record.cutoff / 2)} m, and not nearer to another target: "
        f"{', '.join(f'{s} {v:.0%}' for s, v in x.seen.items())}."
        for x in run.losses[:40]
    ]
    said = (
        f"{q.switches} switches between targets, {q.breaks} times a target went on under another number, "
        f"{q.false_tracks} false tracks ({significant(q.false_per_minute)} a minute). "
        f"Mean OSPA {significant(q.ospa)} m, GOSPA {significant(q.gospa)} m, cut off at {run.record.cutoff:g} m."
    )
    heads = ["target", "RMSE of its track", "held", "tracks"]
    return lead(said, lost, body=table(heads, rows))


def _map(run: TrackingOutcome) -> str:
    start, end = run.history[0].time, run.history[-1].time
    a, b, names = _axes(run)
    plots = []
    total = sum(len(t) for t, _ in run.plots.values())
    for i, (sensor, (t, p)) in enumerate(run.plots.items()):
        some = slice(None, None, max(1, total // _PLOTS))
        # Colours of sensors from the end of the list, those of targets from its beginning.
        shade = COLOURS[-1 - i % len(COLOURS)]
        plots.append({"name": safe(sensor), "colour": shade, **_points(t[some], p[some], a, b)})
    chosen = sorted(run.confirmed, key=lambda k: -len(run.confirmed[k][0]))[:_TRACKS]
    each = max(20, _POINTS // max(len(chosen), 1))
    tracks = []
    for k in sorted(chosen):
        t, p, P = run.confirmed[k]
        r = stride(len(t), each)
        tracks.append({"id": k, "colour": _colour(run, k), **_points(t[r], p[r], a, b), "e": _ellipses(P[r], a, b)})
    truth = []
    for target in run.record.truth:
        r = stride(len(target.time), each)
        truth.append({"name": safe(target.name), **_points(target.time[r], target.position[r], a, b)})
    shown = [*tracks, *truth] or plots
    ranges = []
    for axis in "xy":
        values = np.array([v for one in shown for v in one[axis]] or [0.0, 1.0])
        margin = 0.08 * max(float(np.ptp(values)), 1.0)
        ranges.append([float(values.min() - margin), float(values.max() + margin)])
    content = {
        "tracks": tracks,
        "plots": plots,
        "truth": truth,
        "ranges": ranges,
        "memory": max(2.0, (end - start) / 60),
        "tail": max(20.0, (end - start) / 4),
        "axes": [safe(f"{n} [m]") for n in names],
    }
    script = files("sigmax.reports").joinpath("tracks.js").read_text(encoding="utf-8")
    more = f" The {_TRACKS} longest of {len(run.confirmed)} tracks." if len(run.confirmed) > _TRACKS else ""
    middle = start + 0.7 * (end - start)
    body = (
        '<div class="choose"><button id="play" type="button">Play</button>'
        f'<input id="moment" type="range" aria-label="time" style="flex:1" min="{start:.3f}" max="{end:.3f}" '
        f'step="any" value="{middle:.3f}"><span id="moment-told"></span></div>'
        '<div id="map" style="min-height:460px"></div>'
        f"{packed('tracks', content)}<script>{script}</script>"
    )
    about = f"Confirmed tracks with their 2σ ellipses, the plots just before, and the truth in grey.{more}"
    return section("Map", f"{about} Draw the slider through time; drag on the map to zoom.", body)


def _axes(run: TrackingOutcome) -> tuple[int, int, list[str]]:
    state = run.cycle.modes.model.state
    names = [str(state[i]) for i in run.position[:2]]
    # Maps have north above.
    return (1, 0, ["east", "north"]) if names == ["north", "east"] else (0, 1, names)


def _points(t: np.ndarray, p: np.ndarray, a: int, b: int) -> dict[str, Any]:
    return {k: np.round(v, 3).tolist() for k, v in (("t", t), ("x", p[:, a]), ("y", p[:, b]))}


def _ellipses(P: np.ndarray, a: int, b: int) -> list[list[float]]:
    """Half axes and direction of each covariance."""
    places = np.array([a, b])
    values, vectors = np.linalg.eigh(P[:, places[:, None], places])
    angle = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
    axes = np.sqrt(np.maximum(values, 0))
    return np.round(np.stack([axes[:, 1], axes[:, 0], angle], axis=1), 3).tolist()


def _colour(run: TrackingOutcome, track: int) -> str:
    for i, target in enumerate(run.record.truth):
        if any(k == track for _, k, _ in run.quality.matched[target.name]):
            return COLOURS[i % len(COLOURS)]
    return MUTED if run.record.truth else COLOURS[track % len(COLOURS)]


def _life(run: TrackingOutcome) -> Figure:
    data = []
    for row, k in enumerate(sorted(run.confirmed)[:_TRACKS]):
        t = run.confirmed[k][0]
        shade = _colour(run, k)
        bar = line(f"track {k}", [float(t[0]), float(t[-1])], np.array([row, row], float), shade, width=7)
        data.append(bar | {"showlegend": False, "hoverinfo": "name+x"})
    ids = [str(k) for k in sorted(run.confirmed)[:_TRACKS]]
    every = max(1, len(ids) // 40)
    ticks = {"tickvals": list(range(0, len(ids), every)), "ticktext": ids[::every]}
    return {
        "data": data,
        "layout": {
            "xaxis": {"title": {"text": "time [s]"}},
            "yaxis": {"title": {"text": "track"}, "autorange": "reversed", **ticks},
            "height": int(np.clip(60 + 18 * len(ids), 180, 900)),
        },
    }


def _errors(run: TrackingOutcome) -> Figure:
    data = []
    for i, target in enumerate(run.record.truth):
        found = run.quality.matched[target.name]
        if found:
            r = stride(len(found), 1500)
            t, e = np.array([m[0] for m in found])[r], np.array([m[2] for m in found])[r]
            data.append(line(target.name, t, e, COLOURS[i % len(COLOURS)], width=1.6))
    return {
        "data": data,
        "layout": {
            "xaxis": {"title": {"text": "time [s]"}},
            "yaxis": {"title": {"text": "distance [m]"}, "rangemode": "tozero"},
            "height": 320,
        },
    }


def _sensors(run: TrackingOutcome) -> str:
    rows = []
    for h in run.health:
        nis = "–" if np.isnan(h.nis) else significant(h.nis)
        word = graded(h.words) if h.words else graded("nothing unusual", "good")
        found = f"{h.found:.0f} of {h.expected:.0f}"
        rows.append([escape(h.sensor or "sensor"), str(h.scans), str(h.plots), str(h.gated), found, nis, word])
    heads = ["sensor", "scans", "plots", "in a gate", "found of expected", "NIS / components", "what the gates say"]
    about = "Expected are the plots that confirmed tracks should have had by the probability of detection."
    return section("Sensors", about, table(heads, rows))


def _data(run: TrackingOutcome) -> str:
    record = run.record
    words = {
        "taken": "taken as they came",
        "late": "late, put into their place",
        "refused": "too late, refused",
        "repeated": "repeated, left out",
        "jumped": "refused for a jump of the clock",
        "restarts": "times the clock went back and tracking began anew",
    }
    told = [f"{run.counts[k]:,} {w}" for k, w in words.items() if run.counts[k]]
    items = [f"Scans: {', '.join(told)}.", f"{1e3 * run.seconds / max(len(run.history), 1):.1f} ms a scan."]
    items += record.notes
    if record.skipped:
        items.append(f"Rows that could not be read were skipped: {'; '.join(record.skipped)}")
    return data(record.source, record.licence, items)
