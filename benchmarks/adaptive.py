"""What it gains to find R and Q as a filter goes where they change in the middle of a record, and what it costs.

python benchmarks/adaptive.py --write docs/noises.md
"""

import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

import sigmax
from report import Section, markdown, show, write

BEGIN, END = "<!-- adaptive: written by adaptive.py -->", "<!-- end of adaptive -->"
AXES, STEPS, DENSITY, VARIANCE, TIMES = ("x", "y"), 600, 0.1, 1.0, 10.0
MOTION = sigmax.motions.constant_velocity(AXES)
PRIOR = sigmax.Gaussian(np.zeros(4), np.full(4, 1.0))
# A third of the record with the noise of the model, a third with another one, a third with that of the model.
THIRDS = {"before": slice(50, 200), "meanwhile": slice(200, 400), "after": slice(400, 600)}


def model(density: float = DENSITY, variance: float = VARIANCE) -> sigmax.Model:
    """A target in the plane whose position is measured once a second."""
    sensor = sigmax.sensors.position(names=("east", "north"))
    return sigmax.Model(motion=MOTION, Q=MOTION.noise(density), sensor=sensor, R=[variance] * 2)


def drawn(tracks: int, of_R: float, of_Q: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Truth (B, T, 4) and positions (B, T, 2), the variances multiplied in the middle third."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(DENSITY * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]))
    x, truth, z = rng.normal(size=(tracks, 4)), [], []
    for k in range(STEPS):
        middle = THIRDS["meanwhile"].start <= k < THIRDS["meanwhile"].stop
        w = np.sqrt(of_Q if middle else 1.0) * rng.normal(size=(tracks, 2, 2)) @ root.T
        x = np.concatenate([x[:, :2] + x[:, 2:] + w[..., 0], x[:, 2:] + w[..., 1]], 1)
        truth.append(x)
        z.append(x[:, :2] + np.sqrt(VARIANCE * (of_R if middle else 1.0)) * rng.normal(size=(tracks, 2)))
    return np.stack(truth, 1), np.stack(z, 1)


def entries(of_R: float, of_Q: float) -> dict[str, tuple[Any, sigmax.Model]]:
    """Ways to run the record: a filter and a model."""
    one, other = model(), model(DENSITY * of_Q, VARIANCE * of_R)
    each = sigmax.imm({"one": one, "other": other}, sojourn=[200.0, 200.0])
    return {
        "noises of the model": ("SRCKFB", one),
        'update="adaptive(50)"': (sigmax.get("SRCKFB", update="adaptive(50)"), one),
        'Q="adaptive(50)"': (sigmax.get("SRCKFB", Q="adaptive(50)"), one),
        "both": (sigmax.get("SRCKFB", update="adaptive(50)", Q="adaptive(50)"), one),
        "two modes, both noises known": ("SRCKFB", each),
    }


def scored(result: Any, truth: np.ndarray) -> list[str]:
    """Root mean square of the position's error and NEES/4, in each third."""
    error = np.asarray(result.errors(truth))
    nees = np.einsum("btj,btj->bt", error, np.linalg.solve(np.asarray(result.cov), error[..., None])[..., 0]) / 4
    each = [(np.sqrt((error[:, third, :2] ** 2).sum(-1).mean()), nees[:, third].mean()) for third in THIRDS.values()]
    return [f"{rms:.3f}, {n:.2f}" for rms, n in each]


def study(title: str, tracks: int, of_R: float, of_Q: float, seed: int) -> Section:
    """One table: who does how well while noises change."""
    truth, z = drawn(tracks, of_R, of_Q, seed)
    rows = []
    for name, (filter, own) in entries(of_R, of_Q).items():
        result = sigmax.run(filter, own, PRIOR, z)
        rows.append((name, *scored(result, truth), f"{float(np.sum(result.log_likelihood)) / z[..., 0].size:.3f}"))
    changed = " and ".join(f"{n} is {by:g} times that of the model" for n, by in (("R", of_R), ("Q", of_Q)) if by != 1)
    note = f"{tracks} tracks of {STEPS} steps; in the middle third {changed}." if changed else f"{tracks} tracks."
    columns = ("SRCKFB with", *(f"{third}: rmse in m, NEES/4" for third in THIRDS), "log-likelihood a step")
    return Section(title, note, columns, rows)


def timed(rounds: int) -> Section:
    """Microseconds of a step, one record and a batch."""
    _, z = drawn(64, 1.0, 1.0, 0)
    rows, base = [], [0.0, 0.0]
    for name, (filter, own) in entries(2.0, 2.0).items():
        each = []
        for record in (np.tile(z[0], (4, 1)), z):
            best = np.inf
            for _ in range(rounds + 1):  # the first compiles
                begun = time.process_time()
                sigmax.run(filter, own, PRIOR, record, keep=("mean", "factor"))
                best = min(best, time.process_time() - begun)
            each.append(best / record[..., 0].size * 1e6)
        base = each if not any(base) else base
        rows.append((name, *(f"{e:.2f} ({e / b:.1f})" for e, b in zip(each, base, strict=True))))
    note = f"Processor time, the best of {rounds} rounds; in brackets as a multiple of the first."
    return Section("What it costs", note, ("SRCKFB with", "µs a step, a record", "µs a step, 64 tracks"), rows)


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Page whose marked part is replaced.")] = None,
    tracks: Annotated[int, typer.Option(help="Tracks of each study.")] = 300,
    rounds: Annotated[int, typer.Option(help="How often times are taken.")] = 7,
) -> None:
    """Measure, show, and write where asked."""
    sections = [
        study("R ten times as large for a while", tracks, TIMES, 1.0, 1),
        study("Q ten times as large for a while", tracks, 1.0, TIMES, 2),
        study("Both right all along", tracks, 1.0, 1.0, 3),
        timed(rounds),
    ]
    for section in sections:
        show(section, Console())
    if page is not None:
        text = "\n".join(map(markdown, sections))
        write(page, f"Made by `python benchmarks/adaptive.py --write {page}`.\n\n{text}", BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
