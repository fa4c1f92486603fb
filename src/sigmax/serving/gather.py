"""Plots one by one to scans: those of one sensor and time, or of one turn, belong together."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sigmax.errors import InputError
from sigmax.tracking import Scan

# A scan that would hold more is refused further plots.
MOST_PLOTS = 50_000


class Plot(NamedTuple):
    """One plot, in SI: time, sensor, what was measured (m,), and the inputs (k,) or None."""

    time: float
    sensor: str
    z: np.ndarray
    u: np.ndarray | None


class Open(NamedTuple):
    """A scan that may get more plots: `until` is the time from which on no plot is of it."""

    key: float
    until: float
    times: list[float]
    z: list[np.ndarray]
    u: np.ndarray | None


class Gathering(NamedTuple):
    """Scans still open and, of sensors that turn, when the first turn began, each by sensor."""

    open: dict[str, Open]
    began: dict[str, float]

    @classmethod
    def nothing(cls) -> "Gathering":
        """No plots yet."""
        return cls({}, {})

    def check(self, plot: Plot) -> None:
        """Refuse a plot beyond the bound of a scan.

        Raises:
            InputError: where its scan is full.
        """
        found = self.open.get(plot.sensor)
        if found is not None and len(found.times) >= MOST_PLOTS and plot.time < found.until:
            raise InputError(f"the scan of {plot.sensor} at {found.times[0]:.15g} s has {MOST_PLOTS} plots already")

    def add(self, plot: Plot, periods: Mapping[str, float | None]) -> list[Scan]:
        """Take a plot in; the scans that are complete thereby, in the order of time."""
        period = periods[plot.sensor]
        if period is None:
            key, until = plot.time, np.nextafter(plot.time, np.inf)
        else:
            began = self.began.setdefault(plot.sensor, plot.time)
            key = float(np.floor((plot.time - began) / period))
            until = began + (key + 1) * period
        own = self.open.get(plot.sensor)
        over = [s for s, o in self.open.items() if plot.time >= o.until or (o is own and o.key != key)]
        done = self.close(over)
        found = self.open.setdefault(plot.sensor, Open(key, float(until), [], [], plot.u))
        found.times.append(plot.time)
        found.z.append(plot.z)
        return done

    def close(self, sensors: list[str]) -> list[Scan]:
        """The open scans of some sensors, no longer open, in the order of time."""
        done = [_scan(sensor, self.open.pop(sensor)) for sensor in sensors if sensor in self.open]
        return sorted(done, key=lambda s: (s.time, s.sensor))


def _scan(sensor: str, parts: Open) -> Scan:
    return Scan(float(np.mean(parts.times)), sensor, np.array(parts.z), parts.u)
