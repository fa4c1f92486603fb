"""What came of tracking plots: the history, its quality, the losses and their reasons."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sigmax.records import Trial
from sigmax.records.plots import PlotRecord
from sigmax.tracking import Cycle, Quality, Scan, SensorHealth, Told, health, quality
from sigmax.tracking.detector import Locate


class Loss(NamedTuple):
    """A stretch of time without a track for a target, and by sensor the share of scans with a plot near it."""

    target: str
    start: float
    end: float
    seen: dict[str, float]


@dataclass(frozen=True)
class TrackingOutcome:
    """A run of the tracker over a record of plots.

    Attributes:
        record: the plots.
        trial: the filter.
        cycle: how tracks were made.
        history: what each scan did.
        counts: scans by what became of them.
        seconds: the run.
    """

    record: PlotRecord
    trial: Trial
    cycle: Cycle
    history: list[Told]
    counts: Counter[str]
    seconds: float

    @property
    def position(self) -> tuple[int, ...]:
        """Where the position stands in the state."""
        return self.cycle.layout.position

    @cached_property
    def quality(self) -> Quality:
        """Against the truth, as far as it is known."""
        return quality(self.history, self.record.truth, self.position, self.record.cutoff)

    @cached_property
    def health(self) -> list[SensorHealth]:
        """What the gates say of the sensors."""
        return health(self.history)

    @cached_property
    def confirmed(self) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """By track: times (k,), positions (k, d) and their covariances (k, d, d), since it was confirmed."""
        rows: dict[int, list[tuple[float, np.ndarray, np.ndarray]]] = {}
        at = np.array(self.position)
        for told in self.history:
            for i in np.flatnonzero(told.confirmed):
                rows.setdefault(int(told.id[i]), []).append((told.time, told.mean[i, at], told.cov[i, at[:, None], at]))
        return {k: tuple(map(np.array, zip(*r, strict=True))) for k, r in rows.items()}  # type: ignore[misc]

    @cached_property
    def plots(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """By sensor that tells positions: times (k,) and positions (k, d) of the plots."""
        found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for scan in sorted(self.record.scans, key=lambda s: s.time):
            locate = self.cycle.detectors[scan.sensor].locate
            if locate is not None and len(place := _places(locate, scan)):
                found.setdefault(scan.sensor, []).append((np.full(len(place), scan.time), place))
        return {s: (np.concatenate([t for t, _ in f]), np.concatenate([p for _, p in f])) for s, f in found.items()}

    @cached_property
    def losses(self) -> list[Loss]:
        """Stretches of over two seconds in which a target had no track, and what the sensors saw of it meanwhile."""
        made = []
        for truth in self.record.truth:
            known = [t.time for t in self.history if truth.time[0] <= t.time <= truth.time[-1]]
            held = {time for time, _, _ in self.quality.matched[truth.name]}
            without = [k for k, time in enumerate(known) if time not in held]
            # Where the next time without a track is not the next time at all, a stretch ends.
            for stretch in np.split(without, np.flatnonzero(np.diff(without) > 1) + 1) if without else ():
                start, end = known[stretch[0]], known[stretch[-1]]
                if end - start > 2.0:
                    made.append(Loss(truth.name, start, end, self._seen(truth.name, start, end)))
        return made

    def _seen(self, name: str, start: float, end: float) -> dict[str, float]:
        """The share of scans in which a plot lay near a target, and no other target was nearer to it."""
        hits: dict[str, list[bool]] = {}
        for scan in self.record.scans:
            locate = self.cycle.detectors[scan.sensor].locate
            if not start <= scan.time <= end or locate is None:
                continue
            where = {t.name: p for t in self.record.truth if (p := t.at(scan.time)) is not None}
            if name not in where:
                continue
            place = _places(locate, scan)
            hit = False
            if len(place):
                distance = {k: np.linalg.norm(place - p, axis=1) for k, p in where.items()}
                nearest = np.min(np.stack(list(distance.values())), axis=0)
                hit = bool(((distance[name] <= nearest) & (distance[name] < self.record.cutoff / 2)).any())
            hits.setdefault(scan.sensor, []).append(hit)
        return {sensor: float(np.mean(found)) for sensor, found in hits.items()}


def _places(locate: Locate, scan: Scan) -> np.ndarray:
    """Positions (k, d) of the plots that are whole."""
    z = np.asarray(scan.z, float)
    if not z.size:
        return np.empty((0, 2))
    return locate(z[np.isfinite(z).all(1)], scan.u).position


def summary_of(run: TrackingOutcome, versions: dict[str, str]) -> dict[str, Any]:
    """The content of summary.json; null where there is no truth."""
    q, record = run.quality, run.record
    known = bool(record.truth)
    rmse = {n: None if np.isnan(v) else v for n, v in q.rmse.items()}
    found = [v for v in rmse.values() if v is not None]
    return {
        "record": record.name,
        "title": record.title,
        "filter": run.trial.name,
        "targets": len(record.truth),
        "matched_rmse_m": rmse if known else None,
        "mean_matched_rmse_m": float(np.mean(found)) if found else None,
        "held": q.held if known else None,
        "switches": q.switches if known else None,
        "breaks": q.breaks if known else None,
        "false_tracks": q.false_tracks if known else None,
        "false_tracks_per_minute": q.false_per_minute if known else None,
        "ospa_m": q.ospa if known and np.isfinite(q.ospa) else None,
        "gospa_m": q.gospa if known and np.isfinite(q.gospa) else None,
        "cutoff_m": record.cutoff,
        "losses": [loss._asdict() for loss in run.losses],
        "confirmed_tracks": len(run.confirmed),
        "minutes": q.minutes,
        "scans": dict(run.counts),
        "skipped_rows": list(record.skipped),
        "sensors": {
            h.sensor: {**h._asdict(), "nis": None if np.isnan(h.nis) else h.nis, "words": h.words or None}
            for h in run.health
        },
        "seconds": run.seconds,
        "milliseconds_per_scan": 1e3 * run.seconds / max(len(run.history), 1),
        "source": record.source,
        "licence": record.licence,
        "notes": list(record.notes),
        "versions": versions,
    }
