"""Events in the order of time: one that comes late is handled as if it had come in time."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

State = TypeVar("State")
Event = TypeVar("Event")
Keyed = tuple[tuple[Any, ...], Event]


class TimelineEntry(NamedTuple):
    """An event.

    Attributes:
        key: where it stands among others: (time, and what orders events of one time).
        event: what happened.
        before: the state before it.
        told: what it did.
    """

    key: tuple[Any, ...]
    event: Any
    before: Any
    told: Any


class Timeline(Generic[State, Event]):
    """The latest events, each with the state before it.

    Args:
        advance: (state, event) -> the state after it, and what it did; a state is never changed in place.

    Attributes:
        entries: in the order of their keys.
    """

    def __init__(self, advance: Callable[[State, Event], tuple[State, Any]]) -> None:
        self._advance = advance
        self.entries: list[TimelineEntry] = []

    def place(self, key: tuple[Any, ...]) -> int:
        """Where an event belongs: behind those of the same key."""
        if not self.entries or self.entries[-1].key <= key:
            return len(self.entries)
        return bisect_right(self.entries, key, key=lambda e: e.key)

    def events(self, place: int) -> list[Keyed[Event]]:
        """The events from a place on, with their keys."""
        return [(e.key, e.event) for e in self.entries[place:]]

    def redo(self, place: int, events: Sequence[Keyed[Event]], now: State) -> State:
        """The state after these events in the place of those from `place` on; `now` is the state after the last.

        Where one cannot be advanced over, nothing is changed.
        """
        state = self.entries[place].before if place < len(self.entries) else now
        done = []
        for key, event in events:
            before = state
            state, told = self._advance(before, event)
            done.append(TimelineEntry(key, event, before, told))
        self.entries[place:] = done
        return state

    def settle(self, until: float) -> list[TimelineEntry]:
        """Take out the events before a time, which nothing can change any more."""
        count = 0
        while count < len(self.entries) and self.entries[count].key[0] < until:
            count += 1
        settled, self.entries[:count] = self.entries[:count], []
        return settled
