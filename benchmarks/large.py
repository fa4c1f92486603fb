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

SIZES = ((5, 3), (15, 6), (30, 10), (60, 20), (100, 30))
# Of more than thirty states fewer: a step takes long enough.
TRACKS, STEPS, FEWER = 256, 30, 5
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
    steps = STEPS if n <= 30 else FEWER
    z = np.random.default_rng(0).normal(1.5, 1.0, (TRACKS, steps, m))

    def seconds(tracks: int) -> tuple[float, float, float]:
        """Of the clock, of this process and of the compilers."""
        start = time.perf_counter(), time.process_time(), sum(os.times()[2:4])
        result = sigmax.run(filter, ring, prior, z[:tracks], keep=("mean", "fault"), backend="native")
        end = time.perf_counter(), time.process_time(), sum(os.times()[2:4])
        assert result.ok.all()
        return end[0] - start[0], end[1] - start[1], end[2] - start[2]

    first = seconds(1)
    whole = min(seconds(TRACKS)[1] for _ in range(5))
    each = whole / TRACKS / steps * 1e6
    return filter, str(n), str(m), f"{first[0]:.2f}", f"{first[1] + first[2]:.2f}", f"{first[2]:.2f}", f"{each:.2f}"


def main(
    filter: Annotated[str, typer.Option(help="A filter of the catalogue.")] = "SRCKFB",
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
) -> None:
    """Time models of 5 to 100 states, each compiled into an empty cache; takes about a minute."""
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
        "The first call of one track lowers and compiles: its seconds by the clock, by all processors, and what the "
        f"compiler has of these. A step is that of one of {TRACKS} tracks over {STEPS} steps ({FEWER} above thirty "
        f"states), in time of one core. {machine}."
    )
    columns = (
        *("filter", "states", "measured", "first call, s", "of processors, s", "of the compiler, s"),
        "µs of a core per track and step",
    )
    section = Section("Larger models", note, columns, rows)
    show(section, console)
    if page is not None:
        command = "python benchmarks/large.py" + f" --filter {filter}" * (filter != "SRCKFB") + f" --write {page}"
        write(page, "\n".join([f"Made by `{command}`.", "", markdown(section)]), BEGIN, END)
        console.print(f"written to {page}")


if __name__ == "__main__":
    typer.run(main)
