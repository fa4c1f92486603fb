"""The autoferry data set: two boats seen from a moving ferry (Helgesen et al., Ocean Engineering 2022)."""

import gzip
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sigmax.errors import InputError
from sigmax.files.units import LENGTH, SPEED
from sigmax.filters import Filter
from sigmax.models import Model, Sensor, motions, sensors
from sigmax.records.plots import PlotRecord
from sigmax.tracking import (
    Cycle,
    Detector,
    Layout,
    Modes,
    Scan,
    Truth,
    by_existence,
    crowded,
    in_shadow,
    jpda,
    positions,
)
from sigmax.tracking.initiate import two_point

_SENSORS = {1: "lidar", 2: "radar", 3: "infrared", 4: "optical"}
_BOATS = {1: "Havfruen", 2: "Gunnerus", 3: "jet boat"}
# Both boats' radar plots lie behind them by about two seconds' way, the lidar's by less: the plot of a
# rotation of 1.68 s carries the time of its end.
RADAR_DELAY = 1.68
_LIDAR_REACH = 130.0
_RADAR_TELLS_APART = 45.0
_SHADOW = 10.0


def autoferry(scenario: str, folder: Path | None, *, use: tuple[str, ...] = ("radar", "lidar")) -> PlotRecord:
    """A scenario of the data set, read from its own files.

    Args:
        scenario: its number.
        folder: where scenarioN_detections.json lies, packed (.gz) or not, with scenarioN_groundTruth.json.
        use: the sensors: of radar, lidar, infrared, optical; the last two give bearings only.

    Raises:
        InputError: where a file is missing or is not what it should be.
    """
    if folder is None:
        raise InputError(f"say where the data set lies: sigmax track autoferry:{scenario or 'N'} --data FOLDER")
    if not scenario.isdigit():
        raise InputError(f"autoferry:N needs the number of a scenario, such as autoferry:2; it is {scenario!r}")
    detections = _read(folder, f"scenario{scenario}_detections.json")
    boats = _read(folder, f"scenario{scenario}_groundTruth.json")
    try:
        start = min(float(d["time"]) for d in detections)
        scans = tuple(_scan(d, start) for d in detections if _SENSORS[d["sensorID"]] in use)
        truth = _truth(boats, start, int(scenario))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"scenario {scenario} in {folder} is not laid out as its README says: {error!r}") from error
    return PlotRecord(
        name=f"autoferry{scenario}",
        title=f"Two boats seen from a ferry, autoferry scenario {scenario}",
        scans=tuple(sorted(scans, key=lambda s: (s.time, s.sensor))),
        cycle=lambda filter: _cycle(filter, use),
        filter="SRECKFB",
        window=RADAR_DELAY + 0.5,
        truth=truth,
        cutoff=25.0,
        dimensions=(LENGTH, LENGTH, SPEED, SPEED),
        epoch=pd.Timestamp(start, unit="s", tz="UTC"),
        source="Autoferry sensor fusion data set, NTNU; Helgesen et al., Ocean Engineering, 2022",
        licence="CC0 1.0",
        notes=(
            f"Radar plots are taken to be {RADAR_DELAY} s older than their time stamps, one rotation of the antenna: "
            "they lie that far behind both boats.",
            "Positions are in metres north and east of the origin of the data set's frame.",
        ),
    )


def _read(folder: Path, name: str) -> Any:
    for path in (folder / name, folder / f"{name}.gz"):
        if path.is_file():
            try:
                raw = path.read_bytes()
                return json.loads(gzip.decompress(raw) if path.suffix == ".gz" else raw)
            except (OSError, EOFError, ValueError) as error:
                raise InputError(f"{path} cannot be read: {error}") from error
    known = sorted({p.name.split("_")[0].removeprefix("scenario") for p in folder.glob("scenario*_detections.json*")})
    here = f"; scenarios there: {', '.join(known)}" if known else ""
    raise InputError(f"there is no {name} or {name}.gz in {folder}{here}")


def _scan(d: Any, start: float) -> Scan:
    sensor = _SENSORS[d["sensorID"]]
    found = np.array(d["measurement"], float)
    # One plot is a flat pair, several are a row north and a row east.
    z = found.reshape(-1, 1) if sensor in ("infrared", "optical") else found.reshape(2, -1).T
    late = RADAR_DELAY if sensor == "radar" else 0.0
    place = np.array(d["ownshipPosition"], float)
    u = np.array([*place, 0.0]) if z.shape[1] == 1 else place
    return Scan(float(d["time"]) - start - late, sensor, z, u)


def _truth(boats: Any, start: float, scenario: int) -> tuple[Truth, ...]:
    rows: dict[int, dict[float, list[float]]] = {}
    for instant in boats:
        for boat in instant:
            rows.setdefault(boat["targetID"], {})[float(boat["time"]) - start] = boat["position"][:2]
    # In the second place, used for the scenarios from 13 on, target 2 was another boat.
    names = {k: _BOATS[3 if k == 2 and scenario >= 13 else k] for k in rows}
    made = []
    for k, by_time in sorted(rows.items()):
        times = sorted(by_time)
        made.append(Truth(names[k], np.array(times), np.array([by_time[t] for t in times], float)))
    return tuple(made)


def _cycle(filter: Filter, use: tuple[str, ...]) -> Cycle:
    """Boats of up to 8 m/s; the radar sees all, the lidar 130 m far, neither well what lies behind another boat."""
    cv = motions.constant_velocity(("north", "east"))
    place = sensors.relative_position((0, 1), ("north", "east"))
    bearing = sensors.camera_bearing((0, 1))
    known: dict[str, tuple[Sensor, list[float]]] = {
        "radar": (place, [5.0**2] * 2),
        "lidar": (place, [3.0**2] * 2),
        "infrared": (bearing, [0.04**2]),
        "optical": (bearing, [0.04**2]),
    }
    model = Model(
        motion=cv,
        Q=cv.noise(0.1),
        sensor={s: known[s][0] for s in use},
        R={s: known[s][1] for s in use},
    )

    # Shares of scans with a plot within 15 m of a boat's truth, `python benchmarks/tracking.py autoferry-sensors`.
    def radar(expected: np.ndarray) -> np.ndarray:
        alone = np.where(crowded(expected, _RADAR_TELLS_APART), 0.6, 0.95)
        return np.where(in_shadow(expected, _SHADOW, 10.0), 0.3, alone)

    def lidar(expected: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(expected, axis=1)
        seen = np.where(distance < 60.0, 0.8, np.where(distance < _LIDAR_REACH, 0.3, 0.0))
        return np.where(in_shadow(expected, _SHADOW, 10.0), np.minimum(seen, 0.2), seen)

    def clutter(z: np.ndarray, far: float) -> np.ndarray:
        # Closer than 30 m the ferry sees its own wake and berth.
        return np.where(np.linalg.norm(z, axis=1) < 30, 2.4e-3, far)

    detectors = {
        "radar": Detector(radar, partial(clutter, far=1.2e-4), positions(model.R["radar"], from_inputs=True))
        if "radar" in use
        else None,
        "lidar": Detector(lidar, partial(clutter, far=8e-5), positions(model.R["lidar"], from_inputs=True))
        if "lidar" in use
        else None,
        "infrared": Detector(0.3, 0.5),
        "optical": Detector(0.6, 0.5),
    }
    return Cycle(
        Modes([(filter, model)]),
        {s: d for s in use if (d := detectors[s]) is not None},
        two_point(max_speed=8.0, within=6.0),
        layout=Layout(position=(0, 1), velocity=(2, 3)),
        associate=jpda,
        rule=by_existence(confirm=0.999, drop=0.02, plots=5, coast=20.0),
        birth=0.1,
        extent=(25.0, 8.0),
        max_speed=8.0,
        moving=(10.0, 0.15),
    )
