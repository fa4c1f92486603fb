"""What an update gains: accuracy, consistency and cost of iterated and robust corrections.

python benchmarks/updates.py --write docs/updates.md
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import sigmax
from report import Section, markdown, show, write

TRACKS = 2000
RANGE, BEARING = 0.05, float(np.deg2rad(0.5))
BEACONS = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, -2.0]])
MEAN, VARIANCE = np.array([6.0, 2.0, 0.0, 0.0]), np.array([4.0, 4.0, 0.1, 0.1])
Q = 3e-4 * np.array([[1 / 3, 0, 1 / 2, 0], [0, 1 / 3, 0, 1 / 2], [1 / 2, 0, 1, 0], [0, 1 / 2, 0, 1]])
BEGIN, END = "<!-- updates: written by updates.py -->", "<!-- end of updates -->"


def ranges(*beacons: int) -> Callable[[Any], Any]:
    """Distances to beacons."""
    return lambda x: jnp.stack([jnp.hypot(x[0] - BEACONS[b, 0], x[1] - BEACONS[b, 1]) for b in beacons])


def bearings(*beacons: int) -> Callable[[Any], Any]:
    """Directions from beacons."""
    return lambda x: jnp.stack([jnp.arctan2(x[1] - BEACONS[b, 1], x[0] - BEACONS[b, 0]) for b in beacons])


def radar(x: Any) -> Any:
    """Distance and direction from the first beacon."""
    return jnp.concatenate([ranges(0)(x), bearings(0)(x)])


SENSORS: dict[str, tuple[Callable[[Any], Any], tuple[float, ...]]] = {
    "range 0.05 m and bearing 0.5°": (radar, (RANGE, BEARING)),
    "three ranges, 0.05 m": (ranges(0, 1, 2), (RANGE,) * 3),
    "two bearings, 0.5°": (bearings(0, 1), (BEARING,) * 2),
    "one range, 0.05 m": (ranges(0), (RANGE,)),
    "one bearing, 0.5°": (bearings(0), (BEARING,)),
}


class Problem(NamedTuple):
    """A model with truths (tracks, steps, 4) and measurements (tracks, steps, m) drawn from it."""

    model: sigmax.Model
    truth: np.ndarray
    z: np.ndarray


def motion(x: Any, dt: Any) -> Any:
    """Straight on."""
    return jnp.stack([x[0] + x[2] * dt, x[1] + x[3] * dt, x[2], x[3]])


def problem(sensor: str, steps: int, outliers: float = 0.0, seed: int = 1) -> Problem:
    """Truths from the prior; a share of the measurements has noise of twenty times the deviation."""
    function, deviations = SENSORS[sensor]
    names = [sigmax.angle(f"z{i}") if s == BEARING else f"z{i}" for i, s in enumerate(deviations)]
    model = sigmax.Model(
        motion=motion, sensor=function, Q=Q, R=np.square(deviations), state=("x", "y", "vx", "vy"), measurement=names
    )
    rng, m = np.random.default_rng(seed), len(deviations)
    x = MEAN + rng.standard_normal((TRACKS, 4)) * np.sqrt(VARIANCE)
    root, forward, measured = np.linalg.cholesky(Q), jax.vmap(motion, (0, None)), jax.vmap(function)
    truth, z = [], []
    for _ in range(steps):
        x = np.asarray(forward(x, 1.0)) + rng.standard_normal((TRACKS, 4)) @ root.T
        large = np.where(rng.random((TRACKS, 1)) < outliers, 20, 1)
        truth.append(x)
        z.append(np.asarray(measured(x)) + rng.standard_normal((TRACKS, m)) * deviations * large)
    return Problem(model, np.stack(truth, 1), np.stack(z, 1))


class Quality(NamedTuple):
    """Position errors (tracks, steps) in metres, NEES a component (tracks, steps), operations of a correction."""

    error: np.ndarray
    nees: np.ndarray
    operations: int


def quality(filter: sigmax.Filter, given: Problem) -> Quality:
    """A filter on all tracks."""
    prior = sigmax.Gaussian(MEAN, VARIANCE)
    with tempfile.TemporaryDirectory() as folder:
        operations = sigmax.export_c(filter, given.model, prior, folder).operations["update"]
    result = sigmax.run(filter, given.model, prior, given.z, dt=1.0)
    off = result.mean - given.truth
    nees = np.einsum("...i,...i", off, np.linalg.solve(result.cov, off[..., None])[..., 0]) / 4
    return Quality(np.hypot(off[..., 0], off[..., 1]), nees, operations)


def rms(a: np.ndarray) -> float:
    """√ of the mean square."""
    return float(np.sqrt((a**2).mean()))


def linearised(updates: dict[str, sigmax.filters.Update]) -> Iterator[tuple[str, ...]]:
    """Errors after the first measurement and after the fifth, for all sensors."""
    for sensor in track(SENSORS, description="iterated"):
        given = problem(sensor, 5)
        for name in ("SREKFB", "SRCKFB"):
            for text, update in updates.items():
                got = quality(sigmax.get(name, update=update), given)
                parts = (
                    f"{rms(got.error[:, i]):.3f}, {np.median(got.error[:, i]):.3f}, {got.nees[:, i].mean():.2f}"
                    for i in (0, -1)
                )
                yield sensor, name, text, *parts, str(got.operations)


def weighted(updates: dict[str, sigmax.filters.Update]) -> Iterator[tuple[str, ...]]:
    """Errors of sixty steps of a radar, with and without outliers."""
    sensor = next(iter(SENSORS))
    cases = [problem(sensor, 60, share) for share in (0.0, 0.1)]
    for name in track(("SREKFB", "SRCKFB"), description="robust"):
        for text, update in updates.items():
            clean, spoilt = (quality(sigmax.get(name, update=update), given) for given in cases)
            yield (
                name,
                text,
                f"{rms(clean.error[:, -1]):.3f}, {clean.nees[:, -1].mean():.2f}",
                f"{rms(spoilt.error[:, 9]):.3f}, {rms(spoilt.error[:, -1]):.3f}, {np.median(spoilt.error[:, -1]):.3f}",
                f"{100 * (spoilt.error[:, -1] > 1).mean():.1f} %",
                f"{spoilt.nees[:, -1].mean():.2f}",
                str(clean.operations),
            )


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the tables between the markers of a page.")] = None,
) -> None:
    """Draw 2000 tracks for each sensor and filter them with every update; takes about two minutes."""
    console, iterated, robust = Console(), sigmax.iterated, sigmax.robust
    lines = {str(u): u for u in (sigmax.once, iterated(3, guarded=False), iterated(1), iterated(3), iterated(8))}
    kinds = [
        robust("huber"),
        robust("student"),
        robust("student", iterated(2)),
        robust("gate"),
        robust("gate", growth=1),
    ]
    weights = {"once": sigmax.once} | {str(u): u for u in kinds}
    cost = "operations of a correction"
    after = "rmse in m, median in m, NEES/4"
    sections = [
        Section(
            "A sensor linearised again",
            f"{TRACKS} tracks, prior deviation 2 m at a distance of 6 m; NEES/4 of an honest filter is 1.",
            ("sensor", "filter", "update", f"{after} after 1", f"{after} after 5", cost),
            list(linearised(lines)),
        ),
        Section(
            "Outliers",
            f"{TRACKS} tracks of a radar, 0.05 m and 0.5°, 60 steps; outliers: one of ten with 20 times the deviation.",
            (
                *(
                    "filter",
                    "update",
                    "no outliers, at the end: rmse in m, NEES/4",
                    "outliers: rmse at 10, at 60, median",
                ),
                *("lost (> 1 m)", "NEES/4", cost),
            ),
            list(weighted(weights)),
        ),
    ]
    for section in sections:
        show(section, console)
    if page is not None:
        text = [f"Made by `python benchmarks/updates.py --write {page}`.", "", *map(markdown, sections)]
        write(page, "\n".join(text), BEGIN, END)
        console.print(f"written to {page}")


if __name__ == "__main__":
    typer.run(main)
