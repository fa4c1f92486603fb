"""Real aircraft and ships through the tracker: real dynamics, so that the process noise is as wrong as in life."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.interpolate import CubicHermiteSpline

from sigmax.models import Model, motions, sensors
from sigmax.tracking import (
    Cycle,
    Detector,
    Modes,
    Scan,
    Told,
    Tracker,
    Truth,
    by_existence,
    gnn,
    jpda,
    m_of_n,
    polar,
    quality,
    reports,
    single_plot,
    two_point,
)

_EARTH = 6371e3
_KNOT = 0.514444
_CV = motions.constant_velocity(("north", "east"))


class Flight(NamedTuple):
    """A target second by second: where it was, and its velocity (T, 2)."""

    truth: Truth
    velocity: np.ndarray


def _metres(lat: pd.Series, lon: pd.Series) -> np.ndarray:
    """North and east of the middle (k, 2)."""
    lat, lon = np.radians(lat.to_numpy(float)), np.radians(lon.to_numpy(float))
    middle = np.median(lat), np.median(lon)
    return _EARTH * np.stack([lat - middle[0], np.cos(middle[0]) * (lon - middle[1])], axis=1)


def _flights(table: pd.DataFrame, gap: float) -> tuple[list[Flight], int]:
    """Targets by id on cubics through positions and velocities; a new one after a gap; how many rows were repeated.

    The table has time, id, lat, lon, v_north, v_east.
    """
    table = table.dropna().sort_values(["id", "time"], kind="stable")
    fresh = ~table.duplicated(["id", "time"]) & ~table.duplicated(["id", "lat", "lon"])
    table = table[fresh].assign(time=lambda t: t.time - t.time.min())
    place, speed = _metres(table.lat, table.lon), table[["v_north", "v_east"]].to_numpy(float)
    time, name = table.time.to_numpy(float), table.id.to_numpy(str)
    new = np.r_[True, (name[1:] != name[:-1]) | (np.diff(time) > gap)]
    made = []
    for r in np.split(np.arange(len(table)), np.flatnonzero(new)[1:]):
        if len(r) >= 5 and time[r[-1]] - time[r[0]] > 60:
            curve = CubicHermiteSpline(time[r], place[r], speed[r])
            t = np.arange(time[r[0]], time[r[-1]], 1.0)
            made.append(Flight(Truth(f"{name[r[0]]}/{r[0]}", t, curve(t)), curve(t, 1)))
    return made, int((~fresh).sum())


def _report(name: str, history: Sequence[Told], truth: list[Truth], cutoff: float, more: str = "") -> None:
    q = quality(history, truth, (0, 1), cutoff)
    nis = sum(t.gates.nis for t in history) / max(sum(t.gates.dof for t in history), 1)
    rmse = np.sqrt(np.mean([e**2 for m in q.matched.values() for _, _, e in m]))
    held = sum(map(len, q.matched.values())) / sum(sum(t.at(h.time) is not None for h in history) for t in truth)
    print(
        f"| {name} | {len(truth)} | {rmse:.1f} | {held:.1%} | {q.breaks} | {q.switches} | {q.false_per_minute:.2f} "
        f"| {nis:.2f} |{more}",
        flush=True,
    )


_HEAD = "| tracker | targets | RMSE, m | held | breaks | switches | false / min | NIS / component |"
_PLANE = np.array([50.0, np.radians(0.1), 1.0])
_DRONE = np.array([5.0, np.radians(0.3), 0.3])


def _radar(flights: list[Flight], noise: np.ndarray, period: float, reach: float, false: float) -> list[Scan]:
    """Plots of a radar that sees each with 0.9, and so many false ones a scan, uniform over the disc."""
    rng = np.random.default_rng(0)
    scans = []
    for time in np.arange(0, max(f.truth.time[-1] for f in flights), period):
        # An instant between two known ones lies within a second of both.
        now = [(f, int(time - f.truth.time[0])) for f in flights if f.truth.time[0] <= time <= f.truth.time[-1]]
        x = np.array([f.truth.at(time) for f, _ in now]).reshape(-1, 2)
        v = np.array([f.velocity[k] for f, k in now]).reshape(-1, 2)
        r = np.hypot(*x.T)
        z = np.stack([r, np.arctan2(x[:, 1], x[:, 0]), (x * v).sum(1) / np.maximum(r, 1.0)], axis=1)
        z = z[(rng.random(len(z)) < 0.9) & (r < reach)]
        z = z + noise * rng.normal(size=z.shape)
        c = rng.poisson(false)
        clutter = [np.sqrt(rng.random(c)) * reach, rng.uniform(-np.pi, np.pi, c), 100 * rng.normal(size=c)]
        scans.append(Scan(float(time), "", np.concatenate([z, np.stack(clutter, axis=1)])))
    return scans


def _followed(
    title: str, flights: list[Flight], noise: np.ndarray, period: float, top: float, densities: Sequence[float]
) -> None:
    """A quiet motion, a noisy one, and the IMM filter of both, with JPDA, over the same plots."""
    reach = 1.1 * max(float(np.hypot(*f.truth.position.T).max()) for f in flights)
    scans = _radar(flights, noise, period, reach, 20.0)
    detector = Detector(0.9, 20 / (2 * np.pi * reach * 400), polar(noise**2))
    seen = sensors.range_azimuth(velocity=(2, 3))
    quiet, noisy = (Model(motion=_CV, sensor=seen, Q=_CV.noise(d), R=noise**2) for d in densities)
    trackers = {
        f"CV {densities[0]:g} m²/s³": Modes([("EKF", quiet)]),
        f"CV {densities[1]:g} m²/s³": Modes([("EKF", noisy)]),
        "IMM of the two": Modes([("EKF", quiet), ("EKF", noisy)], sojourn=[120.0, 30.0]),
    }
    print(f"| *{title}* | | | | | | | |")
    for name, modes in trackers.items():
        cycle = Cycle(
            modes,
            {"": detector},
            two_point(top, 2.5 * period),
            associate=jpda,
            rule=m_of_n(3, 5, 5),
        )
        _report(name, Tracker(cycle).run(scans), [f.truth for f in flights], 20 * noise[0])


def _seconds(stamps: pd.Series) -> pd.Series:
    return pd.to_datetime(stamps).astype("datetime64[ns]").astype("int64") * 1e-9


def aircraft(folder: Path) -> None:
    """A radar (50 m, 0.1°, 1 m/s, every 4 s) over real flights, one each."""
    print(_HEAD + "\n|" + "---|" * 8)
    for file in ("belevingsvlucht", "zero_gravity", "rega_zh"):
        found = pd.read_json(folder / f"{file}.json.gz")
        v, course = found.groundspeed * _KNOT, np.radians(found.track)
        table = pd.DataFrame({"time": _seconds(pd.to_datetime(found.timestamp, unit="ms")), "id": found.icao24})
        table = table.assign(lat=found.latitude, lon=found.longitude)
        flights, repeated = _flights(table.assign(v_north=v * np.cos(course), v_east=v * np.sin(course)), 30.0)
        away = np.array([30e3, 40e3])
        flights = [f._replace(truth=f.truth._replace(position=f.truth.position + away)) for f in flights]
        _followed(f"{file}, {repeated} repeated rows left out", flights, _PLANE, 4.0, 300.0, (1.0, 30.0))


def traffic(folder: Path) -> None:
    """The same radar in the midst of all aircraft over England; then a drone, seen by a small radar every second."""
    print(_HEAD + "\n|" + "---|" * 8)
    found = pd.read_csv(folder / "OpenSky_Plane_States.csv.gz")
    found = found[~found.onground.astype(bool)]
    course = np.radians(found.heading)
    table = pd.DataFrame({"time": found.lastposupdate, "id": found.icao24, "lat": found.lat, "lon": found.lon})
    table = table.assign(v_north=found.velocity * np.cos(course), v_east=found.velocity * np.sin(course))
    flights, repeated = _flights(table, 40.0)
    _followed(f"OpenSky, {repeated} repeated rows left out", flights, _PLANE, 4.0, 300.0, (1.0, 30.0))
    found = pd.read_csv(folder / "UAV_Rot.csv.gz")
    table = pd.DataFrame({"time": _seconds(found.time), "id": "UAV", "lat": found.latitude, "lon": found.longitude})
    # Its own speeds are rough: the positions of its receiver, a second apart, tell them better.
    place = _metres(table.lat, table.lon)
    speed = np.gradient(place, np.maximum.accumulate(table.time.to_numpy() + 1e-6 * np.arange(len(table))), axis=0)
    away = np.array([800.0, 600.0])
    flights, repeated = _flights(table.assign(v_north=speed[:, 0], v_east=speed[:, 1]), 10.0)
    flights = [f._replace(truth=f.truth._replace(position=f.truth.position + away)) for f in flights]
    _followed(f"UAV, {repeated} repeated rows left out", flights, _DRONE, 1.0, 40.0, (0.1, 3.0))


def _solent(folder: Path, period: float) -> tuple[list[Scan], list[np.ndarray], list[Truth]]:
    """Reports in scans, whose each is, and where the ships were.

    A report is moved to the end of its scan by the velocity it tells, so that a scan has one time.
    """
    found = pd.read_csv(folder / "SolentAIS_20160112_130211.csv.gz")
    # One report tells a place on another continent.
    found = found[found.Longitude_degrees.between(-3, 1)]
    v, course = found.SOG_knots * _KNOT, np.radians(found.COG_degrees)
    place = _metres(found.Latitude_degrees, found.Longitude_degrees)
    table = pd.DataFrame({"time": _seconds(found.Time), "id": found.MMSI, "north": place[:, 0], "east": place[:, 1]})
    table = table.assign(v_north=v * np.cos(course), v_east=v * np.sin(course)).sort_values("time", kind="stable")
    # Two receivers may hear the same report.
    table = table[~(table.groupby("id").time.diff() < 1.0)].assign(time=lambda t: t.time - t.time.min())
    truth = [
        Truth(str(i), ship.time.to_numpy(), ship[["north", "east"]].to_numpy())
        for i, ship in table.groupby("id")
        if len(ship) >= 5
    ]
    scans, whose = [], []
    for k, some in table.groupby(np.floor(table.time / period)):
        some = some.drop_duplicates("id", keep="last")
        time = (float(k) + 1) * period
        z = some[["north", "east", "v_north", "v_east"]].to_numpy()
        z[:, :2] += z[:, 2:] * (time - some.time.to_numpy())[:, None]
        scans.append(Scan(time, "ais", z))
        whose.append(some.id.to_numpy())
    return scans, whose, truth


def ships(folder: Path) -> None:
    """AIS of the Solent with its identities taken away."""
    scans, whose, truth = _solent(folder, 10.0)
    under_way = np.array([8.0, 8.0, 0.5, 0.5]) ** 2
    seen = {"sensor": {"ais": lambda x: x}, "measurement": {"ais": ("north", "east", "v_north", "v_east")}}
    sails = Model(motion=_CV, Q=_CV.noise(0.05), R={"ais": under_way}, **seen)
    lies = Model(
        motion=lambda x, dt: jnp.concatenate([x[:2], 0 * x[2:]]),
        state=sails.state,
        Q=[0.02, 0.02, 1e-4, 1e-4],
        R={"ais": np.array([4.0, 4.0, 0.3, 0.3]) ** 2},
        **seen,
    )

    def heard(expected: np.ndarray) -> np.ndarray:
        # Under way a ship reports every 2 to 10 s, at rest every 3 min (ITU-R M.1371).
        return np.where(np.hypot(expected[:, 2], expected[:, 3]) > 0.5, 0.8, 0.06)

    base = Cycle(
        Modes([("EKF", sails)]),
        {"ais": Detector(heard, 1e-12, reports(under_way))},
        single_plot(25.0),
        rule=by_existence(0.9, 1e-6, plots=2, coast=600.0),
        merge=0.0,
    )
    both = Modes([("EKF", lies), ("EKF", sails)], sojourn=[1800.0, 300.0])
    moving = [t for t in truth if np.linalg.norm(np.ptp(t.position, axis=0)) > 200]
    print(_HEAD + " reports from another ship than the one before |\n|" + "---|" * 9)
    for name, modes, associate in (("CV, GNN", base.modes, gnn), ("IMM, GNN", both, gnn), ("IMM, JPDA", both, jpda)):
        history = Tracker(dataclasses.replace(base, modes=modes, associate=associate)).run(scans)
        wrong, all_of_them = _wrong(history, whose)
        for what, some in (("all", truth), ("under way", moving)):
            more = f" {wrong / all_of_them:.1%} |" if some is truth else " |"
            _report(f"{name}: {what}", history, some, 50.0, more)


def _wrong(history: Sequence[Told], whose: Sequence[np.ndarray]) -> tuple[int, int]:
    """How many reports went to a track whose last one was another ship's, and how many went to a track at all."""
    last: dict[int, int] = {}
    wrong = total = 0
    for told, ids in zip(history, whose, strict=True):
        for track, plot in zip(told.id.tolist(), told.plot.tolist(), strict=True):
            if plot >= 0:
                total += track in last
                wrong += last.get(track, ids[plot]) != ids[plot]
                last[track] = ids[plot]
    return wrong, total
