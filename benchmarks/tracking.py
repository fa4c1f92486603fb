"""Plots to tracks: autoferry beside a nearest-neighbour EKF and Stone Soup's JPDA; scale; real aircraft and ships.

python benchmarks/tracking.py autoferry --data ../shared/data/autoferry
python benchmarks/tracking.py autoferry-sensors --data ../shared/data/autoferry
python benchmarks/tracking.py scale
python benchmarks/tracking.py crossing
python benchmarks/tracking.py aircraft --data ../shared/data/adsb_traffic
python benchmarks/tracking.py traffic --data ../shared/data/stonesoup
python benchmarks/tracking.py ais --data ../shared/data/stonesoup

All of them, written into tracking.md beside this file: python benchmarks/tracking.py all --data ../shared/data
"""

import argparse
import contextlib
import dataclasses
import io
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

import sigmax
from contenders import tracks_stonesoup as stone_soup
from realtracks import aircraft, ships, traffic
from sigmax.models import Model, motions, sensors
from sigmax.records.autoferry import autoferry
from sigmax.records.plots import PlotRecord
from sigmax.tracking import (
    Cycle,
    Detector,
    Modes,
    Quality,
    Scan,
    Told,
    Tracker,
    Truth,
    by_existence,
    gnn,
    in_shadow,
    jpda,
    m_of_n,
    mht,
    nearest,
    polar,
    positions,
    quality,
    two_point,
)

SCENARIOS = ("2", "3", "4", "5", "6", "17")


def ours(record: PlotRecord) -> list[Told]:
    cycle = record.cycle(sigmax.get(record.filter))
    return Tracker(cycle, window=record.window).run(record.scans)


def plain(record: PlotRecord) -> list[Told]:
    """A CV-EKF whose tracks take their nearest plot: m of n, no shadows, no extent, no speeds."""
    cycle = record.cycle(sigmax.get("EKF"))
    detectors = {
        s: dataclasses.replace(d, detection=0.9 if s == "radar" else 0.6, clutter=1e-5)
        for s, d in cycle.detectors.items()
    }
    cycle = dataclasses.replace(
        cycle,
        detectors=detectors,
        associate=nearest,
        rule=m_of_n(3, 5, 5),
        extent=(0.0, 0.0),
        merge=0.0,
        max_speed=np.inf,
        moving=None,
    )
    return Tracker(cycle).run(record.scans)


def eager(record: PlotRecord) -> list[Told]:
    """The same tracker, confirming as soon as there are three plots, what stands still too: more held, more false."""
    cycle = record.cycle(sigmax.get(record.filter))
    cycle = dataclasses.replace(cycle, rule=by_existence(0.9, 0.02, plots=3, coast=20.0), moving=None)
    return Tracker(cycle, window=record.window).run(record.scans)


def findable(record: PlotRecord, plots: int = 5, silence: float = 6.0, reach: float = 15.0) -> dict[str, float]:
    """Share of the time in which a target has had so many plots of its own, none of them later than after a silence.

    Its own: within reach of it, and nearer to it than to any other target.
    """
    shares = {}
    for target in record.truth:
        last, count, able, known = -np.inf, 0, 0, 0
        for scan in record.scans:
            where = [p for t in record.truth if t is not target and (p := t.at(scan.time)) is not None]
            place = target.at(scan.time)
            if place is None:
                continue
            z = scan.z + (0.0 if scan.u is None else scan.u[:2])
            distance = np.linalg.norm(z - place, axis=1)
            own = distance < reach
            for other in where:
                own &= distance <= np.linalg.norm(z - other, axis=1)
            if own.any():
                count = count + 1 if scan.time - last <= silence else 1
                last = scan.time
            known += 1
            able += count >= plots and scan.time - last <= silence
        shares[target.name] = able / max(known, 1)
    return shares


def autoferry_sensors(folder: Path) -> None:
    """How often the sensors have a plot of each boat, by what may hinder them."""
    rows = []
    for scenario in SCENARIOS:
        record = autoferry(scenario, folder)
        for scan in record.scans:
            at = [t.at(scan.time) for t in record.truth]
            if scan.u is None or any(p is None for p in at):
                continue
            seen = np.array(at) - scan.u[:2]
            distance = np.linalg.norm(seen, axis=1)
            apart = np.linalg.norm(seen[0] - seen[1])
            gaps = np.linalg.norm(scan.z[:, None] - seen, axis=2)
            mine = (gaps < 15) & (gaps <= gaps[:, ::-1])
            hidden = in_shadow(seen, 10.0, 10.0)
            rows += [(scan.sensor, distance[k], apart, hidden[k], mine[:, k].any()) for k in range(2)]
    table = pd.DataFrame(rows, columns=["sensor", "distance", "apart", "hidden", "seen"])
    free = table[~table.hidden]
    print("| sensor | of a boat that | scans | with a plot of it |\n|---|---|---|---|")
    limits = {
        "radar": ("apart", "is apart from the other by", (0, 20, 30, 40, 50, 100, 600)),
        "lidar": ("distance", "is away by", (0, 60, 90, 110, 130, 160, 600)),
    }
    for sensor, (column, words, edges) in limits.items():
        own = free[free.sensor == sensor]
        for low, high in pairwise(edges):
            some = own[own[column].between(low, high, inclusive="left")]
            print(f"| {sensor} | {words} {low} to {high} m | {len(some)} | {some.seen.mean():.0%} |")
        some = table[table.hidden & (table.sensor == sensor)]
        print(f"| {sensor} | lies in the other's shadow | {len(some)} | {some.seen.mean():.0%} |")


def autoferry_table(folder: Path) -> None:
    contenders: dict[str, Callable[[PlotRecord], list[Told]]] = {
        "sigmax JPDA": ours,
        "sigmax GNN": lambda r: Tracker(
            dataclasses.replace(r.cycle(sigmax.get(r.filter)), associate=gnn), window=r.window
        ).run(r.scans),
        "sigmax JPDA, eager": eager,
        "nearest-neighbour EKF": plain,
        "Stone Soup JPDA": stone_soup.jpda,
    }
    print("| tracker | scenario | RMSE, m | held | breaks | switches | false / min | GOSPA, m | CPU ms / scan |")
    print("|---|---|---|---|---|---|---|---|---|")
    bounds = []
    for scenario in SCENARIOS:
        bound = findable(autoferry(scenario, folder))
        bounds += bound.values()
        print(f"| *plots of its own* | {scenario} | | {', '.join(f'{v:.0%}' for v in bound.values())} | | | | | |")
    print(f"| *plots of its own* | **all** | | {np.mean(bounds):.0%} | | | | | |")
    for name, run in contenders.items():
        found: list[Quality] = []
        for scenario in SCENARIOS:
            record = autoferry(scenario, folder)
            started = time.process_time()
            history = run(record)
            took = 1e3 * (time.process_time() - started) / len(record.scans)
            q = quality(history, record.truth, (0, 1), record.cutoff)
            found.append(q)
            rmse = ", ".join(f"{v:.1f}" for v in q.rmse.values())
            held = ", ".join(f"{v:.0%}" for v in q.held.values())
            print(
                f"| {name} | {scenario} | {rmse} | {held} | {q.breaks} | {q.switches} | {q.false_per_minute:.2f} "
                f"| {q.gospa:.1f} | {took:.1f} |",
                flush=True,
            )
        rmse = [v for q in found for v in q.rmse.values()]
        held = np.mean([v for q in found for v in q.held.values()])
        missing = f" ({int(np.isnan(rmse).sum())} never held)" if np.isnan(rmse).any() else ""
        print(
            f"| {name} | **all** | **{np.nanmean(rmse):.2f}**{missing} | {held:.0%} | {sum(q.breaks for q in found)} "
            f"| {sum(q.switches for q in found)} | {np.mean([q.false_per_minute for q in found]):.2f} "
            f"(worst {max(q.false_per_minute for q in found):.2f}) | {np.mean([q.gospa for q in found]):.1f} | |",
            flush=True,
        )


def radar() -> Model:
    """50 m, 0.1°, 1 m/s."""
    cv = motions.constant_velocity(("north", "east"))
    seen = sensors.range_azimuth(velocity=(2, 3))
    return Model(motion=cv, sensor=seen, Q=cv.noise(1.0), R=[50.0**2, np.radians(0.1) ** 2, 1.0])


def sky(n: int, scans: int, rng: np.random.Generator, size: float = 200e3) -> Iterator[tuple[Scan, np.ndarray]]:
    """Straight flights at 100 to 250 m/s over 400 km by 400 km, seen every 4 s with 0.9, and n / 10 false plots."""
    x = rng.uniform(-size, size, (n, 2))
    v = rng.normal(size=(n, 2))
    v *= (rng.uniform(100, 250, n) / np.linalg.norm(v, axis=1))[:, None]
    for k in range(scans):
        x = x + 4 * v
        r = np.hypot(*x.T)
        seen = rng.random(n) < 0.9
        z = np.stack([r, np.arctan2(x[:, 1], x[:, 0]), (x * v).sum(1) / r], 1)[seen]
        z += rng.normal(size=z.shape) * [50, np.radians(0.1), 1]
        c = rng.poisson(n / 10)
        false = np.stack(
            [np.sqrt(rng.random(c)) * size * 1.4, rng.uniform(-np.pi, np.pi, c), 100 * rng.normal(size=c)], 1
        )
        yield Scan(4.0 * (k + 1), "", rng.permutation(np.concatenate([z, false]))), x


def scale_table() -> None:
    model = radar()
    print("| tracker | aircraft | CPU ms / scan, median of 10 | worst | held | grows with |")
    print("|---|---|---|---|---|---|")
    for name, associate in (("sigmax GNN", gnn), ("sigmax JPDA", jpda)):
        before = None
        for n in (100, 1000, 10000):
            detector = Detector(0.9, n / 10 / (2 * np.pi * 280e3 * 400), polar(model.R[""]))
            modes = Modes([("EKF", model)])
            cycle = Cycle(
                modes, {"": detector}, two_point(300.0, 9.0), associate=associate, rule=m_of_n(3, 5, 4), max_speed=350.0
            )
            tracker, took = Tracker(cycle), []
            # Compiled before.
            Tracker(cycle).run([s for s, _ in sky(20, 4, np.random.default_rng(0))])
            world = list(sky(n, 15, np.random.default_rng(1)))
            for scan, _ in world:
                started = time.process_time()
                told = tracker.step(scan)
                took.append(1e3 * (time.process_time() - started))
            assert told is not None
            row(name, n, took[5:], told.mean[told.confirmed][:, :2], world[-1][1], before)
            before = n, float(np.median(took[5:]))
    before = None
    for n in (30, 100, 300):
        took, place, x = stone_soup.scale(n, list(sky(n, 12, np.random.default_rng(1))))
        row("Stone Soup GNN, EKF, no radial velocity", n, took[5:], place, x, before)
        before = n, float(np.median(took[5:]))


def row(
    name: str, n: int, took: list[float], place: np.ndarray, x: np.ndarray, before: tuple[int, float] | None
) -> None:
    from scipy.spatial import cKDTree

    held = (cKDTree(place).query(x)[0] < 1000).mean() if len(place) else 0.0
    median = float(np.median(took))
    grows = "" if before is None else f"n^{np.log(median / before[1]) / np.log(n / before[0]):.2f}"
    print(f"| {name} | {n} | {median:.1f} | {max(took):.1f} | {held:.1%} | {grows} |", flush=True)


def meeting(split: bool, seed: int, pairs: int = 8, dt: float = 4.0) -> tuple[list[Scan], list[Truth]]:
    """Pairs of aircraft that cross at a small angle, or fly as one and split; plots of 50 m, seen with 0.9."""
    rng = np.random.default_rng(seed)
    time = dt * np.arange(40)
    truth = []
    for k in range(pairs):
        course, middle = rng.uniform(-np.pi, np.pi), 20e3 * np.array([k % 4, k // 4])
        along, across = np.array([np.cos(course), np.sin(course)]), np.array([-np.sin(course), np.cos(course)])
        way = 150.0 * (time - time[20])
        apart = (rng.uniform(8, 15) if split else rng.uniform(2, 6)) * (time - time[20])
        # Before the split both are where one is; a radar sees them within its noise of each other.
        aside = np.maximum(apart, 0.0) if split else apart
        truth += [
            Truth(f"{k}{s:+}", time, middle + np.outer(way, along) + s * np.outer(aside, across)) for s in (-1, 1)
        ]
    scans = []
    for i, t in enumerate(time):
        x = np.array([b.position[i] for b in truth])
        z = x[rng.random(len(x)) < 0.9]
        z = z + 50.0 * rng.normal(size=z.shape)
        false = rng.uniform([-20e3, -20e3], [80e3, 40e3], (rng.poisson(60), 2))
        scans.append(Scan(float(t), "", rng.permutation(np.concatenate([z, false]))))
    return scans, truth


def crossing_table(runs: int = 12) -> None:
    print(
        "| targets | Q, m²/s³ | rule | RMSE, m | where JPDA holds them, too: its, JPDA's | short of the turn | held "
        "| breaks | switches | false tracks | GOSPA, m | CPU ms / scan |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    rules = {"JPDA": jpda, "GNN": gnn, **{f"MHT, scans={n}": mht(n) for n in (1, 3, 5)}}
    # 0.1 is right for a straight flight, and stiff for one that turns by 8 to 15 m/s at once.
    for name, split, density in (("crossing", False, 0.1), ("splitting", True, 0.1), ("splitting", True, 1.0)):
        cv = motions.constant_velocity(("north", "east"))
        model = Model(motion=cv, sensor=sensors.position((0, 1)), Q=cv.noise(density), R=[50.0**2] * 2)
        detector = {"": Detector(0.9, 60 / (100e3 * 60e3), positions(model.R[""]))}
        reference: dict[tuple[int, str, float], float] = {}
        for what, associate in rules.items():
            cycle = Cycle(
                Modes([("EKF", model)]), detector, two_point(300.0, 9.0), associate=associate, rule=m_of_n(3, 5, 4)
            )
            found, took, short = [], 0.0, []
            errors: dict[tuple[int, str, float], float] = {}
            Tracker(cycle).run(meeting(split, 99)[0][:5])
            for seed in range(runs):
                scans, truth = meeting(split, seed)
                started = time.process_time()
                history = Tracker(cycle).run(scans)
                took += 1e3 * (time.process_time() - started) / len(scans) / runs
                # Of 500 m, a pair whose tracks are the wrong way round would pass for one that is followed badly.
                q = quality(history, truth, (0, 1), 200.0)
                found.append(q)
                errors |= {(seed, n, at): e for n, matched in q.matched.items() for at, _, e in matched}
                short += list(behind(history, truth, q))
            reference = reference or errors
            both = sorted(errors.keys() & reference.keys())
            paired = [np.sqrt(np.mean([e[k] ** 2 for k in both])) for e in (errors, reference)]
            rmse, held = (np.nanmean([v for q in found for v in getattr(q, a).values()]) for a in ("rmse", "held"))
            counts = [sum(getattr(q, a) for q in found) for a in ("breaks", "switches", "false_tracks")]
            told = " | ".join(str(c) for c in counts)
            gospa = np.mean([q.gospa for q in found])
            print(
                f"| {name} | {density} | {what} | {rmse:.1f} | {paired[0]:.1f}, {paired[1]:.1f} | "
                f"{f'{np.mean(short):.0f} m' if split else ''} | {held:.1%} | {told} | {gospa:.0f} | {took:.1f} |",
                flush=True,
            )


def behind(history: list[Told], truth: list[Truth], q: Quality) -> Iterator[float]:
    """How far tracks are on the inner side of their targets (m), where those of a pair are 400 to 1600 m apart."""
    told = {t.time: t for t in history}
    for one, other in (pair for k in range(0, len(truth), 2) for pair in (truth[k : k + 2], truth[k : k + 2][::-1])):
        for at, track, _ in q.matched[one.name]:
            place, beside = one.at(at), other.at(at)
            if place is not None and beside is not None and 400 < np.linalg.norm(place - beside) < 1600:
                out = (place - beside) / np.linalg.norm(place - beside)
                mean = told[at].mean[told[at].id == track][0, :2]
                yield float((place - mean) @ out)


# What is made of which folder of data; one without a folder needs none.
TABLES: dict[str, tuple[Callable[[Path], None], str]] = {
    "autoferry": (autoferry_table, "autoferry"),
    "autoferry-sensors": (autoferry_sensors, "autoferry"),
    "scale": (lambda _: scale_table(), ""),
    "crossing": (lambda _: crossing_table(), ""),
    "aircraft": (aircraft, "adsb_traffic"),
    "traffic": (traffic, "stonesoup"),
    "ais": (ships, "stonesoup"),
}


def rewrite(page: Path, data: Path) -> None:
    """Make all tables of the page again, each between the two comments that bear its name."""
    for name, (table, folder) in TABLES.items():
        made = io.StringIO()
        print(f"{name} …", file=sys.stderr, flush=True)
        with contextlib.redirect_stdout(made):
            table(data / folder)
        text = page.read_text(encoding="utf-8")
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        head, rest = text.split(begin)
        page.write_text(head + begin + made.getvalue() + rest[rest.index(end) :], encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=(*TABLES, "all"))
    parser.add_argument("--data", type=Path, help="folder of the data set; for all, the folder of all data sets")
    given = parser.parse_args()
    if given.data is None and given.what not in ("scale", "crossing"):
        parser.error(f"{given.what} needs --data FOLDER")
    if given.what == "all":
        rewrite(Path(__file__).with_suffix(".md"), given.data)
    else:
        TABLES[given.what][0](given.data)


if __name__ == "__main__":
    main()
