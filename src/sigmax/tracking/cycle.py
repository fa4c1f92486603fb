"""The cycle: predict all tracks, gate, associate, correct, confirm and end, begin new ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.models.checks import numbers
from sigmax.tracking import life as lives
from sigmax.tracking.associate import Associate, Evidence, gnn
from sigmax.tracking.detector import Detector, Scan
from sigmax.tracking.extent import covered
from sigmax.tracking.gate import gated
from sigmax.tracking.initiate import Free, Initiate, Layout
from sigmax.tracking.life import Life, Rule, by_existence
from sigmax.tracking.mixture import firsts, summed
from sigmax.tracking.modes import Modes
from sigmax.tracking.state import Gates, State, Told


@dataclass(frozen=True)
class Cycle:
    """How plots become tracks: every part can be exchanged.

    Attributes:
        modes: the filter, or several that take turns: `Modes([(filter, model)])`.
        detectors: how each sensor of the model detects, by its name.
        initiate: how tracks begin: `single_plot`, `two_point`, `hypotheses`.
        layout: where position and velocity stand in the state.
        associate: which plots they take: `nearest`, `gnn`, `pda`, `jpda`.
        rule: when they are confirmed and end: `m_of_n`, `by_existence`.
        gate: probability that a target's plot lies in its gate.
        birth: probability that a free plot, or pair of plots, is a new target.
        lifetime: seconds that a target stays on average.
        merge: tracks nearer to each other than so many standard deviations are one, see `duplicates`; 0: never.
        extent: m; how far from the middle of a target its own plots may lie, on its course and beside it: so near to
            a confirmed track no other begins, see `covered`.
        max_speed: m/s; a track that is faster is not confirmed, and ends once it is so for certain (by three standard
            deviations).
        moving: (m, m/s) or None; what stands still is no target: a track is confirmed once it is so far from where
            it began, or faster than this for certain (by two standard deviations).
    """

    modes: Modes
    detectors: Mapping[str, Detector]
    initiate: Initiate
    layout: Layout = field(default_factory=Layout)
    associate: Associate = gnn
    rule: Rule = field(default_factory=by_existence)
    gate: float = 0.999
    birth: float = 0.1
    lifetime: float = 1e4
    merge: float = 0.5
    extent: tuple[float, float] = (0.0, 0.0)
    max_speed: float = np.inf
    moving: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        model = self.modes.model
        for sensor in self.detectors:
            if sensor not in model.sensors:
                raise unknown("sensor", sensor, model.sensors)
        for what, value in (("gate", self.gate), ("birth", self.birth)):
            if not 0 < value < 1:
                raise InputError(f"{what} is a probability between 0 and 1; it is {value}")
        if not self.lifetime > 0:
            raise InputError(f"lifetime is in seconds, above 0; it is {self.lifetime}")

    def begin(self) -> State:
        """No tracks yet."""
        return State(lives.Tracks(None, self.modes.empty(), lives.none(len(self.layout.position))), 0, {})

    def checked(self, scan: Scan) -> Scan:
        """The scan with its plots as numbers (k, m).

        Raises:
            InputError: where it does not fit the model.
        """
        model = self.modes.model
        if not isinstance(scan.sensor, str) or scan.sensor not in self.detectors:
            raise unknown("sensor", scan.sensor, self.detectors)
        z = np.asarray(numbers("the plots of a scan", scan.z, missing=True), float)
        names = model.measurement[scan.sensor]
        m = len(names) if names is not None else (z.shape[1] if z.ndim == 2 else 0)
        z = z.reshape(0, m) if z.size == 0 else z
        if z.ndim != 2 or z.shape[1] != m:
            raise InputError(f"the plots of {scan.sensor or 'the sensor'} need the shape (k, {m}); it is {z.shape}")
        if np.ndim(time := numbers("the time of a scan", scan.time)) or not np.isfinite(time):
            raise InputError(f"a scan needs a time in seconds; it is {scan.time}")
        # Of plots that are the same to the last digit, one counts.
        z = np.where(firsts(z)[:, None], z, np.nan)
        u = None if scan.u is None else np.asarray(numbers("u of a scan", scan.u), float)
        if model.sensor_inputs[scan.sensor] and (u is None or not np.isfinite(u).all()):
            raise InputError(f"the sensor {scan.sensor!r} takes inputs: Scan(…, u=) must be finite numbers; it is {u}")
        return Scan(float(time), scan.sensor, z, u)

    def advance(self, state: State, scan: Scan) -> tuple[State, Told]:
        """The state after a scan that is not older than it, and what the scan did."""
        scan = self.checked(scan)
        detector = self.detectors[scan.sensor]
        tracks = state.tracks
        dt = 0.0 if tracks.time is None else scan.time - tracks.time
        beliefs, sound = self.modes.predict(tracks.beliefs, dt)
        life = lives.later(tracks.life, dt, self.lifetime)
        faults, ended = int((~sound).sum()), life.id[~sound]
        if faults:
            beliefs, life = beliefs.take(sound), life.take(sound)
        # Without inputs of its own a sensor takes none.
        u = scan.u if self.modes.model.sensor_inputs[scan.sensor] else None
        pairs = gated(self.modes, beliefs, scan._replace(u=u), self.gate)
        B, k = len(life.id), len(scan.z)
        seen = detector.detects(pairs.expected)
        seen = np.where(np.isfinite(seen), seen, 0.0)
        with np.errstate(divide="ignore"):
            ratio = pairs.log_likelihood(beliefs.weight) + np.log(
                seen[pairs.track] / detector.false(scan.z)[pairs.plot]
            )
        evidence = Evidence(pairs.track, pairs.plot, ratio, np.log1p(-seen * self.gate), life.existence, k)
        found = self.associate(evidence)
        beliefs = self.modes.update(beliefs, pairs.made, pairs.track, found.share)
        hit, plot, nis = _best(pairs.track, pairs.plot, pairs.made.nis, found.share, B)
        life = life.told(scan.time, hit, seen > 0.05, found.existence)
        own = life.confirmed[pairs.track]
        gates = Gates(
            plots=k,
            gated=len(np.unique(pairs.plot)),
            expected=float((seen * self.gate)[life.confirmed].sum()),
            found=float(found.share[own].sum()),
            nis=float((found.share * pairs.made.nis)[own].sum()),
            dof=float((found.share * pairs.made.dof)[own].sum()),
        )
        confirm, drop = self.rule(scan.time, life)
        mean, cov = self.modes.moments(beliefs)
        speed, deviation = self.layout.speed(mean, cov)
        drop |= speed - 3 * deviation > self.max_speed
        confirm &= speed <= self.max_speed
        if self.moving is not None:
            way = np.linalg.norm(mean[:, self.layout.position] - life.origin, axis=1)
            confirm &= (way > self.moving[0]) | (speed - 2 * deviation > self.moving[1])
        life = life._replace(confirmed=life.confirmed | (confirm & ~drop))
        drop |= lives.duplicates(mean, cov, self.layout.position, life, self.merge)
        ended = np.concatenate([ended, life.id[drop]])
        if drop.any():
            stay = ~drop
            beliefs, life = beliefs.take(stay), life.take(stay)
            mean, cov, plot, nis = (a[stay] for a in (mean, cov, plot, nis))
        memory, next_id = state.memory, state.next_id
        if detector.locate is not None:
            free = 1 - np.minimum(summed(found.share, pairs.plot, k), 1) > 0.5
            memory, next_id, born, started = self._begun(
                state, scan, np.flatnonzero(free), mean[life.confirmed], cov[life.confirmed]
            )
            if len(started.id):
                fresh_mean, fresh_cov = self.modes.moments(born.beliefs)
                beliefs, life = beliefs.joined(born.beliefs), life.joined(started)
                mean, cov = np.concatenate([mean, fresh_mean]), np.concatenate([cov, fresh_cov])
                plot = np.concatenate([plot, born.plot])
                nis = np.concatenate([nis, np.full(len(born.plot), np.nan)])
        told = Told(
            scan.time,
            scan.sensor,
            life.id,
            life.confirmed,
            life.existence,
            mean,
            cov,
            beliefs.weight,
            plot,
            nis,
            gates,
            ended,
            faults,
        )
        return State(lives.Tracks(scan.time, beliefs, life), next_id, memory), told

    def _begun(
        self, state: State, scan: Scan, free: np.ndarray, mean: np.ndarray, cov: np.ndarray
    ) -> tuple[Mapping[str, Any], int, Any, Life]:
        """Tracks that begin with the free plots, where confirmed ones have these moments."""
        locate = self.detectors[scan.sensor].locate
        assert locate is not None
        whole = free[np.isfinite(scan.z[free]).all(1)]
        where = locate(scan.z[whole], scan.u)
        apart = ~covered(where.position, mean, cov, self.layout, *self.extent)
        where, whole = where.take(apart), whole[apart]
        # Of plots on one spot, one begins a track.
        cell = 3 * np.sqrt(np.einsum("kii->k", where.cov).max(initial=1e-300))
        first = firsts(np.round(where.position / cell))
        births, remembered = self.initiate(
            Free(scan.time, where.take(first), whole[first]), state.memory.get(scan.sensor)
        )
        memory = {**state.memory, scan.sensor: remembered}
        priors = self.layout.priors(births, self.modes.model)
        started = Life.begun(state.next_id, births.position, scan.time, self.birth, births.plots)
        return memory, state.next_id + len(births.plot), _Born(self.modes.start(*priors), births.plot), started


class _Born(NamedTuple):
    beliefs: Any
    plot: np.ndarray


def _best(
    track: np.ndarray, plot: np.ndarray, nis: np.ndarray, share: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each track most likely had a plot, which, and its NIS."""
    order = np.argsort(share, kind="stable")
    best = np.full(count, -1)
    best[track[order]] = order
    hit = np.bincount(track, share, count) > 0.5
    place = np.where(hit, best, -1)
    chosen = place >= 0
    told_plot, told_nis = np.full(count, -1), np.full(count, np.nan)
    told_plot[chosen], told_nis[chosen] = plot[place[chosen]], nis[place[chosen]]
    return hit, told_plot, told_nis
