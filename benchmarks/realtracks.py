"""Real aircraft and ships through the tracker: real dynamics, so that the process noise is as wrong as in life."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

from sigmax.models import Model, motions, sensors
from sigmax.tracking import (
    Cycle,
    Detector,
    Modes,
    Scan,
    Tracker,
    Truth,
    gnn,
    jpda,
    m_of_n,
    polar,
    positions,
    quality,
    two_point,
)

_EARTH = 6371e3


def _tracks(table: pd.DataFrame, gap: float) -> tuple[list[Truth], int]:
    """Targets by id, in metres about the middle; a new one after a gap; and how many rows were repeated."""
    table = table.dropna(subset=["time", "lat", "lon"]).sort_values(["id", "time"], kind="stable")
    fresh = ~table.duplicated(["id", "time"]) & ~table.duplicated(["id", "lat", "lon"])
    repeated = int((~fresh).sum())
    table = table[fresh]
    lat, lon = np.radians(table.lat.to_numpy(float)), np.radians(table.lon.to_numpy(float))
    middle = np.median(lat), np.median(lon)
    north, east = _EARTH * (lat - middle[0]), _EARTH * np.cos(middle[0]) * (lon - middle[1])
    time, name = table.time.to_numpy(float), table.id.to_numpy(str)
    new = np.r_[True, (name[1:] != name[:-1]) | (np.diff(time) > gap)]
    made = []
    for r in np.split(np.arange(len(table)), np.flatnonzero(new)[1:]):
        if len(r) >= 10 and time[r[-1]] - time[r[0]] > 60:
            made.append(Truth(f"{name[r[0]]}/{r[0]}", time[r], np.stack([north[r], east[r]], axis=1)))
    return made, repeated


def _report(name: str, cycle: Cycle, scans: list[Scan], truth: list[Truth], cutoff: float) -> None:
    history = Tracker(cycle).run(scans)
    q = quality(history, truth, (0, 1), cutoff)
    nis = sum(t.gates.nis for t in history) / max(sum(t.gates.dof for t in history), 1)
    rmse = np.sqrt(np.mean([e**2 for m in q.matched.values() for _, _, e in m]))
    held = sum(map(len, q.matched.values())) / sum(sum(t.at(h.time) is not None for h in history) for t in truth)
    print(
        f"| {name} | {len(truth)} | {rmse:.1f} | {held:.1%} | {q.breaks} | {q.switches} | {q.false_per_minute:.2f} "
        f"| {nis:.2f} |",
        flush=True,
    )


_HEAD = "| tracker | targets | RMSE, m | held | breaks | switches | false / min | NIS / component |\n|" + "---|" * 8


def aircraft(folder: Path) -> None:
    """A radar (50 m, 0.1°, 1 m/s, every 4 s, seen with 0.9, 20 false plots a scan) over real flights, one each."""
    rng = np.random.default_rng(0)
    print(_HEAD)
    for file in ("belevingsvlucht", "zero_gravity", "rega_zh"):
        found = pd.read_json(folder / f"{file}.json.gz")
        stamp = pd.to_datetime(found.timestamp, unit="ms").astype("datetime64[ns]").astype("int64") * 1e-9
        # Radial velocities come from the ground speed (kn) and the track (°) that the aircraft sent.
        v = found.groundspeed * 0.514444
        course = np.radians(found.track)
        table = pd.DataFrame({"time": stamp, "id": found.icao24, "lat": found.latitude, "lon": found.longitude})
        table = table.assign(v_north=v * np.cos(course), v_east=v * np.sin(course)).dropna()
        start = table.time.min()
        truth, repeated = _tracks(table, 30.0)
        truth = [Truth(t.name, t.time - start, t.position + np.array([30e3, 40e3])) for t in truth]
        sent = table.sort_values("time")
        moments, speeds = sent.time.to_numpy() - start, sent[["v_north", "v_east"]].to_numpy()
        noise = np.array([50.0, np.radians(0.1), 1.0])
        scans = []
        for time in np.arange(0, max(t.time[-1] for t in truth), 4.0):
            now = [p for t in truth if (p := t.at(time)) is not None]
            z = np.empty((0, 3))
            if now:
                x, v = np.array(now), np.array([np.interp(time, moments, c) for c in speeds.T])
                r = np.hypot(*x.T)
                z = np.stack([r, np.arctan2(x[:, 1], x[:, 0]), (x * v).sum(1) / r], axis=1)
                z = z[rng.random(len(z)) < 0.9]
                z = z + noise * rng.normal(size=z.shape)
            c = rng.poisson(20)
            false = [np.sqrt(rng.random(c)) * 150e3, rng.uniform(-np.pi, np.pi, c), 100 * rng.normal(size=c)]
            scans.append(Scan(float(time), "", np.concatenate([z, np.stack(false, axis=1)])))
        seen = sensors.range_azimuth(velocity=(2, 3))
        cv = motions.constant_velocity(("north", "east"))

        def model(density: float, cv=cv, seen=seen, noise=noise) -> Model:
            return Model(motion=cv, sensor=seen, Q=cv.noise(density), R=noise**2)

        detector = Detector(0.9, 20 / (2 * np.pi * 150e3 * 400), polar(noise**2))
        base = Cycle(
            Modes([("EKF", model(1.0))]), {"": detector}, two_point(300.0, 9.0), associate=jpda, rule=m_of_n(3, 5, 5)
        )
        print(f"| *{file}, {repeated} repeated rows left out* | | | | | | | |")
        _report("CV 1 m²/s³, JPDA", base, scans, truth, 1000.0)
        _report("CV 30 m²/s³, JPDA", dataclasses.replace(base, modes=Modes([("EKF", model(30.0))])), scans, truth, 1e3)
        both = Modes([("EKF", model(0.3)), ("EKF", model(60.0))], sojourn=[120.0, 30.0])
        _report("IMM of two CV, JPDA", dataclasses.replace(base, modes=both), scans, truth, 1000.0)


def ships(folder: Path) -> None:
    """AIS of the Solent with its identities taken away; a report is a plot of one ship, once in some seconds."""
    found = pd.read_csv(folder / "SolentAIS_20160112_130211.csv.gz")
    stamp = pd.to_datetime(found.Time).astype("datetime64[ns]").astype("int64") * 1e-9
    table = pd.DataFrame(
        {"time": stamp, "id": found.MMSI, "lat": found.Latitude_degrees, "lon": found.Longitude_degrees}
    )
    truth, repeated = _tracks(table, 600.0)
    start = min(t.time[0] for t in truth)
    truth = [Truth(t.name, t.time - start, t.position) for t in truth]
    time = np.concatenate([t.time for t in truth])
    place = np.concatenate([t.position for t in truth])
    period = 10.0
    order = np.argsort(time, kind="stable")
    group = np.floor(time[order] / period)
    scans = [Scan(float(time[r].mean()), "ais", place[r]) for r in np.split(order, np.flatnonzero(np.diff(group)) + 1)]
    cv = motions.constant_velocity(("north", "east"))
    seen = {"ais": sensors.position((0, 1), ("north", "east"))}
    # A report is up to half a period older or newer than its scan: 5 m/s · 5 s beside 10 m of the receiver.
    model = Model(motion=cv, sensor=seen, Q=cv.noise(0.01), R={"ais": [30.0**2] * 2})
    # A ship reports every 2 s to 3 min: seen in one scan of three.
    detectors = {"ais": Detector(0.35, 1e-10, positions([30.0**2] * 2))}
    print(_HEAD)
    print(f"| *Solent, {repeated} repeated rows left out* | | | | | | | |")
    for associate in (gnn, jpda):
        cycle = Cycle(
            Modes([("SRECKFB", model)]),
            detectors,
            two_point(25.0, 200.0),
            associate=associate,
            rule=m_of_n(3, 20, 40, 600.0),
            merge=0.0,
        )
        _report(f"CV, {associate.__name__.upper()}", cycle, scans, truth, 200.0)
