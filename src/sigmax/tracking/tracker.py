"""A tracker at the end of live sensors: scans in any order of arrival, within a window."""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.live.timeline import Timeline, TimelineEntry
from sigmax.tracking.cycle import Cycle
from sigmax.tracking.detector import Scan
from sigmax.tracking.state import State, Told

# So many scans refused on end, and the clock has been set back.
_PATIENCE = 10


class Saved(NamedTuple):
    """What `Tracker.save` gives: a value that can be written down."""

    state: State
    counts: dict[str, int]
    recent: tuple[TimelineEntry, ...]
    held: Scan | None
    refused_on_end: int


class Tracker:
    """Takes scans one by one; the one object with a state.

    A scan that comes late, but within the window, is handled exactly: the tracks go back to the state before it,
    and it and all later scans are processed again, as if it had come in time. An older one is refused.

    Args:
        cycle: how plots become tracks.
        window: seconds by which a scan may be late; the states of so much time are kept.
        jump: seconds; a scan so much later than all others is held back until another one confirms that the
            clock is right, else it is refused.

    Attributes:
        counts: scans by what became of them: "taken", "late" (handled in place), "refused" (too late), "repeated"
            (the same scan again), "jumped" (refused for a jump of the clock), and "restarts": how often the clock
            went back for good, and tracking began anew.

    Raises:
        InputError: for a window or a jump that is negative.
    """

    def __init__(self, cycle: Cycle, *, window: float = 0.0, jump: float = 3600.0) -> None:
        if not window >= 0 or not jump > window:
            raise InputError(f"window must be at least 0, and jump above it; they are {window} and {jump}")
        self.cycle, self.window, self.jump = cycle, window, jump
        self.state = cycle.begin()
        self.counts: Counter[str] = Counter()
        self._settled: list[Told] = []
        self._recent: Timeline[State, Scan] = Timeline(cycle.advance)
        self._held: Scan | None = None
        self._refused_on_end = 0

    @property
    def history(self) -> list[Told]:
        """What every scan did, in the order of time (scans at one time by the name of their sensor)."""
        return [*self._settled, *(e.told for e in self._recent.entries)]

    def forget(self) -> None:
        """Drop the part of the history that no scan can change any more, so that memory stays bounded."""
        self._settled.clear()

    def save(self) -> Saved:
        """All that later scans depend on, as a value; the settled history is not part of it."""
        return Saved(self.state, dict(self.counts), tuple(self._recent.entries), self._held, self._refused_on_end)

    def restore(self, saved: Saved) -> None:
        """Take up what `save` gave: the scans that follow do, bit for bit, what they would have done there."""
        self.state, self._held, self._refused_on_end = saved.state, saved.held, saved.refused_on_end
        self.counts, self._recent.entries = Counter(saved.counts), list(saved.recent)
        self._settled.clear()

    def step(self, scan: Scan) -> Told | None:
        """Take a scan; what it did, or None where it was not taken (see `counts`).

        Raises:
            InputError: where it does not fit the model.
        """
        scan = self.cycle.checked(scan)
        if self._held is not None:
            held, self._held = self._held, None
            if abs(scan.time - held.time) <= self.jump:
                self.counts["jumped"] -= 1
                self._take(held)
        latest = self.state.tracks.time
        if latest is not None and scan.time > latest + self.jump:
            self._held = scan
            self.counts["jumped"] += 1
            return None
        return self._take(scan)

    def run(self, scans: Iterable[Scan]) -> list[Told]:
        """Take scans as they come, and give the whole history."""
        for scan in scans:
            self.step(scan)
        return self.history

    def _take(self, scan: Scan) -> Told | None:
        latest = self.state.tracks.time
        if latest is not None and scan.time < latest - self.window:
            self._refused_on_end += 1
            if self._refused_on_end < _PATIENCE:
                self.counts["refused"] += 1
                return None
            self._restart()
            latest = None
        self._refused_on_end = 0
        key = _key(scan)
        place = self._recent.place(key)
        if any(e.key == key and _same(e.event, scan) for e in self._recent.entries[:place]):
            self.counts["repeated"] += 1
            return None
        late = latest is not None and scan.time < latest
        self.counts["late" if late else "taken"] += 1
        self.state = self._recent.redo(place, [(key, scan), *self._recent.events(place)], self.state)
        told: Told = self._recent.entries[place].told
        assert self.state.tracks.time is not None
        self._settled += [e.told for e in self._recent.settle(self.state.tracks.time - self.window)]
        return told

    def _restart(self) -> None:
        self.counts["restarts"] += 1
        self._settled += [e.told for e in self._recent.entries]
        self._recent.entries.clear()
        self.state = self.cycle.begin()._replace(next_id=self.state.next_id)


def _same(one: Scan, other: Scan) -> bool:
    return one.z.shape == other.z.shape and np.array_equal(one.z, other.z, equal_nan=True) and len(one.z) > 0


def in_order(scans: Iterable[Scan]) -> list[Scan]:
    """Scans by time; those at one time by the name of their sensor."""
    return sorted(scans, key=_key)


def _key(scan: Scan) -> tuple[float, str]:
    return scan.time, scan.sensor
