"""What late data and a fixed lag cost live, against Stone Soup's accumulated state densities and FilterPy's smoother.

python benchmarks/late.py --write docs/time.md
"""

import datetime
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from filterpy.kalman import FixedLagSmoother
from rich.console import Console
from rich.progress import track
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.asd import ASDKalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ASDGaussianState
from stonesoup.updater.asd import ASDKalmanUpdater

import sigmax
from report import Section, markdown, show, write

BEGIN, END = "<!-- late: written by late.py -->", "<!-- end of late -->"
STEPS, DT, LAG, BEHIND, DENSITY, DEVIATION = 400, 0.1, 10, 3, 1.0, 0.5
AXES = ("x", "y")
START, SPREAD = np.array([0.0, 0.0, 1.0, 0.5]), np.array([4.0, 4.0, 1.0, 1.0])
MOTION = sigmax.motions.constant_velocity(axes=AXES)
MODEL = sigmax.Model(
    motion=MOTION, Q=MOTION.noise(DENSITY), sensor=sigmax.sensors.position(names=("px", "py")), R=[DEVIATION**2] * 2
)
EPOCH = datetime.datetime(2026, 1, 1)


class Plot(NamedTuple):
    """A position and when it was measured."""

    time: float
    z: np.ndarray


class Entry(NamedTuple):
    """Somebody's way: plots -> the last estimate (or, with a lag, that of LAG steps ago)."""

    name: str
    go: Callable[[list[Plot]], np.ndarray]
    late: bool = False
    lagged: bool = False


def plots(late: bool) -> list[Plot]:
    """A walk seen ten times a second; every fifth measurement arrives behind the three after it."""
    rng = np.random.default_rng(1)
    times = DT * np.arange(1, STEPS + 1)
    order = np.arange(STEPS) + np.where((np.arange(STEPS) % 5 == 0) & late, BEHIND + 0.5, 0)
    z = START[:2] + times[:, None] * START[2:] + DEVIATION * rng.normal(size=(STEPS, 2))
    return [Plot(float(times[k]), z[k]) for k in np.argsort(order)]


def stepped(some: list[Plot]) -> np.ndarray:
    """Steps of our filter that know of no time."""
    live = sigmax.Live("EKF", MODEL, sigmax.Gaussian(START, SPREAD))
    for plot in some:
        live.step(plot.z, DT)
    return live.mean


def timed(window: float, lag: float = 0.0) -> Callable[[list[Plot]], np.ndarray]:
    """Our filter with times, a window or a lag."""

    def go(some: list[Plot]) -> np.ndarray:
        live = sigmax.Live("EKF", MODEL, sigmax.Gaussian(START, SPREAD), window=window, lag=lag)
        found = live.mean
        for plot in some:
            live.update(plot.z, time=plot.time)
            if lag and (smooth := live.lagged) is not None:
                found = smooth.mean
        return found if lag else live.mean

    return go


def accumulated(some: list[Plot]) -> np.ndarray:
    """Stone Soup's filter of accumulated state densities, as many as the window keeps."""
    moving = CombinedLinearGaussianTransitionModel([ConstantVelocity(DENSITY)] * 2)
    predictor = ASDKalmanPredictor(moving)
    updater = ASDKalmanUpdater(LinearGaussian(4, (0, 2), np.eye(2) * DEVIATION**2))
    at = [0, 2, 1, 3]
    begin = {"multi_state_vector": START[at][:, None], "multi_covar": np.diag(SPREAD[at]), "timestamps": [EPOCH]}
    state: Any = ASDGaussianState(**begin, max_nstep=BEHIND + 2)
    for plot in some:
        when = EPOCH + datetime.timedelta(seconds=plot.time)
        predicted = predictor.predict(state, timestamp=when)
        state = updater.update(SingleHypothesis(predicted, Detection(plot.z, timestamp=when)))
    return np.asarray(state.multi_state_vector, float).ravel()[:4][at]


def fixed_lag(some: list[Plot]) -> np.ndarray:
    """FilterPy's smoother of a fixed lag; every step must take as long."""
    smoother = FixedLagSmoother(4, 2, N=LAG)
    block = DENSITY * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    smoother.x, smoother.P = START[:, None].copy(), np.diag(SPREAD)
    smoother.F, smoother.H = np.eye(4) + DT * np.eye(4, k=2), np.eye(2, 4)
    smoother.Q, smoother.R = np.kron(block, np.eye(2)), np.eye(2) * DEVIATION**2
    for plot in some:
        smoother.smooth(plot.z[:, None])
    return smoother.xSmooth[-1 - LAG].ravel()


ENTRIES = [
    Entry("steps, no times", stepped),
    Entry("times, no window", timed(0.0)),
    Entry("a window of 2 s, all in order", timed(2.0)),
    Entry("a window of 2 s, a fifth three steps late", timed(2.0), late=True),
    Entry("Stone Soup, accumulated densities of 5 steps, all in order", accumulated),
    Entry("Stone Soup, the same, a fifth three steps late", accumulated, late=True),
    Entry("a lag of ten steps, told at each", timed(0.0, LAG * DT), lagged=True),
    Entry("FilterPy, a lag of ten steps", fixed_lag, lagged=True),
]


def wanted(entry: Entry) -> np.ndarray:
    """What comes out in order: of `run` and `smooth`."""
    z = np.array([plot.z for plot in plots(late=False)])
    result = sigmax.run("EKF", MODEL, sigmax.Gaussian(START, SPREAD), z, dt=DT)
    return sigmax.smooth("EKF", MODEL, result).mean[-1 - LAG] if entry.lagged else result.mean[-1]


def measured(rounds: int) -> Section:
    """Times of all, in turns; a ratio is formed within a round."""
    seconds = {entry.name: [] for entry in ENTRIES}
    off = {entry.name: float(np.abs(entry.go(plots(entry.late)) - wanted(entry)).max()) for entry in ENTRIES}
    for _ in track(range(rounds), "rounds", transient=True):
        for entry in ENTRIES:
            some = plots(entry.late)
            began = time.perf_counter()
            entry.go(some)
            seconds[entry.name].append((time.perf_counter() - began) / STEPS)
    first = np.array(seconds[ENTRIES[0].name])
    rows = []
    for entry in ENTRIES:
        own = np.array(seconds[entry.name])
        rows.append(
            (entry.name, f"{1e6 * np.median(own):.1f}", f"{np.median(own / first):.1f}", f"{off[entry.name]:.0e}")
        )
    return Section(
        "Late data and a fixed lag",
        f"Four states, positions ten times a second, {STEPS} of them, making the filter included; medians of {rounds} "
        "rounds. The last column: the largest difference from `run` or `smooth` over the record in order.",
        ("", "µs a measurement", "× steps, no times", "off by"),
        rows,
    )


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Page whose marked part is replaced.")] = None,
    rounds: Annotated[int, typer.Option(help="How often everybody goes.")] = 11,
) -> None:
    """Measure, show, and write where asked."""
    section = measured(rounds)
    show(section, Console())
    if page is not None:
        write(page, f"{markdown(section)}\nMade by `python benchmarks/late.py --write docs/time.md`.\n", BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
