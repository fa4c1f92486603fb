"""The service without its sockets: lines in, updates out, a checkpoint beside."""

import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import orjson

from sigmax.errors import InputError
from sigmax.serving.checkpoint import Checkpoint
from sigmax.serving.feed import Feed, Message
from sigmax.serving.gather import Gathering
from sigmax.serving.lines import Line, quoted
from sigmax.tracking import Scan, Told, Tracker
from sigmax.tracking.tracker import Saved

# Senders that number their lines are remembered up to so many.
_SOURCES = 1000
# Seconds of work after which the state is kept, so that going on after a crash takes about as long at most.
_REPEATED = 5.0
FLUSH = Line(b'{"flush":true}', True)


class Verdict(NamedTuple):
    """What became of a line: taken, or why not."""

    line: Line
    taken: bool
    why: str = ""


class _Kept(NamedTuple):
    """All of a service that outlives it."""

    tracker: Saved
    gathering: Gathering
    serials: dict[str, int]
    counts: dict[str, int]
    updates: int


class Service:
    """Takes lines and gives updates; with a checkpoint it goes on where an earlier one ended, however it ended.

    `accept` and `work` follow each other: a line that `accept` has taken is durable, and the next `work` tracks it.

    Args:
        feed: what lines mean.
        checkpoint: where the state is kept, or None.
        tentative: whether updates tell of tracks that are not confirmed, too.

    Attributes:
        counts: lines "taken", "refused" and "repeated" (a serial number had already been taken), and scans "failed".
        serials: the last serial number of each source.
        failures: why scans could not be tracked, in words, the latest of those that nobody has taken out yet.

    Raises:
        InputError: where the checkpoint does not fit.
    """

    def __init__(self, feed: Feed, checkpoint: Checkpoint | None = None, *, tentative: bool = False) -> None:
        self.feed, self.checkpoint, self.tentative = feed, checkpoint, tentative
        self.tracker = Tracker(feed.cycle, window=feed.window)
        self.counts: Counter[str] = Counter()
        self.serials: dict[str, int] = {}
        self.failures: deque[str] = deque(maxlen=100)
        self._gathering = Gathering.nothing()
        self._updates = 0
        self._due: list[Message] = []
        # Seconds of work since the state was last kept.
        self._worked = 0.0
        self.latest: bytes | None = None
        _compile(feed)
        if checkpoint is not None:
            self._resume(checkpoint)

    @property
    def open(self) -> bool:
        """Whether a scan waits for further plots."""
        return bool(self._gathering.open)

    @property
    def hello(self) -> bytes:
        """The line that every consumer is sent first."""
        return orjson.dumps({"state": list(self.feed.units), "units": list(self.feed.units.values())})

    def accept(self, lines: Sequence[Line]) -> list[Verdict]:
        """What becomes of each line; those taken are in the journal before this returns."""
        verdicts = [self._judged(line) for line in lines]
        taken = [v.line.text for v in verdicts if v.taken and not v.why]
        if self.checkpoint is not None:
            self.checkpoint.append(taken)
        return verdicts

    def work(self) -> Iterator[bytes]:
        """Track what has been accepted; an update for each scan."""
        yield from self._tracked()
        if self.checkpoint is not None and (self.checkpoint.full or self._worked > _REPEATED):
            self.keep()

    def keep(self) -> None:
        """Write the state to the checkpoint, where there is one; everything accepted must have been worked off."""
        if self.checkpoint is not None:
            assert not self._due
            self.checkpoint.keep(
                _Kept(self.tracker.save(), self._gathering, self.serials, dict(self.counts), self._updates)
            )
            self._worked = 0.0

    def _judged(self, line: Line) -> Verdict:
        if not line.whole:
            self.counts["refused"] += 1
            return Verdict(line, False, "the line is too long")
        try:
            message = self.feed.read(line.text)
            for plot in message.plots:
                self._gathering.check(plot)
            if message.serial is not None:
                if message.source not in self.serials and len(self.serials) >= _SOURCES:
                    raise InputError(f"more than {_SOURCES} sources that number their lines")
                if message.serial <= self.serials.get(message.source, message.serial - 1):
                    self.counts["repeated"] += 1
                    return Verdict(line, True, "repeated")
        except InputError as error:
            self.counts["refused"] += 1
            return Verdict(line, False, str(error))
        self._take(message)
        return Verdict(line, True)

    def _take(self, message: Message) -> None:
        if message.serial is not None:
            self.serials[message.source] = message.serial
        self.counts["taken"] += not message.flush
        self._due.append(message)

    def _tracked(self) -> Iterator[bytes]:
        while self._due:
            for scan in self._scans(self._due[0]):
                update = self._step(scan)
                if update is not None:
                    self.latest = update
                    yield update
            self._due.pop(0)

    def _scans(self, message: Message) -> list[Scan]:
        gathering = self._gathering
        if message.flush:
            return gathering.close(list(gathering.open))
        if message.scan is not None:
            # Scans that were over before it come first.
            over = [s for s, o in gathering.open.items() if message.scan.time >= o.until or s == message.scan.sensor]
            return [*gathering.close(over), message.scan]
        return [scan for plot in message.plots for scan in gathering.add(plot, self.feed.periods)]

    def _step(self, scan: Scan) -> bytes | None:
        before, began = self.tracker.save(), time.monotonic()
        try:
            told = self.tracker.step(scan)
        except Exception as error:
            # One scan that cannot be tracked must not end the service, nor end it again when it resumes.
            self.tracker.restore(before)
            self.counts["failed"] += 1
            self.failures.append(f"{scan.sensor or 'the sensor'} at {scan.time:.15g} s: {error}")
            return None
        finally:
            self._worked += time.monotonic() - began
        self.tracker.forget()
        if told is None:
            return None
        self._updates += 1
        # After a late scan the tracks of now are others, too.
        return self._update(self.tracker.history[-1])

    def _update(self, told: Told) -> bytes:
        chosen = np.arange(len(told.id)) if self.tentative else np.flatnonzero(told.confirmed)
        names = "id", "confirmed", "existence", "plot", "mean", "cov"
        numbers = (a[chosen].tolist() for a in (told.id, told.confirmed, told.existence, told.plot))
        # Vectors stay arrays: as lists of lists they would keep the collector of garbage busy.
        rows = zip(*numbers, told.mean[chosen], told.cov[chosen], strict=True)
        tracks = [dict(zip(names, row, strict=True)) for row in rows]
        told_all: dict[str, Any] = {
            "update": self._updates,
            "time": told.time,
            "sensor": told.sensor,
            "tracks": tracks,
            "ended": [int(i) for i in told.ended],
        }
        return orjson.dumps(told_all, option=orjson.OPT_SERIALIZE_NUMPY)

    def _resume(self, checkpoint: Checkpoint) -> None:
        if checkpoint.state is not None:
            kept: _Kept = checkpoint.state
            self.tracker.restore(kept.tracker)
            self._gathering, self.serials, self._updates = kept.gathering, dict(kept.serials), kept.updates
            self.counts = Counter(kept.counts)
            if self.tracker.history:
                self.latest = self._update(self.tracker.history[-1])
        for line in checkpoint.lines:
            # It has been judged, and is in the journal until all of them are worked off.
            self._take(self.feed.read(line))
            for _ in self._tracked():
                pass
        if checkpoint.lines:
            # The next crash repeats nothing of this.
            self.keep()
        checkpoint.lines = []


def _compile(feed: Feed) -> None:
    """Compile what the first plots would else wait for."""
    modes = feed.cycle.modes
    n = modes.model.size
    beliefs, _ = modes.predict(modes.start(np.ones((1, n)), np.eye(n)[None]), 1.0)
    for sensor in feed.periods:
        z = np.ones((1, feed.components(sensor)))
        u = np.ones(feed.inputs) if modes.model.sensor_inputs[sensor] else None
        modes.correct(beliefs, np.zeros(1, int), sensor, z, u)


def complaint(number: int, verdict: Verdict) -> dict[str, Any]:
    """What the sender of a refused line is told: its number on the connection, why, and its beginning."""
    return {"refused": number, "why": verdict.why, "line": quoted(verdict.line.text)}
