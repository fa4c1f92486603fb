"""What `sigmax.doctor` says of published records, each with something wrong that is known.

python benchmarks/doctor_records.py [--data ../shared/data]

Plaza (in the package gtsam) has ranges that are 7 % too long, the labyrinth ranges about 0.12 m too long, the four
anchors of Hanyang offsets of their own. Of a helicopter there are positions and velocities as ADS-B reported them; then
the positions are dated 2 s late, or by a clock that gains 1 %. `benchmarks/uwb.py` says what the folder holds.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import sigmax
from sigmax import earth
from sigmax.examination import Examination
from uwb import DATA, Run, hanyang, labyrinth


def plaza(run: int) -> Examination:
    """The mower whose ranges are said to be right."""
    record = sigmax.records.load(f"plaza{run}")
    filter, model, prior = record.of_trial(sigmax.records.parse_trial("EKF:fixed=range_scale"))
    prior = sigmax.Gaussian(np.asarray(prior.mean), np.asarray(prior.cov))
    assert record.inputs is not None
    return sigmax.doctor(
        model, prior, record.z[0], filter=filter, dt=record.dt[0], inputs=record.inputs[0],
        update_first=record.update_first,
    )  # fmt: skip


def without_bias(run: Run) -> Examination:
    """A record of `benchmarks/uwb.py` by its model without a bias."""
    return sigmax.doctor(run.models["no bias"], run.prior, run.z, dt=run.dt, inputs=run.inputs)


def aircraft(folder: Path, late: float = 0.0, gains: float = 0.0) -> Examination:
    """A helicopter's positions and velocities, each with the time at which it came; positions dated otherwise.

    `late` seconds, and `gains` more with each second.
    """
    table = pd.read_json(folder / "adsb_traffic" / "rega_zh.json.gz", dtype=False, convert_axes=False)
    came, sent = table["timestamp"].astype("int64").to_numpy() / 1e3, table["last_position"].to_numpy() / 1e3
    places = ~table["last_position"].duplicated().to_numpy()
    begin = sent[0]
    where = np.radians(table[["latitude", "longitude"]].to_numpy(float))
    local = earth.to_local(where, where[0])
    speed, course = table["groundspeed"].to_numpy() * 1852 / 3600, np.radians(table["track"].to_numpy())
    stamps = sent[places] + late + gains * (sent[places] - begin)
    t = np.concatenate([stamps, came])
    order = np.argsort(t, kind="stable")
    place, velocity = np.full((2, len(t), 2), np.nan)
    place[: len(stamps)] = local[places]
    velocity[len(stamps) :] = np.column_stack([speed * np.sin(course), speed * np.cos(course)])
    moving = sigmax.motions.constant_velocity(("east", "north"))
    model = sigmax.Model(
        motion=moving,
        Q=moving.noise(1.0),
        sensor={"place": lambda x: x[:2], "velocity": lambda x: x[2:]},
        measurement={"place": ("east", "north"), "velocity": ("veast", "vnorth")},
        R={"place": [10.0**2] * 2, "velocity": [0.5**2] * 2},
    )
    prior = sigmax.Gaussian([0.0, 0.0, *velocity[len(stamps)]], [100.0, 100.0, 25.0, 25.0])
    z = {"place": place[order], "velocity": velocity[order]}
    return sigmax.doctor(model, prior, z, dt=np.diff(t[order], prepend=t[order][0]))


def cases(folder: Path) -> Iterator[tuple[str, Callable[[], Examination]]]:
    """Names, and what examines each."""
    yield "plaza1, ranges said to be right", lambda: plaza(1)
    yield "plaza2, ranges said to be right", lambda: plaza(2)
    yield "labyrinth", lambda: without_bias(labyrinth(folder / "labyrinth_uwb"))
    yield "hanyang, line of sight", lambda: without_bias(hanyang(folder / "hanyang_uwb"))
    yield "helicopter", lambda: aircraft(folder)
    yield "helicopter, positions 2 s late", lambda: aircraft(folder, 2.0)
    yield "helicopter, clock of positions gains 1 %", lambda: aircraft(folder, gains=0.01)


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path, default=DATA)
    asked.add_argument("--only", default="", help="records whose names begin so")
    given = asked.parse_args()
    print("| record | rows | s | NIS per value | findings |\n|---|---|---|---|---|")
    for name, examined in cases(given.data):
        if not name.startswith(given.only):
            continue
        begun = time.process_time()
        found = examined()
        causes = ((", ".join(filter(None, (f.cause, f.size))), *f.either) for f in found.findings)
        said = "<br>".join(", or ".join(some) for some in causes)
        seconds, after = time.process_time() - begun, found.findings[-1].nis_after if found.findings else found.nis
        nis = f"{found.nis:.3g} → {after:.3g}"
        print(f"| {name} | {found.steps:,} | {seconds:.1f} | {nis} | {said or found.refused or 'none'} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
