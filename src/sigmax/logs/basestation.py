"""ADS-B as BaseStation and the port 30003 of its receivers write it: lines of 22 fields that begin with MSG."""

import csv
from pathlib import Path

import pandas as pd

from sigmax.logs.read import Log

# Where things stand: the kind of transmission, the address, the date and time of generation, what was sent.
_KIND, _HEX, _DATE, _TIME, _CALL, _ALTITUDE, _SPEED, _TRACK, _LAT, _LON = 1, 4, 6, 7, 10, 11, 12, 13, 14, 15


def tables(path: Path) -> Log:
    """A table `position` of the messages with a place, and one `velocity` of those with a speed over ground.

    Latitude, longitude and track in degrees, altitude in feet, speed in knots.
    """
    rows: dict[str, list[tuple[str, ...]]] = {"position": [], "velocity": []}
    bad = 0
    with path.open(encoding="ascii", errors="replace", newline="") as file:
        for line in csv.reader(file):
            if not line or line[0] != "MSG" or len(line) <= _LON:
                bad += bool(line and line[0] == "MSG")
                continue
            who = f"{line[_DATE].replace('/', '-')}T{line[_TIME]}Z", line[_HEX].strip()
            if line[_LAT] and line[_LON]:
                rows["position"].append((*who, line[_LAT], line[_LON], line[_ALTITUDE]))
            if line[_SPEED] and line[_TRACK]:
                rows["velocity"].append((*who, line[_SPEED], line[_TRACK]))
    names = {
        "position": ["time", "icao24", "latitude", "longitude", "altitude_ft"],
        "velocity": ["time", "icao24", "groundspeed_kn", "track_deg"],
    }
    found = {}
    for name, of_kind in rows.items():
        table = pd.DataFrame(of_kind, columns=names[name])
        table["time"] = pd.to_datetime(table["time"], utc=True, format="ISO8601", errors="coerce")
        bad += int(table["time"].isna().sum())
        found[name] = table[table["time"].notna()].reset_index(drop=True)
    return Log(found, (f"{bad} lines are cut off or have no time and were left out.",) if bad else ())
