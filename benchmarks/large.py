"""What larger models cost on the native engine: lowering, compiling, a step.

python benchmarks/large.py --write benchmarks/README.md
"""

import os
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress

import sigmax
from machine import description
from report import Section, markdown, show, write

SIZES = ((5, 3), (15, 6), (30, 10))
TRACKS, STEPS = 256, 30
BEGIN, END = "<!-- large models: written by large.py -->", "<!-- end of large models -->"


def model(n: int, m: int) -> sigmax.Model:
    """A ring of n components, each moved by its neighbour, with m distances measured: nothing in it is linear."""

    def motion(x: Any, dt: Any) -> Any:
        return x + dt * 0.1 * jnp.sin(jnp.roll(x, -1)) * jnp.cos(x) - 0.05 * dt * x

    def sensor(x: Any) -> Any:
        pairs = [(x[2 * i % n], x[(2 * i + 1) % n]) for i in range(m)]
        return jnp.stack([jnp.sqrt(1 + a**2 + b**2) for a, b in pairs])

    return sigmax.Model(motion=motion, sensor=sensor, Q=np.full(n, 0.01), R=np.full(m, 0.1))


def measured(filter: str, n: int, m: int) -> tuple[str, ...]:
    """A row of the table; the cache on disk must be empty."""
    ring, prior = model(n, m), sigmax.Gaussian(np.ones(n), np.eye(n))
    z = np.random.default_rng(0).normal(1.5, 1.0, (TRACKS, STEPS, m))

    def seconds(tracks: int) -> float:
        start = time.perf_counter()
        result = sigmax.run(filter, ring, prior, z[:tracks], keep=("mean", "fault"), backend="native")
        elapsed = time.perf_counter() - start
        assert result.ok.all()
        return elapsed

    first, again = seconds(1), min(seconds(1) for _ in range(3))
    whole = min(seconds(TRACKS) for _ in range(3))
    each = whole / TRACKS / STEPS * 1e6
    return filter, str(n), str(m), f"{first - again:.2f}", f"{each:.2f}"


def main(
    filter: Annotated[str, typer.Option(help="A filter of the catalogue.")] = "SRCKFB",
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
) -> None:
    """Time models of 5, 15 and 30 states, each compiled into an empty cache; takes about a minute."""
    console, load_average = Console(), os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="large-") as cache, Progress(console=console) as progress:
        os.environ["SIGMAX_CACHE"] = cache
        bar = progress.add_task("warming up", total=len(SIZES) + 1)
        measured(filter, 2, 1)  # what a process does once
        rows = []
        for n, m in SIZES:
            progress.update(bar, description=f"{filter}, {n} states, {m} measured", advance=1)
            rows.append(measured(filter, n, m))
        progress.update(bar, advance=1)
    machine = "; ".join(f"{what}: {value}" for what, value in description(load_average)[:2])
    note = (
        f"Lowering and compiling is the first call less a later one. A step is that of one of {TRACKS} tracks over "
        f"{STEPS} steps, on all cores. {machine}."
    )
    columns = "filter", "states", "measured", "lower and compile, s", "µs per track and step"
    section = Section("Larger models", note, columns, rows)
    show(section, console)
    if page is not None:
        command = "python benchmarks/large.py" + f" --filter {filter}" * (filter != "SRCKFB") + f" --write {page}"
        write(page, "\n".join([f"Made by `{command}`.", "", markdown(section)]), BEGIN, END)
        console.print(f"written to {page}")


if __name__ == "__main__":
    typer.run(main)
