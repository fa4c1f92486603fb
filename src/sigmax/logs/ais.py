"""AIS as its receivers log it, sentences of NMEA with the time of reception beside each, by pyais."""

import datetime
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from pyais.exceptions import AISBaseException
from pyais.stream import IterMessages

from sigmax.errors import InputError
from sigmax.logs.read import Log

# Position reports of ships, aircraft and over long ranges: ITU-R M.1371.
_POSITIONS = (1, 2, 3, 9, 18, 19, 27)
_SENTENCE = re.compile(rb"![A-Z]{2}VD[MO],\d+,\d+,\d?,[^,]*,[^,]*,\d\*[0-9A-Fa-f]{2}")
_TAG = re.compile(rb"\\[^\\]*?c:(\d{9,13})[^\\]*\\")
_SINCE_1970 = re.compile(rb"(?<![\d.])(\d{10}(?:\.\d+)?|\d{13})(?![\d.])")
_DATE = re.compile(rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:?\d\d)?")


def tables(path: Path) -> Log:
    """Tables `position`, in degrees and knots, and `ship`, the names.

    A line has its time in a tag block, or as seconds since 1970 or a date before or behind the sentence; else reports
    of base stations tell it. What a report does not know is left empty.

    Raises:
        InputError: where nothing tells the time.
    """
    positions: list[dict[str, Any]] = []
    ships: list[dict[str, Any]] = []
    bad = untimed = 0
    time: pd.Timestamp | None = None
    lines = path.read_bytes().splitlines()
    for at, message in _messages(lines):
        time = at or time
        try:
            report = message.decode().asdict() if message.is_valid else None
        except (AISBaseException, ValueError, IndexError):
            report = None
        if report is None:
            bad += 1
            continue
        if report["msg_type"] == 4 and at is None:
            time = _of_base_station(report) or time
        elif report["msg_type"] in (5, 24):
            ships.append({k: report.get(k) for k in ("mmsi", "shipname", "callsign", "ship_type")})
        elif report["msg_type"] in _POSITIONS:
            untimed += time is None
            if time is not None:
                positions.append({"time": time, **_position(report)})
    if untimed and not positions:
        raise InputError(
            f"{path.name} has {untimed} positions and no time: a tag block (\\c:1714564800*hh\\), seconds since 1970 "
            "or a date on the line of each sentence, or reports of base stations are needed"
        )
    notes = [f"{bad} messages of AIS are damaged and were left out."] if bad else []
    notes += [f"{untimed} positions before the first time were left out."] if untimed else []
    table = pd.DataFrame(positions)
    if len(table):
        table["time"] = pd.to_datetime(table["time"], utc=True)
    names = pd.DataFrame(ships).drop_duplicates() if ships else pd.DataFrame()
    return Log({"position": table, "ship": names.astype(str)}, tuple(notes))


def _messages(lines: list[bytes]) -> Iterator[tuple[pd.Timestamp | None, Any]]:
    """Whole messages, with the time of the line in which each ends."""
    at: list[pd.Timestamp | None] = [None]

    def sentences() -> Iterator[bytes]:
        for line in lines:
            found = _SENTENCE.search(line)
            if found:
                at[0] = _time_of(line, found)
                yield found[0]

    # A message is given as soon as its last sentence was taken.
    for message in IterMessages(sentences()):
        yield at[0], message


def _time_of(line: bytes, sentence: re.Match[bytes]) -> pd.Timestamp | None:
    beside = line[: sentence.start()] + b" " + line[sentence.end() :]
    tag = _TAG.search(line[: sentence.start()])
    count = tag or _SINCE_1970.search(beside)
    if count:
        seconds = float(count[1])
        return pd.Timestamp(round(seconds * (1e9 if seconds < 1e11 else 1e6)), tz="UTC")
    date = _DATE.search(beside)
    if date is None:
        return None
    found = pd.Timestamp(date[0].decode())
    return found.tz_localize("UTC") if found.tzinfo is None else found.tz_convert("UTC")


def _of_base_station(report: dict[str, Any]) -> pd.Timestamp | None:
    parts = [int(report[k]) for k in ("year", "month", "day", "hour", "minute", "second")]
    try:
        return pd.Timestamp(datetime.datetime(*parts, tzinfo=datetime.UTC))  # type: ignore[arg-type, misc]
    except ValueError:
        return None


def _position(report: dict[str, Any]) -> dict[str, Any]:
    """A report with nothing where AIS sends what means that it is not known: ITU-R M.1371, table 48."""
    unknown = {"lat": 91.0, "lon": 181.0, "course": 360.0, "heading": 511}
    # In the long-range report speeds are whole knots and end at 63; aircraft send whole knots up to 1022.
    fastest = {9: 1022, 27: 62}.get(report["msg_type"], 102.2)
    known = {k: None if report.get(k) is None or report[k] >= end else report[k] for k, end in unknown.items()}
    return {
        "mmsi": report["mmsi"],
        "latitude": known["lat"] if known["lon"] is not None else None,
        "longitude": known["lon"] if known["lat"] is not None else None,
        "speed_kn": report["speed"] if report["speed"] <= fastest else None,
        "course_deg": known["course"],
        "heading_deg": known["heading"],
        "within_10_m": bool(report["accuracy"]),
    }
