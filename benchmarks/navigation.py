"""Inertial navigation on a recorded drive: positions withheld for ten seconds at 33 places, and the time of a step.

python benchmarks/navigation.py --write docs/navigation.md
python benchmarks/navigation.py --noises  # the most likely noises of the first half; some ten minutes
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

import sigmax
from report import Section, markdown, show, write
from sigmax import navigation, records
from sigmax.records import Record
from sigmax.records.kitti import NOISES, Noises, car
from sigmax.studies import Study
from sigmax.studies.simulate import draw

PLACES, LENGTH = np.arange(20.0, 458.0, 13.4), 10.0
BEGIN, END = "<!-- drive: written by navigation.py -->", "<!-- end of drive -->"


def withheld(record: Record) -> tuple[dict[str, np.ndarray], np.ndarray, list[np.ndarray]]:
    """Measurements of a track for each place, where positions are hidden, and the rows of those hidden."""
    when, fixes = record.time[0], record.z["satellites"][0]
    hidden = (when > PLACES[:, None]) & (when <= PLACES[:, None] + LENGTH)
    z = {s: np.repeat(v, len(PLACES), 0) for s, v in record.z.items()}
    z["satellites"] = np.where(hidden[..., None], np.nan, z["satellites"])
    return z, hidden, [np.flatnonzero(h & np.isfinite(fixes[:, 0])) for h in hidden]


def drive(record: Record, filter: Any, sensors: Mapping[str, np.ndarray], rows: list[np.ndarray]) -> tuple[Any, ...]:
    """How far off it is after ten seconds (33,), and how far straight on (33,)."""
    kept = ("mean", "fault")
    got = sigmax.run(filter, record.model, record.prior, sensors, dt=record.dt[0], inputs=record.inputs[0], keep=kept)
    fixes, when = record.z["satellites"][0], record.time[0]
    off, straight = [], []
    for b, hidden in enumerate(rows):
        last, before = hidden[-1], int(np.searchsorted(when, PLACES[b], side="right")) - 1
        on = got.mean[b, before, 7:9] + got.mean[b, before, 4:6] * (when[last] - when[before])
        off.append(np.linalg.norm(got.mean[b, last, 7:9] - fixes[last, :2]))
        straight.append(np.linalg.norm(on - fixes[last, :2]))
    return np.array(off), np.array(straight), int((got.fault > 0).sum())


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the tables between the markers of a page.")] = None,
    noises: Annotated[bool, typer.Option("--noises", help="Look for the noises instead.")] = False,
) -> None:
    """Drive through the streets with and without wheels, EKF and others; some two minutes."""
    record = records.load("kitti-imu")
    if noises:
        found, value = most_likely(record)
        Console().print(f"{found}, log likelihood {value:.1f}")
        return
    z, _, rows = withheld(record)
    no_wheels = z | {"wheels": np.full_like(z["wheels"], np.nan)}
    student = {"satellites": "student"}
    cases = {
        "EKF": (sigmax.get("EKF"), z),
        "EKF, positions weighed (`student`)": (sigmax.get("EKF", update=student), z),
        "SREKFB, positions weighed": (sigmax.get("SREKFB", update=student), z),
        "EKF, positions weighed, nothing said of sliding": (sigmax.get("EKF", update=student), no_wheels),
    }
    table, straight = [], np.zeros(1)
    second = record.time[0, -1] / 2 <= PLACES
    for name, (filter, sensors) in cases.items():
        off, straight, faults = drive(record, filter, sensors, rows)
        rms = [f"{np.sqrt(np.square(e).mean()):.1f} m" for e in (off, off[second])]
        table.append((name, *rms, f"{np.median(off):.1f} m", f"{off.max():.1f} m", str(faults)))
    rms = [f"{np.sqrt(np.square(e).mean()):.1f} m" for e in (straight, straight[second])]
    table.append(("straight on", *rms, f"{np.median(straight):.1f} m", f"{straight.max():.1f} m", "0"))
    sections = [
        Section(
            "Ten seconds without positions",
            f"At {len(PLACES)} places; the noises are those of the first half of the drive.",
            ("filter", "rms", "second half alone", "median", "worst", "faults"),
            table,
        ),
        Section(
            "Headings known to 60°",
            "Drawn so; 30 positions of 0.5 m in 90 s of driving. NEES is that of attitude, velocity and position.",
            ("filter", "heading, rms", "median", "NEES/9, mean", "median "),
            aligned(),
        ),
        Section("A step", "Of 15 deviations with six inputs, 100 a second.", ("", "µs"), timed(record, z)),
    ]
    for section in sections:
        show(section, Console())
    if page is not None:
        text = "\n".join([f"Made by `python benchmarks/navigation.py --write {page}`.\n", *map(markdown, sections)])
        write(page, text, BEGIN, END)


def most_likely(record: Record) -> tuple[Noises, float]:
    """Noises that no single factor of 3 makes likelier by more than 1 on the first half, and their log likelihood."""
    half = record.time.shape[1] // 2
    z = {s: v[0, :half] for s, v in record.z.items()}
    filter = sigmax.get("EKF", update={"satellites": "student"})

    def value(noises: Noises) -> float:
        got = sigmax.run(filter, car(noises), record.prior, z, dt=record.dt[0, :half], inputs=record.inputs[0, :half])
        return float(got.log_likelihood) if got.ok.all() else -np.inf

    best, highest, better = NOISES, value(NOISES), True
    Console().print(f"{best}: {highest:.1f}")
    while better:
        better = False
        for name in Noises._fields:
            for factor in (3.0, 1 / 3):
                other = best._replace(**{name: getattr(best, name) * factor})
                if (found := value(other)) > highest + 1:
                    best, highest, better = other, found, True
                    Console().print(f"{name} {getattr(best, name):.3g}: {highest:.1f}")
    return best, highest


def aligned() -> list[tuple[str, ...]]:
    """Headings that are not known, found by thirty positions in ninety seconds: as an extended pose, and beside it."""
    steps, dt = 900, 0.1
    t = np.arange(steps) * dt
    u = np.column_stack([0 * t, 0 * t, 0.2 * np.sin(t / 5), np.sin(t / 4), 0 * t, 0 * t + 9.80665])
    motion, fix = navigation.strapdown(), navigation.satellite_position()
    common = {"motion": motion.function, "Q": motion.noise(1e-3, 0.02), "sensor": fix, "R": [0.25] * 3}
    names = ("vx", "vy", "vz", "x", "y", "z", *motion.state[1:])
    models = {
        "extended pose": sigmax.Model(**common, state=motion.state),
        "attitude, velocity and position apart": sigmax.Model(**common, state=(sigmax.rotation("attitude"), *names)),
    }
    deviations = np.repeat([np.radians(1), 0.5, 1.0, 1e-3, 0.02], 3)
    deviations[2] = np.radians(60)
    prior = sigmax.Gaussian([1, 0, 0, 0, 5, 0, 0, *np.zeros(9)], deviations**2)
    drawn = draw(
        Study(name="alignment", model=models["extended pose"], prior=prior, steps=steps, dt=dt, inputs=u,
              measured={"": np.repeat((np.arange(steps) % 30 == 29)[:, None], 3, 1)}),
        1, 0,
    )  # fmt: skip
    rows = []
    for what, model in models.items():
        for name in ("EKF", "SRCKFB"):
            got = sigmax.run(name, model, prior, drawn.z[""], dt=dt, inputs=u)
            last = np.array(got.errors(drawn.truth))[:, -1]
            P = got.cov[:, -1, :9, :9]
            nees = np.einsum("bi,bij,bj->b", last[:, :9], np.linalg.inv(P), last[:, :9]) / 9
            yaw = np.degrees(last[:, 2])
            rows.append(
                (f"{name}, {what}", f"{np.sqrt(np.square(yaw).mean()):.2f}°", f"{np.median(np.abs(yaw)):.2f}°",
                 f"{nees.mean():.2f}", f"{np.median(nees):.2f}")
            )  # fmt: skip
    return rows


def timed(record: Record, z: Mapping[str, np.ndarray]) -> list[tuple[str, str]]:
    """Microseconds of a step: of one record, of 33 together, and live."""
    steps, found = record.time.shape[1], []
    one = {s: v[0] for s, v in z.items()}
    for name, sensors, tracks in (("one record", one, 1), ("33 records together, each", z, len(PLACES))):
        given = (record.model, record.prior, sensors)
        best = min(_seconds(lambda given=given: _run(record, given)) for _ in range(3))
        found.append((name, f"{1e6 * best / steps / tracks:.2f}"))
    live = sigmax.Live("SREKFB", record.model, record.prior)
    u = record.inputs[0]

    def go() -> None:
        for k in range(2000):
            live.predict(0.01, u[k])

    found.append(("live, without a measurement", f"{1e6 * min(_seconds(go) for _ in range(5)) / 2000:.2f}"))
    return found


def _run(record: Record, given: tuple[Any, ...]) -> None:
    model, prior, sensors = given
    sigmax.run("SREKFB", model, prior, sensors, dt=record.dt[0], inputs=record.inputs[0], keep=("fault",))


def _seconds(call: Any) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


if __name__ == "__main__":
    typer.run(main)
