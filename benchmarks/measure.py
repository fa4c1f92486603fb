"""Timing on a machine that is not quiet: contenders take turns, and ratios are formed within a round."""

import gc
import time
from collections import defaultdict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from contenders import Entry
from scenario import Estimate


class Spread(NamedTuple):
    """Median, least and greatest of some repetitions."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        digits = 3 if self.median < 1 else 2 if self.median < 10 else 1 if self.median < 100 else 0
        return f"{self.median:.{digits}f} ({self.low:.{digits}f}–{self.high:.{digits}f})"


class Timing(NamedTuple):
    """Of one entry, round by round.

    Attributes:
        entry: who.
        first: seconds of the first call, compilation included.
        seconds: wall time of one call in each round.
        cores: processor time over wall time in each round.
    """

    entry: Entry
    first: float
    seconds: np.ndarray
    cores: np.ndarray


def spread(values: np.ndarray) -> Spread:
    """The spread of the rounds."""
    return Spread(float(np.median(values)), float(np.min(values)), float(np.max(values)))


def ratio(other: Timing, own: Timing) -> Spread:
    """How many times longer `other` takes than `own`, round by round."""
    return spread(other.seconds / own.seconds)


def round_robin(
    entries: list[Entry],
    rounds: int,
    repeats: int,
    tick: Callable[[str], None],
    look: Callable[[Entry, Estimate], None],
) -> dict[str, Timing]:
    """Call every entry once to warm up, then all of them in turns, each round beginning with another one.

    Args:
        entries: who takes part.
        rounds: how many turns.
        repeats: calls within one turn, for calls of a few milliseconds.
        tick: told the name of each entry before it is called.
        look: given what the first call returned.
    """
    first, wall, used = {}, defaultdict(list), defaultdict(list)
    for entry in entries:
        tick(entry.name)
        start = time.perf_counter()
        estimate = entry.run()
        first[entry.name] = time.perf_counter() - start
        look(entry, estimate)
    del estimate
    gc.collect()
    for turn in range(rounds):
        shift = turn % len(entries)
        for entry in entries[shift:] + entries[:shift]:
            tick(entry.name)
            busy, start = time.process_time(), time.perf_counter()
            for _ in range(repeats):
                entry.run()
            elapsed = time.perf_counter() - start
            wall[entry.name].append(elapsed / repeats)
            used[entry.name].append((time.process_time() - busy) / elapsed)
    return {e.name: Timing(e, first[e.name], np.array(wall[e.name]), np.array(used[e.name])) for e in entries}
