"""A feed for tests: two aircraft and some clutter as lines of JSON."""

import json

import numpy as np

TOML = """
title = "Two aircraft"
data = "plots.csv"
time = "t"
filters = ["EKF"]

[motion]
kind = "constant_velocity"
axes = ["north", "east"]
noise = { density = "1 m^2/s^3" }

[sensors.radar]
kind = "position"
columns = { north = { column = "n_km", unit = "km" }, east = { column = "e_km", unit = "km" } }
noise = { north = "30 m", east = "30 m" }

[tracking]
max_speed = "300 m/s"
associate = "jpda"
confirm = [2, 3]

[tracking.sensors.radar]
detection = 0.95
clutter = 1e-10
"""


def lines(scans=30, seed=1, whole=False):
    """Lines with serial numbers: a plot each, or a scan each."""
    rng = np.random.default_rng(seed)
    place, velocity = np.array([[0.0, 0], [8, 3]]), np.array([[0.1, 0.05], [-0.1, 0.08]])
    found = []
    for k in range(scans):
        plots = [*(place + k * 2.0 * velocity + 0.03 * rng.normal(size=(2, 2))), *rng.uniform(-20, 20, (2, 2))]
        rows = [{"n_km": round(float(p[0]), 4), "e_km": round(float(p[1]), 4)} for p in plots]
        found += [{"t": 2.0 * k, "plots": rows}] if whole else [{"t": 2.0 * k, **row} for row in rows]
    return [json.dumps({**row, "serial": i}).encode() for i, row in enumerate(found)]


def written(folder):
    path = folder / "radar.toml"
    path.write_text(TOML)
    return path
