"""The cycle: predict all tracks, gate, associate, correct, confirm and end, begin new ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import numbers
from sigmax.tracking import life as lives
from sigmax.tracking.associate import Associate, Evidence, gnn
from sigmax.tracking.branches import Branches, MultiHypothesis
from sigmax.tracking.detector import Detector, Scan
from sigmax.tracking.extent import covered
from sigmax.tracking.follow import associated, branched
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
        associate: which plots they take: `nearest`, `gnn`, `pda`, `jpda`, `mht()`.
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
    associate: Associate | MultiHypothesis = gnn
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
        if all(detector.locate is None for detector in self.detectors.values()):
            raise InputError(
                "no sensor can begin tracks, as none tells where its plots are: give Detector(…, locate=) to one. Of "
                "bearings or ranges alone it is not known which plots belong together before there are tracks; of one "
                "target sigmax.start finds the state"
            )
        for what, value in (("gate", self.gate), ("birth", self.birth)):
            if not 0 < value < 1:
                raise InputError(f"{what} is a probability between 0 and 1; it is {value}")
        if not self.lifetime > 0:
            raise InputError(f"lifetime is in seconds, above 0; it is {self.lifetime}")

    def begin(self) -> State:
        """No tracks yet."""
        branches = None
        if isinstance(self.associate, MultiHypothesis):
            branches = Branches.begun(np.empty(0, int), self.associate.scans, self.birth)
        return State(lives.Tracks(None, self.modes.empty(), lives.none(len(self.layout.position))), 0, {}, branches)

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
        # By their numbers, so that nothing hangs on the order in which plots are handed in: which of several on one
        # spot begins a track, say.
        order = np.lexsort(scan.z.T[::-1]) if len(scan.z) else np.empty(0, int)
        scan = scan._replace(z=scan.z[order])
        detector = self.detectors[scan.sensor]
        tracks = state.tracks
        dt = 0.0 if tracks.time is None else scan.time - tracks.time
        beliefs, sound = self.modes.predict(tracks.beliefs, dt)
        life = lives.later(tracks.life, dt, self.lifetime)
        faults, ended, branches = int((~sound).sum()), life.id[~sound], state.branches
        if faults:
            if branches is not None:
                # A family ends with the branch that stands for it.
                ended = life.id[~sound & branches.best]
                sound &= ~np.isin(life.id, ended)
                branches = branches.take(sound)
            beliefs, life = beliefs.take(sound), life.take(sound)
        # Without inputs of its own a sensor takes none.
        u = scan.u if self.modes.model.sensor_inputs[scan.sensor] else None
        pairs = gated(self.modes, beliefs, scan._replace(u=u), self.gate)
        k = len(scan.z)
        seen = detector.detects(pairs.expected)
        seen = np.where(np.isfinite(seen), seen, 0.0)
        with np.errstate(divide="ignore"):
            ratio = pairs.log_likelihood(beliefs.weight) + np.log(
                seen[pairs.track] / detector.false(scan.z)[pairs.plot]
            )
        evidence = Evidence(pairs.track, pairs.plot, ratio, np.log1p(-seen * self.gate), life.existence, k)
        args = scan.time, beliefs, life, pairs, evidence, seen > 0.05
        if isinstance(self.associate, MultiHypothesis):
            assert branches is not None
            after = branched(self.modes, self.associate, *args, branches)
        else:
            after = associated(self.modes, self.associate, *args)
        own = life.confirmed[pairs.track]
        confirmed = life.confirmed if branches is None else life.confirmed & branches.best
        gates = Gates(
            plots=k,
            gated=len(np.unique(pairs.plot)),
            expected=float((seen * self.gate)[confirmed].sum()),
            found=float(after.share[own].sum()),
            nis=float((after.share * pairs.made.nis)[own].sum()),
            dof=float((after.share * pairs.made.dof)[own].sum()),
        )
        beliefs, life, branches = after.beliefs, after.life, after.branches
        # What is decided of a track is decided by its branch in the likeliest hypothesis, for all of them.
        reported = beliefs.take(after.reported)
        main = life.take(after.reported)
        plot, nis = after.plot[after.reported], after.nis[after.reported]
        confirm, drop = self.rule(scan.time, main)
        (mean, cov), weight = self.modes.moments(reported), reported.weight
        speed, deviation = self.layout.speed(mean, cov)
        drop |= speed - 3 * deviation > self.max_speed
        confirm &= speed <= self.max_speed
        if self.moving is not None:
            way = np.linalg.norm(mean[:, self.layout.position] - main.origin, axis=1)
            confirm &= (way > self.moving[0]) | (speed - 2 * deviation > self.moving[1])
        main = main._replace(confirmed=main.confirmed | (confirm & ~drop))
        life = life._replace(confirmed=main.confirmed[after.track])
        drop |= lives.duplicates(mean, cov, self.layout.position, main, self.merge)
        ended = np.concatenate([ended, main.id[drop]])
        stay = ~drop[after.track]
        if branches is not None:
            mean, cov, weight = after.estimates(self.modes, branches.best)
        if drop.any():
            beliefs, life = beliefs.take(stay), life.take(stay)
            branches = None if branches is None else branches.take(stay)
            main = main.take(~drop)
            mean, cov, plot, nis, weight = (a[~drop] for a in (mean, cov, plot, nis, weight))
        memory, next_id = state.memory, state.next_id
        if detector.locate is not None:
            free = 1 - np.minimum(summed(after.share, pairs.plot, k), 1) > 0.5
            memory, next_id, born, started = self._begun(
                state, scan, np.flatnonzero(free), mean[main.confirmed], cov[main.confirmed]
            )
            if len(started.id):
                fresh_mean, fresh_cov = self.modes.moments(born.beliefs)
                if isinstance(self.associate, MultiHypothesis) and branches is not None:
                    # Whether it is a target, and its plot is not another's, later scans decide.
                    branches = branches.joined(Branches.begun(born.plot, self.associate.scans, self.birth))
                beliefs, life, main = beliefs.joined(born.beliefs), life.joined(started), main.joined(started)
                mean, cov = np.concatenate([mean, fresh_mean]), np.concatenate([cov, fresh_cov])
                weight = np.concatenate([weight, born.beliefs.weight])
                plot = np.concatenate([plot, born.plot])
                nis = np.concatenate([nis, np.full(len(born.plot), np.nan)])
        told = Told(
            scan.time,
            scan.sensor,
            main.id,
            main.confirmed,
            main.existence,
            mean,
            cov,
            weight,
            np.append(order, -1)[plot],
            nis,
            gates,
            ended,
            faults,
        )
        return State(lives.Tracks(scan.time, beliefs, life), next_id, memory, branches), told

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
