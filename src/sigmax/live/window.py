"""The latest steps of a live filter, kept so that late measurements find their place and old steps can be smoothed."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.live.live_arguments import Observation
from sigmax.live.live_native import NativeState
from sigmax.live.live_xla import XlaState
from sigmax.live.timeline import Keyed, Timeline, TimelineEntry
from sigmax.modelling.model import Model
from sigmax.steps.step import Innovation, later

Engine = NativeState | XlaState
# So much of a span of time is lost in the rounding of times.
_ROUNDED = 1e-6


class Standing(NamedTuple):
    """Where a live filter stands.

    Attributes:
        time: seconds.
        held: the belief, as the engine holds it.
        fault: of what led here, () or (B,).
    """

    time: float
    held: Any
    fault: np.ndarray


class Event(NamedTuple):
    """What a live filter is told of one time.

    Attributes:
        time: seconds.
        heard: the measurement; None where time passes, and nothing more.
        own: the inputs of the motion before it, None where they are not told with it.
        u: the inputs that the motion takes: its own, else those of the next event that has some, else the last ones.
    """

    time: float
    heard: Observation | None
    own: np.ndarray | None
    u: np.ndarray | None = None


class Window:
    """The steps of the last seconds, with the belief before each.

    Args:
        engine: where the filter stands.
        tracks: (B,) for a batch, else ().
        model: as the engine takes it.
        time: where the filter stands, in seconds.
        late: seconds by which a measurement may be late.
        lag: seconds of steps that are kept at least.
        counts: where measurements are counted by what became of them.

    Attributes:
        now: where the filter stands.
    """

    def __init__(
        self,
        engine: Engine,
        tracks: tuple[int, ...],
        model: Model,
        time: float,
        late: float,
        lag: float,
        counts: Counter[str],
    ) -> None:
        self._tracks, self._driven, self._counts = tracks, model.motion_driven, counts
        self._rank = {s: k for k, s in enumerate(model.sensors)}
        self._late, self._span = late, max(late, lag)
        self._line: Timeline[Standing, Event] = Timeline(self._advance)
        self._before: np.ndarray | None = None  # inputs of the last event that has been settled
        self.begin(engine, time)

    def begin(self, engine: Engine, time: float) -> None:
        """Begin anew with the belief that the engine has."""
        self._engine = engine
        self._line.entries.clear()
        self.now = self._stood(time)

    def take(self, engine: Engine, event: Event) -> Innovation | None:
        """What a measurement said at its place in time; None where it is too late, is there already, or is none.

        Where a function of the model fails, all is as it was.
        """
        self._engine, entries = engine, self._line.entries
        oldest = entries[0].before.time if entries else self.now.time
        if event.time < max(oldest, reach(self.now.time, self._late)):
            self._counts["refused"] += 1
            return None
        key = self._key(event)
        first = place = self._line.place(key)
        if event.heard is not None and place and entries[place - 1].key == key:
            self._counts["repeated"] += 1
            return None
        while self._driven and event.own is not None and first and entries[first - 1].event.own is None:
            first -= 1  # it moved by inputs of others, which these precede
        events = self._line.events(first)
        events.insert(place - first, (key, event))
        before = self.now
        try:
            self.now = self._line.redo(first, self._filled(events, first) if self._driven else events, before)
        except BaseException:
            engine.put_held(before.held, before.fault)
            self._standing = before
            raise
        if event.heard is not None:
            self._counts["late" if event.time < before.time else "taken"] += 1
        if len(events) > 1:
            engine.put_held(self.now.held, self._worst(self._line.entries[first:]))
        told = self._line.entries[place].told
        settled = self._line.settle(reach(self.now.time, self._span))
        self._before = settled[-1].event.u if settled else self._before
        return told

    def at(self, time: float) -> tuple[Standing, np.ndarray | None]:
        """The last step that is not after a time, and the inputs of the motion from there on.

        Raises:
            InputError: where it is not kept any more.
        """
        steps, u = self._steps(), self._before
        if steps[0][0].time > time:
            raise InputError(f"nothing is kept of time {time:g}, the oldest step is of {steps[0][0].time:g}")
        found = steps[0][0]
        for standing, own in steps:
            if standing.time > time:
                return found, own
            found, u = standing, own if own is not None else u
        return found, u

    def since(self, time: float) -> list[tuple[Standing, np.ndarray | None]]:
        """The steps from the last that is not after a time, each with the inputs of the motion before it."""
        steps = self._steps()
        first = max((k for k, (standing, _) in enumerate(steps) if standing.time <= time), default=len(steps))
        return steps[first:]

    def over(self, change: Callable[[Any], Any]) -> None:
        """Hold all beliefs another way."""

        def held(standing: Standing) -> Standing:
            return standing._replace(held=change(standing.held))

        self._line.entries = [e._replace(before=held(e.before)) for e in self._line.entries]
        self.now = self._standing = held(self.now)

    def saved(self, write: Callable[[Any], Any]) -> list[Any]:
        """All of it as lists, numbers and arrays; `write` makes those of a belief."""

        def standing(s: Standing) -> list[Any]:
            return [s.time, write(s.held), s.fault]

        def heard(h: Observation) -> list[Any]:
            return [h.sensor, h.z, h.R.entries if isinstance(h.R, Diagonal) else h.R, h.u]

        events = [(e.event, e.before) for e in self._line.entries]
        told = [[e.time, e.heard and heard(e.heard), e.own, e.u, standing(before)] for e, before in events]
        return [told, standing(self.now), self._before]

    def restore(self, engine: Engine, saved: list[Any], read: Callable[[Any], Any]) -> None:
        """Take up what `saved` gave; the engine has done so."""

        def standing(s: list[Any]) -> Standing:
            return Standing(s[0], read(s[1]), s[2])

        def heard(h: list[Any]) -> Observation:
            return Observation(h[0], h[1], Diagonal(h[2]) if h[2] is not None and h[2].ndim == 1 else h[2], h[3])

        told, now, self._before = saved
        events = [(Event(t, None if h is None else heard(h), own, u), standing(s)) for t, h, own, u, s in told]
        self._line.entries = [TimelineEntry(self._key(event), event, before, None) for event, before in events]
        self._engine, self.now = engine, standing(now)
        self._standing = self.now

    def _stood(self, time: float) -> Standing:
        engine = self._engine
        self._standing = Standing(time, engine.held(), np.array(engine.fault, np.int8).reshape(self._tracks))
        return self._standing

    def _key(self, event: Event) -> tuple[Any, ...]:
        """By time, then by the order of the sensors, then by content: whatever the order in which they came."""
        heard = event.heard
        if heard is None:
            return event.time, -1, b"", b"", _bytes(event.own)
        return event.time, self._rank[heard.sensor], heard.z.tobytes(), _bytes(heard.R), _bytes(event.own)

    def _advance(self, before: Standing, event: Event) -> tuple[Standing, Innovation | None]:
        engine, told = self._engine, None
        if before is not self._standing:
            engine.put_held(before.held, before.fault)
        dt, heard = event.time - before.time, event.heard
        if dt > 0 and self._driven and event.u is None:
            raise InputError("the motion takes inputs, and none are known yet; give u=")
        if heard is None:
            if dt > 0:
                engine.predict(dt, event.u)
        elif dt > 0:
            told = heard.with_members(
                engine.step(heard.sensor, dt, heard.z, heard.R, event.u if self._driven else heard.u)
            )
        else:
            told = heard.with_members(engine.update(heard.sensor, heard.z, heard.R, heard.u))
        return self._stood(event.time), told

    def _filled(self, events: list[Keyed[Event]], first: int) -> list[Keyed[Event]]:
        """The events from a place on, each with the inputs of its motion."""
        before = self._line.entries[first - 1].event.u if first else self._before
        u = next((e.own for _, e in reversed(events) if e.own is not None), before)
        filled = []
        for key, event in reversed(events):
            u = u if event.own is None else event.own
            filled.append((key, event._replace(u=u)))
        return filled[::-1]

    def _worst(self, done: Sequence[TimelineEntry]) -> Any:
        """The first fault of several events."""
        standings = [*(e.before for e in done[1:]), self.now]
        fault = standings[0].fault
        for standing in standings[1:]:
            fault = later(fault, standing.fault)
        return np.asarray(fault)

    def _steps(self) -> list[tuple[Standing, np.ndarray | None]]:
        """Where the filter stood after each time, with the inputs of the motion before; the first has none."""
        entries = self._line.entries
        found: list[tuple[Standing, np.ndarray | None]] = [(entries[0].before if entries else self.now, None)]
        after = [*(e.before for e in entries[1:]), self.now]
        for entry, standing in zip(entries, after, strict=False):
            last, u = found[-1]
            if standing.time > last.time:
                found.append((standing, entry.event.u))
            else:
                # Whether it was reached is said by the first of several events of one time.
                found[-1] = standing._replace(fault=last.fault), u
        return found


def reach(time: float, span: float, more: int = 1) -> float:
    """The time that lies `span` seconds back, and as much more (or less, -1) as rounding may have taken from it."""
    return time - span - more * (_ROUNDED * span + 4 * math.ulp(time))


def _bytes(given: Any) -> bytes:
    if given is None:
        return b""
    return np.asarray(given.entries if isinstance(given, Diagonal) else given).tobytes()
