"""What short, long, live and linear records cost, by processor time; beside another checkout, in turns.

python benchmarks/everyday.py --against ../sigmax-before --write benchmarks/README.md
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- everyday: written by everyday.py -->", "<!-- end of everyday -->"


def cases() -> dict[str, tuple[str, int, Callable[[], Any]]]:
    """By name: what a number is the time of, how many of these a call has, and the call."""
    import jax.numpy as jnp
    import numpy as np

    import sigmax
    from scenario import record

    turning, z = sigmax.builtin("radar-ct"), record(1, 20_000).z[0]
    linear = sigmax.Model(
        motion=lambda x, dt: jnp.stack([x[0] + dt * x[2], x[1] + dt * x[3], x[2], x[3]]),
        sensor=lambda x: x[:2],
        Q=0.1 * np.eye(4),
        R=np.eye(2),
    )
    prior = sigmax.Gaussian(np.zeros(4), 10 * np.eye(4))
    places = np.random.default_rng(0).normal(size=(5000, 2)).cumsum(0)
    live = sigmax.Live("SRCKFB", turning.model, turning.prior)

    def run(filter: str, z: Any) -> Callable[[], Any]:
        return lambda: sigmax.run(filter, turning.model, turning.prior, z, dt=1.0)

    def straight(filter: str, steps: int) -> Callable[[], Any]:
        return lambda: sigmax.run(filter, linear, prior, places[:steps], dt=1.0)

    def steps(*parts: str) -> Callable[[], Any]:
        def go() -> None:
            live.put(begin, 0)
            for value in z[:1000]:
                live.step(value, 1.0)
                for part in parts:
                    getattr(live, part)

        begin = live.belief
        return go

    together = ("moments",) if hasattr(live, "moments") else ("mean", "cov")
    return {
        "run of 10 steps, SRCKFB": ("call", 1, run("SRCKFB", z[:10])),
        "run of 10 steps, KF, linear": ("call", 1, straight("KF", 10)),
        "run of 5,000 steps, KF, linear (n = 4, m = 2)": ("step", 5000, straight("KF", 5000)),
        "run of 5,000 steps, EKF, linear": ("step", 5000, straight("EKF", 5000)),
        "run of 20,000 steps, SRCKFB": ("step", 20_000, run("SRCKFB", z)),
        "live step, mean and covariance one by one": ("step", 1000, steps("mean", "cov")),
        "live step, mean and covariance together": ("step", 1000, steps(*together)),
    }


def worker() -> None:
    """Time what is asked for, line by line."""
    known = cases()
    for _, _, call in known.values():
        call()
        call()
    print(json.dumps([[name, unit] for name, (unit, _, _) in known.items()]), flush=True)
    for line in sys.stdin:
        _, count, call = known[line.rstrip("\n")]
        repeats = max(1, 1000 // count)
        start = time.process_time()
        for _ in range(repeats):
            call()
        print((time.process_time() - start) / repeats / count * 1e6, flush=True)


def started(checkout: Path) -> Any:
    """A process with the library of a checkout."""
    path = os.pathsep.join([str(checkout / "src"), str(Path(__file__).parent)])
    command = [sys.executable, __file__, "--worker"]
    return subprocess.Popen(command, env=os.environ | {"PYTHONPATH": path}, stdin=-1, stdout=-1, text=True)


def main(
    against: Annotated[Path | None, typer.Option(help="Another checkout of the library.")] = None,
    rounds: Annotated[int, typer.Option(help="How often each is timed.")] = 20,
    write: Annotated[Path | None, typer.Option(help="Put the table between the markers of a page.")] = None,
) -> None:
    """Print the table, and put it between the markers of a page."""
    from rich.console import Console

    from machine import description
    from report import Section, markdown, show
    from report import write as written

    load = os.getloadavg()[0]
    processes = [started(checkout.resolve()) for checkout in (ROOT, against) if checkout is not None]
    names = [json.loads(p.stdout.readline()) for p in processes].pop()
    rows = []
    for name, unit in names:
        found: list[list[float]] = []
        for k in range(rounds):
            told = {}
            for p in processes[:: 1 if k % 2 else -1]:
                print(name, file=p.stdin, flush=True)
                told[p.pid] = float(p.stdout.readline())
            found.append([told[p.pid] for p in processes])
        columns = list(zip(*found, strict=True))
        cells = [f"{min(c):.3g}" for c in columns]
        cells += [f"{statistics.median(b / a for a, b in found):.2f}"] if against is not None else []
        rows.append((name, unit, *cells))
    machine = "; ".join(f"{what}: {value}" for what, value in description(load)[:2])
    note = f"Least processor time of {rounds} rounds. {machine}."
    heads = ["", "time of a", "µs"]
    if against is not None:
        ref = subprocess.run(
            ["git", "-C", str(against), "rev-parse", "--short", "HEAD"], capture_output=True, text=True
        )
        heads += [f"at {ref.stdout.strip()}", "ratio"]
        note += " The ratio is the median of those within a round."
    section = Section("Short, long, live and linear", note, tuple(heads), rows)
    show(section, Console())
    if write is not None:
        command = "python benchmarks/everyday.py" + " --against CHECKOUT" * (against is not None)
        written(write, "\n".join([f"Made by `{command} --write {write}`.", "", markdown(section)]), BEGIN, END)


if __name__ == "__main__":
    if sys.argv[1:] == ["--worker"]:
        worker()
    else:
        typer.run(main)
