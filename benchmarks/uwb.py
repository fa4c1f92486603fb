"""What a bias in the model is worth on real ranges: a robot indoors, a vehicle outdoors, a mower among beacons.

python benchmarks/uwb.py --data ../shared/data

The folder holds `labyrinth_uwb` (The Labyrinth Dataset, T. Pfeifer, TU Chemnitz, CC BY-SA 4.0) and
`hanyang_uwb` (Hanyang University, doi 10.5281/zenodo.15226105, Apache-2.0), gzipped or not as published;
the third record is `plaza1`, `plaza2` of the package gtsam. What is missing is left out.
"""

import argparse
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

import sigmax
from sigmax import Bias, Gaussian, Model

DATA = Path(os.environ.get("SIGMAX_DATA", Path(__file__).parents[2] / "shared" / "data"))


class Run(NamedTuple):
    """One record with the models to compare: without a bias first."""

    models: dict[str, Model]
    prior: Gaussian
    z: Any
    dt: np.ndarray
    inputs: np.ndarray | None
    truth: np.ndarray


def labyrinth(folder: Path) -> Run:
    """A robot with odometry among four ultra-wideband modules, one range at a time, 30 s, truth by camera.

    The distance of the wheels that fits is 0.157 m, twice the one in the file, and the turn has the other
    sign; the robot starts in direction -x, known to 0.1 rad, and at its true place, known to 0.1 m.
    """
    rows = [line.split() for line in (folder / "Indoor_UWB_Input.txt").read_text().splitlines()]
    ranges, wheels = (np.array([row[1:6] for row in rows if row[0] == kind], float) for kind in ("range2", "odom2diff"))
    truth = np.loadtxt(folder / "Indoor_UWB_GT.txt", usecols=(2, 3))
    speed, turn = (wheels[:, 1] + wheels[:, 2]) / 2, (wheels[:, 2] - wheels[:, 1]) / 0.157
    drive, heard = sigmax.motions.unicycle(), sigmax.sensors.range_only()

    def moved(x: Any, dt: Any, u: Any) -> Any:
        return drive.function(x, dt, u[:2])

    def seen(x: Any, u: Any) -> Any:
        return heard.function(x, u[2:])

    def model(bias: Bias | None) -> Model:
        Q = drive.noise(position=0.02, heading=0.05)
        return Model(motion=moved, state=drive.state, sensor=seen, measurement=("range",), Q=Q, R=[0.1**2], bias=bias)

    def offset(b: float, deviation: float) -> Bias:
        return Bias(sensor=np.ones((1, 1)), prior=Gaussian([b], [deviation**2]), names=("range_offset",))

    models = {"no bias": model(None), "bias": model(offset(0.0, 0.3)), "0.12 m, known": model(offset(0.12, 0.0))}
    prior = Gaussian([*truth[0], np.pi], np.square([0.1, 0.1, 0.1]))
    dt = np.diff(ranges[:, 0], prepend=ranges[0, 0])
    return Run(models, prior, ranges[:, 1:2], dt, np.column_stack([speed, turn, ranges[:, 3:5]]), truth)


def hanyang(folder: Path) -> Run:
    """A vehicle that drives 50 m away from four anchors on the base it left, each at its own times, 235 s.

    Ranges further than 0.5 m from the median of the nine about them (33 of 8397) are taken as missing.
    What anchors two metres apart disagree by is a direction, so that their offsets are metres at 50 m.
    """
    path = pd.read_csv(next(folder.glob("LOS_A1/trajectory.csv*")))
    begin, end = path["timestamp"].iloc[[0, -1]]
    parts, places = [], {}
    for file in sorted(folder.glob("LOS_A1/A*.csv*")):
        table = pd.read_csv(file)
        anchor, heard = file.name.partition(".")[0], table["field.distanceFromTag"]
        about = heard.rolling(9, center=True, min_periods=1).median()
        places[anchor] = tuple(map(float, table[["field.x", "field.y"]].iloc[0]))
        heard = heard.where((heard - about).abs() < 0.5)
        parts.append(pd.DataFrame({"time": table["field.stamp"], "anchor": anchor, "range": heard}))
    heard = pd.concat(parts).sort_values("time")
    heard = heard[heard["time"].between(begin, end)]
    truth = np.column_stack([np.interp(heard["time"], path["timestamp"], path[axis]) for axis in "xy"])
    z = {a: heard["range"].where(heard["anchor"] == a).to_numpy()[:, None] for a in places}
    dt = np.diff((heard["time"].to_numpy() - begin) * 1e-9, prepend=0.0)
    moving = sigmax.motions.constant_velocity()

    def model(bias: Bias | None) -> Model:
        sensor = {a: sigmax.sensors.range_only(origin=place) for a, place in places.items()}
        return Model(motion=moving, sensor=sensor, Q=moving.noise(0.1), R={a: [0.03**2] for a in places}, bias=bias)

    own = dict(zip(places, np.eye(len(places))[:, None], strict=True))
    offsets = Bias(sensor=own, prior=Gaussian(np.zeros(4), np.full(4, 0.1**2)), names=tuple(places))
    prior = Gaussian([*truth[0], 0.0, 0.0], [1.0, 1.0, 1.0, 1.0])
    return Run({"no bias": model(None), "bias": model(offsets)}, prior, z, dt, None, truth)


def plaza(run: int) -> Run:
    """The scale of the ranges as a bias linearised about 1, beside the record's own model with the scale a state."""
    record = sigmax.records.load(f"plaza{run}")
    drive, heard = sigmax.motions.unicycle(), sigmax.sensors.range_only()

    def moved(x: Any, dt: Any, u: Any) -> Any:
        return drive.function(x, dt, u[:2])

    def seen(x: Any, u: Any) -> Any:
        return heard.function(x, u[2:])

    scale = Bias(
        sensor=lambda x, u: seen(x, u)[:, None], prior=Gaussian([0.0], record.prior.cov[3:, 3]), names=("scale",)
    )
    Q = np.asarray(record.model.Q.entries)[:3]
    models = {
        name: Model(motion=moved, state=drive.state, sensor=seen, Q=Q, R=record.model.R[""].entries, bias=bias)
        for name, bias in (("no bias", None), ("bias", scale))
    }
    prior = Gaussian(record.prior.mean[:3], record.prior.cov[:3, :3])
    return Run(models, prior, record.z[0], record.dt[0], record.inputs[0], record.truth[0, :, :2])


def score(filter: str, run: Run, model: Model) -> tuple[float, float, sigmax.Result]:
    """Error of the position (m, root mean square over time), mean NIS per measured component, and the result."""
    result = sigmax.run(filter, model, run.prior, run.z, dt=run.dt, inputs=run.inputs)
    errors = result.mean[:, :2] - run.truth
    return float(np.sqrt((errors**2).sum(1).mean())), float(np.nansum(result.nis) / result.dof.sum()), result


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--data", type=Path, default=DATA)
    data = asked.parse_args().data
    runs = {f"labyrinth ({filter})": (labyrinth, data / "labyrinth_uwb", filter) for filter in ("EKF", "MTSHCKF")}
    runs |= {f"Hanyang ({filter})": (hanyang, data / "hanyang_uwb", filter) for filter in ("EKF", "TSCKF", "MTSHCIF")}
    runs |= {f"plaza{k} ({filter})": (plaza, k, filter) for k in (1, 2) for filter in ("EKF", "MTSCKF")}
    print("| record | model | position RMSE, m | NIS | bias at the end |\n|-|-|-|-|-|")
    for name, (make, where, filter) in runs.items():
        try:
            run = make(where)  # type: ignore[operator]
        except (OSError, StopIteration, sigmax.InputError) as error:
            print(f"| {name} | left out: {error or where} | | | |")
            continue
        for label, model in run.models.items():
            error, nis, result = score(filter, run, model)
            told = zip(result.bias, result.bias_mean[-1], result.bias_std[-1], strict=True) if result.bias else ()
            bias = ", ".join(f"{b} {m:.3f} ± {s:.3f}" for b, m, s in told)
            print(f"| {name} | {label} | {error:.3f} | {nis:.2f} | {bias} |")


if __name__ == "__main__":
    main()
