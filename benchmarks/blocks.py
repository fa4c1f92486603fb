"""A batch that does not fit memory: time and peak memory of `run_in_blocks`, the measurements in a file.

python benchmarks/blocks.py --tracks 1000000
"""

import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import sigmax
from scenario import STEPS, record
from sigmax.running import run_in_blocks


def peak_memory() -> int:
    """The most memory that this process has had, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def main(
    tracks: Annotated[int, typer.Option(help="How many.")] = 1_000_000,
    block: Annotated[int, typer.Option(help="Filtered at a time.")] = 4096,
    filter: Annotated[str, typer.Argument(help="A name of the catalogue.")] = "SRCKFB",
) -> None:
    """Filter so many tracks, with all parts of the result, and add up what a user would ask of them."""
    turning, drawn = sigmax.builtin("radar-ct"), record(min(block, tracks)).z
    with tempfile.TemporaryDirectory(prefix="blocks-") as folder:
        path = Path(folder) / "z.npy"
        z = np.lib.format.open_memmap(path, "w+", shape=(tracks, STEPS, 3))
        for k in range(0, tracks, len(drawn)):
            z[k : k + len(drawn)] = drawn[: tracks - k]
        z.flush()
        del z
        z = np.load(path, mmap_mode="r")
        start, used, of_file = time.perf_counter(), time.process_time(), peak_memory()
        nis = largest = 0.0
        for _, result in run_in_blocks(filter, turning.model, turning.prior, z, dt=1.0, tracks=block):
            nis += float(result.nis.sum())
            largest = max(largest, float(result.cov[:, -1, 0, 0].max()))
        wall, used = time.perf_counter() - start, time.process_time() - used
        peak = peak_memory()
    count = tracks * STEPS
    print(f"{tracks:,} tracks of {STEPS} steps, {filter}, all parts, {block:,} at a time: NIS {nis / count:.3f}")
    print(f"{wall:.0f} s, {used / count * 1e9:.0f} ns of processor a track and step")
    print(f"peak memory {peak / 2**30:.2f} GiB, {of_file / 2**30:.2f} GiB of it when the file had been written")


if __name__ == "__main__":
    typer.run(main)
