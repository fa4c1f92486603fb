"""What lines mean: the TOML that describes a table of plots describes a feed of them, a line being a row."""

import hashlib
import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

import sigmax
from sigmax.descriptions.trial import parse_trial
from sigmax.errors import InputError, unknown
from sigmax.files.description import read_toml
from sigmax.files.plot_description import PlotDescription
from sigmax.files.units import TIME, quantity, to_si
from sigmax.records.own import measured_columns
from sigmax.records.own_plots import build_plots, cycle_of, period_of
from sigmax.serving.gather import Plot
from sigmax.serving.numbers import FeedColumn, LocalRows, column_of, feed_column, number_of, numbers_of, with_nan
from sigmax.tracking import Cycle, Scan

_JSON = {type(None): "null", list: "an array", str: "text", bool: "true or false", int: "a number", float: "a number"}
RESERVED = ("sensor", "plots", "serial", "source", "flush")


class Message(NamedTuple):
    """What one line says.

    Attributes:
        plots: single plots.
        scan: a whole scan.
        flush: that the scans which are open are complete.
        source: who sends.
        serial: the sender's number of the line, growing; None where it does not count.
    """

    plots: tuple[Plot, ...]
    scan: Scan | None
    flush: bool
    source: str
    serial: int | None


class Feed:
    """Reads lines of plots as a TOML file with a table [tracking] describes them.

    Args:
        path: the TOML file.
        filter: a name of the catalogue or NAME:parameter=value,…; None: the first of the file.

    Attributes:
        cycle: how plots become tracks.
        window: seconds by which a scan may be late.
        periods: of each sensor, None for one that does not turn.
        units: of the components of the state, by name.
        digest: of all that the tracks depend on.

    Raises:
        InputError: for whatever does not fit.
    """

    def __init__(self, path: Path, filter: str | None = None) -> None:
        description = read_toml(path, PlotDescription)
        try:
            built = build_plots(path, description)
            name = filter or description.filters[0]
            self.cycle: Cycle = cycle_of(built, description, description.tracking)(parse_trial(name).filter)
            self.window = quantity(description.tracking.late, TIME, "tracking.late")
            parts = description.tracking.sensors
            self.periods = {sensor: period_of(sensor, parts[sensor]) for sensor in built.sensings}
            self._delays = {sensor: sensing.delay for sensor, sensing in built.sensings.items()}
            apart = max(self._delays.values()) - min(self._delays.values())
            if apart > self.window:
                raise InputError(f"tracking.late must be at least what the delays of sensors differ by, {apart:g} s")
            self._measured: dict[str, list[FeedColumn]] = {}
            for sensor in built.sensings:
                wanted = measured_columns(description, built, sensor)
                self._measured[sensor] = [feed_column(c, d, where) for c, d, where in wanted]
            own = [(i.sensor, feed_column(i.column, i.dimension, i.where)) for i in built.inputs]
            self._inputs: list[tuple[str | None, FeedColumn]] = own
            unit = description.time.unit
            self._time = FeedColumn(description.time.column, to_si(unit, TIME, "time"))
            self._format = description.time.format
            self._local = None if description.local is None else LocalRows(description.local)
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from error
        for column in (self._time, *(c for some in self._measured.values() for c in some), *(c for _, c in own)):
            if column.name in RESERVED:
                raise InputError(f"{path.name}: a column of a feed cannot be called {column.name!r}; rename it")
        self.units = {str(n): d.symbol for n, d in zip(built.model.state, built.dimensions, strict=True)}
        told = f"{sigmax.__version__} {name}\n".encode() + path.read_bytes()
        self.digest = hashlib.sha256(told).hexdigest()

    @property
    def inputs(self) -> int:
        """How many inputs a line has."""
        return len(self._inputs)

    def components(self, sensor: str) -> int:
        """How many components a plot of a sensor has."""
        return len(self._measured[sensor])

    def read(self, line: bytes) -> Message:
        """What a line says.

        Raises:
            InputError: with the reason, for a line that cannot be used.
        """
        try:
            row = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            row = with_nan(line, error)
        if not isinstance(row, dict):
            raise InputError(f"a line is an object {{…}} of JSON, not {_JSON[type(row)]}")
        source, serial = row.get("source", ""), row.get("serial")
        if not isinstance(source, str) or len(source) > 100:
            raise InputError("source must be text of at most 100 characters")
        if serial is not None and (not isinstance(serial, int) or isinstance(serial, bool)):
            raise InputError(f"serial must be a whole number; it is {serial!r}")
        if row.get("flush") is True:
            return Message((), None, True, source, serial)
        time = self._instant(row.get(self._time.name))
        if self._local is not None:
            row = self._local.row(row)
        if "plots" in row:
            return Message((), self._scan(row, time), False, source, serial)
        chosen = self._measured if "sensor" not in row else [self._sensor(row["sensor"])]
        plots = []
        for sensor in chosen:
            z = numbers_of(row, self._measured[sensor])
            if not np.isnan(z).all():
                plots.append(Plot(time - self._delays[sensor], sensor, z, self._u(row, sensor)))
        if not plots:
            raise InputError(f"no sensor's columns have a number; {self._wanted()}")
        return Message(tuple(plots), None, False, source, serial)

    def _scan(self, row: Mapping[str, Any], time: float) -> Scan:
        sensor = self._sensor(row.get("sensor", next(iter(self._measured)) if len(self._measured) == 1 else None))
        given = row["plots"]
        if not isinstance(given, list) or not all(isinstance(p, dict) for p in given):
            raise InputError("plots must be a list of objects, one a plot")
        if self._local is not None:
            given = [self._local.row(p) for p in given]
        z = np.empty((len(given), len(self._measured[sensor])))
        for k, column in enumerate(self._measured[sensor]):
            z[:, k] = column_of(given, column)
        return Scan(time - self._delays[sensor], sensor, z, self._u(row, sensor))

    def _sensor(self, name: Any) -> str:
        if not isinstance(name, str) or name not in self._measured:
            raise unknown("sensor", str(name), self._measured)
        return name

    def _wanted(self) -> str:
        return "; ".join(f"{s} has {', '.join(c.name for c in some)}" for s, some in self._measured.items())

    def _u(self, row: Mapping[str, Any], sensor: str) -> np.ndarray | None:
        if not self._inputs:
            return None
        u = numbers_of(row, [c for _, c in self._inputs])
        for (whose, column), value in zip(self._inputs, u, strict=True):
            if whose == sensor and np.isnan(value):
                raise InputError(f"{sensor} needs the input {column.name!r}")
        return np.nan_to_num(u)

    def _instant(self, given: Any) -> float:
        if isinstance(given, str):
            try:
                moment = datetime.strptime(given, self._format) if self._format else datetime.fromisoformat(given)
            except ValueError as error:
                example = datetime(2026, 1, 31, 12).strftime(self._format) if self._format else "2026-01-31T12:00:00Z"
                raise InputError(f"{self._time.name}: {given[:50]!r} is no time such as {example}") from error
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        value = number_of(given, self._time)
        if math.isnan(value):
            raise InputError(f"a line needs a time under {self._time.name!r}")
        return value
