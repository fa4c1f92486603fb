"""Small records of a user, written for a test."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from sigmax.records import Outcome, Record, load, parse_trial, track

RADAR = """
title = "Two aircraft seen by a radar"
data = "radar.csv"
time = "t"
track = "aircraft"
filters = ["EKF"]

[motion]
kind = "constant_velocity"
axes = ["north", "east"]
noise = { density = "0.5 m^2/s^3" }

[sensors.radar]
kind = "range_azimuth"
columns = { range = { column = "range_km", unit = "km" }, azimuth = { column = "azimuth_deg", unit = "deg" } }
noise = { range = "30 m", azimuth = "0.2 deg" }

[prior]
position_from = "radar"
vnorth = { mean = 0, std = "360 km/h" }
veast = { mean = 0, std = "100 m/s" }

[truth]
north = { column = "north_km", unit = "km" }
east = { column = "east_km", unit = "km" }
"""


def radar_table() -> dict[str, list]:
    """Two straight tracks of 30 and 20 steps of 2 s in turn; one look in seven sees nothing."""
    rng = np.random.default_rng(3)
    rows = []
    for name, steps, start, velocity in (("A1", 30, (6000, 2000), (80, 60)), ("B2", 20, (-4000, 5000), (-30, 90))):
        for k in range(steps):
            north, east = (p + v * 2.0 * k for p, v in zip(start, velocity, strict=True))
            distance = np.hypot(north, east) + 30 * rng.standard_normal()
            azimuth = np.degrees(np.arctan2(east, north)) + 0.2 * rng.standard_normal()
            seen = k % 7 != 5
            measured = (distance / 1e3, azimuth) if seen else (np.nan, np.nan)
            rows.append((2.0 * k, name, *measured, north / 1e3, east / 1e3))
    rows.sort(key=lambda row: row[0])
    names = ("t", "aircraft", "range_km", "azimuth_deg", "north_km", "east_km")
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def write_csv(path: Path, columns: dict[str, list]) -> None:
    """A CSV file in which NaN is an empty field."""
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.6f")


def write_radar(folder: Path, description: str = RADAR) -> Path:
    """radar.toml and radar.csv."""
    write_csv(folder / "radar.csv", radar_table())
    (folder / "radar.toml").write_text(description)
    return folder / "radar.toml"


@functools.cache
def tracked_radar() -> tuple[Record, Outcome, Outcome]:
    """The record, by an extended filter, and by the same told that the aircraft stand still: compiled once."""
    with tempfile.TemporaryDirectory() as folder:
        record = load(str(write_radar(Path(folder), RADAR.replace("Two aircraft", "Two <b>&</b> aircraft"))))
    found, still = (track(record, parse_trial(t)) for t in ("EKF", "EKF:fixed=vnorth,fixed=veast"))
    return record, found, still
