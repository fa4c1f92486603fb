"""Models that take turns: on recorded flights against each of them alone, and in time against FilterPy's IMM.

python benchmarks/modes.py --write docs/modes.md
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
import typer
from filterpy.kalman import IMMEstimator, KalmanFilter
from rich.console import Console
from rich.progress import track

import sigmax
from report import Section, markdown, show, write
from sigmax.models import motions, sensors
from uwb import DATA

FLIGHTS, PERIOD, DEVIATION, STEPS = ("belevingsvlucht", "zero_gravity", "rega_zh"), 4.0, 50.0, 1200
METRES_PER_DEGREE = 6_371_000 * np.pi / 180
AXES, SEEN = ("north", "east"), ("radar north", "radar east")
BEGIN, END = "<!-- modes: written by modes.py -->", "<!-- end of modes -->"
# What each model is fitted in, and from where.
STRAIGHT, TURN = {"straight": 1.0}, {"along": 0.5, "turning": 1e-6}
BOTH = {"straight": 0.1, "along": 0.5, "turning": 1e-5, "stay straight": 100.0, "stay turning": 30.0}


class Flight(NamedTuple):
    """Positions every four seconds with the noise of a radar, and where the aircraft was; NaN where it was silent."""

    z: np.ndarray
    truth: np.ndarray


def flight(name: str) -> Flight:
    """The longest stretch of a flight without a gap of a minute, as a radar of 50 m sees it."""
    table = pd.read_json(DATA / "adsb_traffic" / f"{name}.json.gz")
    seconds = pd.to_datetime(table.timestamp, unit="ms").astype("datetime64[ms]").astype("int64").to_numpy() / 1e3
    fields = ["icao24", "latitude", "longitude"]
    table = table[fields].assign(t=seconds).dropna().drop_duplicates("t").sort_values("t")
    table = table[table.icao24 == table.icao24.mode()[0]]
    # A report repeats the last place where none was heard since.
    table = table[(table[["latitude", "longitude"]].diff() != 0).any(axis=1)]
    pieces = [piece for _, piece in table.groupby((table.t.diff() > 60).cumsum())]
    longest = max(pieces, key=len)
    scale = np.array([1, np.cos(np.radians(longest.latitude.iloc[0]))]) * METRES_PER_DEGREE
    place = (longest[["latitude", "longitude"]] - longest[["latitude", "longitude"]].iloc[0]).to_numpy() * scale
    heard = longest.t.to_numpy()
    when = np.arange(heard[0], heard[-1], PERIOD)[:STEPS]
    after = np.searchsorted(heard, when).clip(1)
    truth = np.full((STEPS, 2), np.nan)
    between = np.column_stack([np.interp(when, heard, axis) for axis in place.T])
    truth[: len(when)] = np.where((heard[after] - heard[after - 1] < 3)[:, None], between, np.nan)
    return Flight(truth + np.random.default_rng(0).normal(size=truth.shape) * DEVIATION, truth)


def straight(q: Any) -> sigmax.Model:
    """Nearly constant velocity."""
    moving = motions.constant_velocity(axes=AXES)
    return _seen(moving, moving.noise(density=q))


def turning(along: Any, turn: Any) -> sigmax.Model:
    """A coordinated turn."""
    moving = motions.coordinated_turn_cartesian(axes=AXES)
    return _seen(moving, moving.noise(acceleration=along, turn_rate=jnp.sqrt(turn)))


def _seen(moving: Any, Q: Any) -> sigmax.Model:
    return sigmax.Model(motion=moving, sensor=sensors.position(at=(0, 1), names=SEEN), Q=Q, R=[DEVIATION**2] * 2)


# Where a flight begins: at the origin, as fast as an aircraft may be.
PRIOR = sigmax.Gaussian([0.0] * 5, [DEVIATION**2] * 2 + [150.0**2] * 2 + [0.02**2])
SLOWER = sigmax.Gaussian([0.0] * 4, [DEVIATION**2] * 2 + [150.0**2] * 2)


def alone_straight(p: dict[str, Any]) -> tuple[sigmax.Model, sigmax.Gaussian]:
    """One mode."""
    return straight(p["straight"]), SLOWER


def alone_turning(p: dict[str, Any]) -> tuple[sigmax.Model, sigmax.Gaussian]:
    """The other."""
    return turning(p["along"], p["turning"]), PRIOR


def in_turns(p: dict[str, Any]) -> tuple[sigmax.Model, sigmax.Gaussian]:
    """Both, five components and four."""
    modes = {"straight": straight(p["straight"]), "turn": turning(p["along"], p["turning"])}
    sojourn = jnp.stack([p["stay straight"], p["stay turning"]])
    return sigmax.imm(modes, sojourn=sojourn, entry={"turn_rate": (0.0, 0.02**2)}), PRIOR


def flown() -> Iterator[tuple[str, ...]]:
    """A row for each flight and model: noises from the first half, judged on the second."""
    kinds = {"straight": (alone_straight, STRAIGHT), "turn": (alone_turning, TURN), "imm": (in_turns, BOTH)}
    for name in track(FLIGHTS, "flights"):
        z, truth = flight(name)
        length = int((~np.isnan(z[:, 0])).nonzero()[0][-1]) + 1
        first = np.where(np.arange(STEPS)[:, None] < length // 2, z, np.nan)
        judged = np.arange(STEPS) >= length // 2
        for kind, (build, begin) in kinds.items():
            found = sigmax.fit("EKF", build, begin, first, dt=PERIOD, update_first=True, positive=tuple(begin))
            model, prior = build({k: np.asarray(v) for k, v in found.parameters.items()})
            ran = sigmax.run("EKF", model, prior, z, dt=PERIOD, update_first=True)
            back = sigmax.smooth("EKF", model, ran)
            seen = judged & (ran.dof > 0)
            rms = [np.sqrt(np.nanmean(((r.mean - truth_of(r, truth))[judged, :2] ** 2).sum(1))) for r in (ran, back)]
            likelihood = ran.step_log_likelihood[seen].mean()
            yield (
                name,
                kind,
                f"{rms[0]:.1f}",
                f"{rms[1]:.1f}",
                f"{ran.nis[seen].mean():.2f}",
                f"{likelihood:.3f}",
                f"{ran.probability[judged & (np.arange(STEPS) < length), 1].mean():.2f}" if kind == "imm" else "",
            )


def truth_of(result: Any, truth: np.ndarray) -> np.ndarray:
    """The positions as states, of what is known."""
    return np.pad(truth, ((0, 0), (0, result.mean.shape[1] - 2)), constant_values=np.nan)


def timed() -> Iterator[tuple[str, ...]]:
    """Microseconds a step of two modes of constant velocity, every engine given the same numbers."""
    z = np.random.default_rng(0).normal(size=(2000, 2)).cumsum(0) * 10
    change = np.array([[0.95, 0.05], [0.1, 0.9]])
    model = sigmax.imm({"calm": straight(0.01), "wild": straight(10.0)}, transition=change, initial=[0.5, 0.5])
    prior = sigmax.Gaussian([0.0] * 4, [DEVIATION**2] * 2 + [100.0] * 2)
    theirs, mean = filterpy_imm(z, change, prior)
    ran = sigmax.run("KF", model, prior, z)
    apart = np.abs(ran.mean - mean).max()
    batch = np.repeat(z[None, :200], 1000, 0)
    live = sigmax.Live("KF", model, prior)

    def stepped() -> None:
        for now in z:
            live.step(now, 1.0)

    ours = {
        "a record": (best(lambda: sigmax.run("KF", model, prior, z)), len(z)),
        "live": (best(stepped), len(z)),
        "1000 tracks": (best(lambda: sigmax.run("KF", model, prior, batch, keep=("mean",))), batch[..., 0].size),
    }
    yield "FilterPy", f"{theirs / len(z) * 1e6:.1f}", "1"
    for what, (seconds, steps) in ours.items():
        yield f"sigmax, {what}", f"{seconds / steps * 1e6:.2f}", f"{theirs / len(z) / (seconds / steps):.0f}"
    yield "largest difference of the means, m", f"{apart:.1e}", ""


def best(function: Any) -> float:
    """The shortest of five times, the first not counted."""
    function()
    taken = []
    for _ in range(5):
        begun = time.perf_counter()
        function()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def filterpy_imm(z: np.ndarray, change: np.ndarray, prior: sigmax.Gaussian) -> tuple[float, np.ndarray]:
    """Seconds that FilterPy takes for a record, and its means."""
    filters = []
    for q in (0.01, 10.0):
        one = KalmanFilter(4, 2)
        one.x, one.P, one.R, one.H = (
            prior.mean[:, None].copy(),
            prior.cov.copy(),
            np.eye(2) * DEVIATION**2,
            np.eye(2, 4),
        )
        one.F = np.eye(4) + np.eye(4, k=2)
        one.Q = np.kron(np.array([[1 / 3, 1 / 2], [1 / 2, 1]]), np.eye(2)) * q
        filters.append(one)
    estimator, means = IMMEstimator(filters, [0.5, 0.5], change), np.empty((len(z), 4))
    begun = time.perf_counter()
    for k, now in enumerate(z):
        estimator.predict()
        estimator.update(now[:, None])
        means[k] = estimator.x[:, 0]
    return time.perf_counter() - begun, means


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the tables between the markers of a page.")] = None,
) -> None:
    """Fly three recorded flights with each model and with both; then race FilterPy. About five minutes."""
    speed = Section(
        "Time",
        "Two modes of four components, KF, one process.",
        ("engine", "µs a step", "times as fast"),
        list(timed()),
    )
    flights = Section(
        "Recorded flights",
        "ADS-B positions every 4 s with 50 m of noise; noises and times of stay by likelihood from the first half of "
        "each flight, judged on the second: rmse in m of the filter and the smoother, mean NIS (2 expected), "
        "log-likelihood a step, share of the turning mode.",
        ("flight", "model", "filtered", "smoothed", "NIS", "log-likelihood", "turning"),
        list(flown()),
    )
    for section in (speed, flights):
        show(section, Console())
    if page is not None:
        made = f"Made by `python benchmarks/modes.py --write {page}`."
        write(page, "\n".join([made, "", *map(markdown, (flights, speed))]), BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
