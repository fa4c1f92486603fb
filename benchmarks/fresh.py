"""Whole processes: what one waits for the first result, and for the help text."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

CACHED = "sigmax, compiled before"
_HELP = "import sys; from sigmax.cli import main; sys.argv = ['sigmax', '--help']; main()"


class Process(NamedTuple):
    """Wall time of processes, round by round, and what they told of themselves."""

    seconds: np.ndarray
    told: list[dict[str, float]]


def _run(command: list[str], **environment: str) -> tuple[float, str]:
    # Wide enough for any help text; a failure is the caller's to see.
    environment = {**os.environ, "COLUMNS": "100", **environment}
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return time.perf_counter() - start, done.stdout


def first_results(libraries: list[str], rounds: int, tick: Callable[[str], None]) -> dict[str, Process]:
    """`first.py` for every library, in turns; for this one with nothing compiled before, then again as `CACHED`."""
    script = str(Path(__file__).with_name("first.py"))
    names = [name for library in libraries for name in ([library, CACHED] if library == "sigmax" else [library])]
    found: dict[str, list[tuple[float, str]]] = {name: [] for name in names}
    for _ in range(rounds):
        with tempfile.TemporaryDirectory(prefix="fresh-") as cache:
            for name in names:
                tick(name)
                command = [sys.executable, script, "sigmax" if name == CACHED else name]
                found[name].append(_run(command, SIGMAX_CACHE=cache))
    return {k: Process(np.array([s for s, _ in v]), [json.loads(out) for _, out in v]) for k, v in found.items()}


def help_text(rounds: int, tick: Callable[[str], None]) -> np.ndarray | None:
    """`sigmax --help` as the installed command runs it; None where there is no command line."""
    command = [sys.executable, "-c", _HELP]
    try:
        _run(command)
    except subprocess.CalledProcessError:
        return None
    seconds = []
    for _ in range(rounds):
        tick("sigmax --help")
        seconds.append(_run(command)[0])
    return np.array(seconds)
