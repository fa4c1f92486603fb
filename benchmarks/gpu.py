"""The batch on whatever JAX finds: XLA beside the native engine, and how far their answers lie apart.

python benchmarks/gpu.py --write benchmarks/gpu.md

Where there is no GPU it says so, and compares the two engines on the processor.
"""

import os
import time
from pathlib import Path
from typing import Annotated, NamedTuple

import jax
import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress

import sigmax
from machine import description
from report import Section, markdown, show, write
from scenario import DT, MEAN, PRIOR, STEPS, Q, R, record

FILTERS = ("SRCKFB", "SRECKFB", "SREKFB", "EKF")
KEEP = {"log-likelihood": (), "means": ("mean",), "means and covariances": ("mean", "factor")}
ROUNDS = 5
BEGIN, END = "<!-- results: written by gpu.py -->", "<!-- end of results -->"


def radar() -> sigmax.Model:
    """The task of the other benchmarks, with the motion and the sensor that we ship."""
    turn, sensor = sigmax.motions.coordinated_turn(), sigmax.sensors.range_azimuth(polar_velocity=(2, 3))
    return sigmax.Model(
        motion=turn.function, sensor=sensor.function, Q=Q, R=R, state=turn.state, measurement=sensor.measurement
    )


class Timed(NamedTuple):
    """The first call in seconds, compilation included; a later one in nanoseconds a track and step; its means."""

    first: float
    each: float
    mean: np.ndarray | None


def timed(filter: str, z: np.ndarray, keep: tuple[str, ...], dtype: str, backend: str) -> Timed:
    """The median of some calls, results in NumPy's arrays on the host."""
    model, prior = radar(), sigmax.Gaussian(MEAN, np.diag(PRIOR))

    def call() -> sigmax.Result:
        result = sigmax.run(filter, model, prior, z, dt=DT, keep=keep, dtype=dtype, backend=backend)
        np.asarray(result.log_likelihood)
        return result

    start = time.perf_counter()
    result = call()
    first = time.perf_counter() - start
    seconds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    each = float(np.median(seconds)) / z.shape[0] / z.shape[1] * 1e9
    return Timed(first, each, np.asarray(result.mean) if "mean" in keep else None)


def row(filter: str, z: np.ndarray, what: str, dtype: str) -> tuple[str, ...]:
    """A line of the table: both engines on one batch."""
    native = timed(filter, z, KEEP[what], dtype, "native")
    xla = timed(filter, z, KEEP[what], dtype, "xla")
    apart = ""
    if native.mean is not None and xla.mean is not None:
        scale = np.sqrt(PRIOR)
        apart = f"{np.max(np.abs(native.mean - xla.mean) / scale):.0e}"
    ratio = native.each / xla.each
    figures = f"{native.each:.1f}", f"{xla.each:.1f}", f"{ratio:.2f}", f"{xla.first:.1f}"
    return f"{filter}, {dtype}", what, str(len(z)), *figures, apart


def main(
    tracks: Annotated[list[int] | None, typer.Option(help="How many tracks; may be repeated.")] = None,
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
) -> None:
    """Time the batch of the coordinated turn on both engines; minutes, of which XLA compiles most."""
    console, load = Console(), os.getloadavg()[0]
    device = jax.devices()[0]
    if device.platform == "cpu":
        console.print("JAX finds no GPU here: both engines run on the processor.")
    sizes = tracks or [4096, 65536]
    plan = [(f, "float64", "means", n) for f in FILTERS for n in sizes]
    plan += [("SRCKFB", "float32", "means", n) for n in sizes]
    plan += [("SRCKFB", "float64", what, sizes[-1]) for what in KEEP if what != "means"]
    rows = []
    with Progress(console=console) as progress:
        bar = progress.add_task("drawing tracks", total=len(plan))
        z = record(max(sizes)).z
        for filter, dtype, what, n in plan:
            progress.update(bar, description=f"{filter}, {dtype}, {n} tracks, {what}")
            rows.append(row(filter, z[:n], what, dtype))
            progress.console.print(" | ".join(rows[-1]))
            progress.advance(bar)
    machine = "; ".join(f"{what}: {value}" for what, value in description(load))
    note = (
        f"XLA on {device.device_kind} ({device.platform}), native on all cores; {STEPS} steps, nanoseconds a track and "
        f"step, the median of {ROUNDS} calls, arrays on the host before and after. Apart: the greatest difference of "
        f"the means, in deviations of the prior. {machine}."
    )
    columns = (
        "filter", "kept", "tracks", "native, ns", "XLA, ns", "native / XLA", "first call of XLA, s", "apart",
    )  # fmt: skip
    section = Section("The batch on XLA", note, columns, rows)
    show(section, console)
    if page is not None:
        command = "python benchmarks/gpu.py" + "".join(f" --tracks {n}" for n in tracks or ()) + f" --write {page}"
        write(page, "\n".join([f"Made by `{command}`.", "", markdown(section)]), BEGIN, END)
        console.print(f"written to {page}")


if __name__ == "__main__":
    typer.run(main)
