"""NMEA 0183 of satellite receivers, by pynmea2."""

import datetime
from pathlib import Path
from typing import Any

import pandas as pd
import pynmea2

from sigmax.logs.read import Log

_DAY = datetime.timedelta(days=1)
_KILOMETRE_PER_HOUR = 1 / 1.852


def tables(path: Path) -> Log:
    """One table `fix`, a row for each time of day: place, height, speed and course, accuracies where GST is sent.

    Latitude and longitude in degrees, speed in knots, course in degrees, lengths in m. A log without dates counts
    seconds since midnight. Lines that are no sentences, or whose checksum is wrong, are left out and counted.
    """
    rows: list[dict[str, Any]] = []
    bad, clock, day = 0, _Clock(), None
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        begins = line.find("$")
        if begins < 0:
            bad += bool(line.strip())
            continue
        try:
            sentence = pynmea2.parse(line[begins:], check=True)
            found = _fields(sentence)
        except (ValueError, TypeError, AttributeError):
            bad += 1
            continue
        at = getattr(sentence, "timestamp", None)
        if isinstance(at, datetime.time):
            seconds = clock.counted_on(at)
            if not rows or rows[-1]["seconds"] != seconds:
                rows.append({"seconds": seconds})
        day = _midnight(sentence, clock.days) or day
        if found and rows:
            rows[-1] |= found
    rows = [row for row in rows if len(row) > 1]
    table = pd.DataFrame(rows)
    if rows:
        elapsed = pd.to_timedelta(table.pop("seconds").round(6), unit="s")
        times = elapsed.dt.total_seconds() if day is None else pd.Timestamp(day, tz="UTC") + elapsed
        table.insert(0, "time", times)
    notes = (f"{bad} lines are no whole sentences of NMEA and were left out.",) if bad else ()
    return Log({"fix": table}, notes)


class _Clock:
    """Times of day as seconds that count on over midnight."""

    def __init__(self) -> None:
        self.days, self.last = 0, 0.0

    def counted_on(self, at: datetime.time) -> float:
        seconds = at.hour * 3600 + at.minute * 60 + at.second + at.microsecond * 1e-6
        if seconds < self.last - 43200:
            self.days += 1
        self.last = seconds
        return seconds + self.days * 86400


def _midnight(sentence: Any, days: int) -> datetime.date | None:
    """The day on which a log began, by a date that a sentence has."""
    found = getattr(sentence, "datestamp", None)
    if found is None and sentence.sentence_type == "ZDA" and sentence.year:
        found = datetime.date(int(sentence.year), int(sentence.month), int(sentence.day))
    return found - days * _DAY if isinstance(found, datetime.date) else None


def _fields(sentence: Any) -> dict[str, float]:
    """What a sentence adds to its row; a fix that is not valid adds no place."""
    kind = getattr(sentence, "sentence_type", "")
    found: dict[str, Any] = {}
    void = getattr(sentence, "status", "A") == "V" or (kind == "GGA" and not sentence.gps_qual)
    if kind in ("GGA", "RMC", "GLL", "GNS") and not void and sentence.lat and sentence.lon:
        found |= {"latitude": sentence.latitude, "longitude": sentence.longitude}
    if kind == "GGA" and not void:
        above, sea = sentence.altitude, sentence.geo_sep
        found |= {"altitude": above, "satellites": sentence.num_sats, "hdop": sentence.horizontal_dil}
        if above is not None and sea not in (None, ""):
            found["height"] = float(above) + float(sea)
    elif kind == "RMC" and not void:
        found |= {"speed_kn": sentence.spd_over_grnd, "course_deg": sentence.true_course}
    elif kind == "VTG":
        speed = sentence.spd_over_grnd_kts
        if speed is None and sentence.spd_over_grnd_kmph is not None:
            speed = float(sentence.spd_over_grnd_kmph) * _KILOMETRE_PER_HOUR
        found |= {"speed_kn": speed, "course_deg": sentence.true_track}
    elif kind == "GST":
        found |= {
            "north_std": sentence.std_dev_latitude,
            "east_std": sentence.std_dev_longitude,
            "up_std": sentence.std_dev_altitude,
        }
    return {name: float(value) for name, value in found.items() if value not in (None, "")}
