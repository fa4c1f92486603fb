"""State vectors of aircraft and other tables in JSON: of the OpenSky Network, of readsb and dump1090, or plain rows."""

import gzip
import json
from pathlib import Path
from typing import Any

import pandas as pd

from sigmax.errors import InputError
from sigmax.logs.flat import flat
from sigmax.logs.read import Log

# The fields of a state vector of the OpenSky Network, in their order; speeds in m/s, heights in m.
_OPENSKY = (
    "icao24", "callsign", "origin_country", "time_position", "last_contact", "longitude", "latitude", "baro_altitude",
    "on_ground", "velocity_mps", "true_track_deg", "vertical_rate", "sensors", "geo_altitude", "squawk", "spi",
    "position_source", "category",
)  # fmt: skip
# Those of readsb that are known by other names; speeds in knots.
_READSB = {"hex": "icao24", "flight": "callsign", "lat": "latitude", "lon": "longitude", "gs": "groundspeed_kn"}


def tables(path: Path) -> Log:
    """A table `states` of answers, one or a list or lines of them; else `rows`, of objects or of columns by name.

    Raises:
        InputError: for JSON of another shape.
    """
    opened = gzip.open if path.name.casefold().endswith(".gz") else open
    with opened(path, "rt", encoding="utf-8") as file:
        text = file.read()
    try:
        content: Any = json.loads(text)
    except ValueError:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(content, dict) and all(isinstance(v, dict | list) for v in content.values()) and content:
        return Log({"rows": pd.DataFrame(content).reset_index(drop=True)})
    answers = content if isinstance(content, list) else [content]
    rows: list[dict[str, Any]] = []
    states: list[dict[str, Any]] = []
    for answer in answers:
        if not isinstance(answer, dict):
            raise InputError(f"{path.name} holds {type(answer).__name__}s; a table in JSON is a list of objects")
        if "states" in answer:
            states += [_opensky(state) for state in answer["states"] or []]
        elif "aircraft" in answer:
            states += [_readsb(one, float(answer["now"])) for one in answer["aircraft"]]
        else:
            rows.append(flat(answer))
    found = {"rows": pd.DataFrame(rows)}
    if states:
        # An answer says again what has not changed since the one before.
        found["states"] = pd.DataFrame(states).drop_duplicates(["icao24", "time"], ignore_index=True)
        found["states"]["time"] = pd.to_datetime(found["states"]["time"], unit="s", utc=True)
    return Log(found)


def _opensky(state: list[Any]) -> dict[str, Any]:
    row = {name: v for name, v in zip(_OPENSKY, state, strict=False) if name != "sensors"}
    # The place is of the time of its own, as long as there is one.
    at = row.pop("time_position")
    return {
        "time": at if at is not None else row["last_contact"],
        **row,
        "callsign": str(row["callsign"] or "").strip(),
    }


def _readsb(one: dict[str, Any], now: float) -> dict[str, Any]:
    row = flat({_READSB.get(k, k): v for k, v in one.items()})
    at = now - float(one.get("seen_pos", one.get("seen", 0.0)))
    return {"time": round(at, 3), **row}
