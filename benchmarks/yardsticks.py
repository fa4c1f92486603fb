"""Programs written by hand for the same task, and this library beside them: each on one core, round by round."""

import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from measure import spread
from report import Section
from scenario import DT, MEAN, PRIOR, STEPS, Q, R

_HERE = Path(__file__).parent
FILTERS = ("SRCKFB", "SRECKFB", "EKF", "SREUKFB")
LANES, UNROLLED, EIGEN = "C over lanes", "C over lanes, loops unrolled", "C++ with Eigen"
TWO_CORES, LIVE = "sigmax SRCKFB, on two cores", "sigmax SRCKFB, one live step called from Python"


class Program(NamedTuple):
    """How a yardstick is made: source, compiler with its flags, and where to get what it needs.

    `slow` ones are called once in a round.
    """

    source: str
    command: tuple[str, ...]
    needs: str
    slow: bool = False


_LANES = ("gcc", "-Ofast", "-march=native", "-fopenmp-simd")
PROGRAMS = {
    LANES: Program("lanes.c", _LANES, "GCC"),
    UNROLLED: Program("lanes.c", (*_LANES, "-DUNROLL"), "GCC"),
    EIGEN: Program(
        "eigen.cpp",
        ("g++", "-O3", "-march=native", "-DNDEBUG"),
        "GCC for C++ and the headers of Eigen (Debian: apt-get install libeigen3-dev)",
        slow=True,
    ),
}
LINES = len(PROGRAMS) + len(FILTERS) + 2


class PerCore(NamedTuple):
    """What was measured.

    Attributes:
        seconds: of a call that filters all tracks (of a whole track for the live step), by line, round by round.
        means: what the programs computed.
        left_out: why some are not there, a sentence each.
    """

    seconds: dict[str, np.ndarray]
    means: dict[str, np.ndarray]
    left_out: list[str]


@contextmanager
def on(cores: list[int]) -> Iterator[None]:
    """Processes started inside run on these cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _header() -> str:
    arrays = {"MEAN": MEAN, "ROOT_PRIOR": np.sqrt(PRIOR), "ROOT_Q": np.sqrt(Q * DT), "ROOT_R": np.sqrt(R)}
    lines = [f"#define {name} {value}" for name, value in dict(N=len(MEAN), M=len(R), STEPS=STEPS, DT=DT).items()]
    for name, values in arrays.items():
        lines.append(f"static const double {name}[] = {{{', '.join(repr(float(x)) for x in values)}}};")
    return "\n".join([*lines, ""])


def _built(program: Program, to: Path) -> bool:
    source = _HERE / "yardsticks" / program.source
    command = [*program.command, "-w", f"-I{to.parent}", str(source), "-o", str(to), "-lm"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


@contextmanager
def _sigmax(cores: list[int], z: Path, tracks: int, calls: int) -> Iterator[Callable[[str], float]]:
    command = [sys.executable, str(_HERE / "pinned.py"), str(z), str(tracks), str(calls)]
    with on(cores):
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def seconds(what: str) -> float:
        print(what, file=process.stdin, flush=True)
        answer = process.stdout.readline() if process.stdout else ""
        if not answer:
            raise RuntimeError(f"the process that was to filter ({what}) has ended")
        return float(answer)

    with process:
        yield seconds


def per_core(z: np.ndarray, rounds: int, calls: int, tick: Callable[[str], None]) -> PerCore:
    """Everybody in turns on the last core; a line of a round is the best of some calls."""
    if not hasattr(os, "sched_setaffinity"):
        return PerCore({}, {}, ["This system does not tie processes to cores, so nothing is measured on one."])
    tracks, cores = len(z), sorted(os.sched_getaffinity(0))
    seconds, means, left_out = defaultdict(list), {}, []
    lines: dict[str, Callable[[], float]] = {}
    with tempfile.TemporaryDirectory(prefix="yardsticks-") as name, ExitStack() as stack:
        folder = Path(name)
        z.tofile(folder / "z")
        (folder / "scenario.h").write_text(_header())

        def timed(made: Path, program: Program) -> float:
            command = [made, folder / "z", made.with_suffix(".mean"), str(tracks), "1" if program.slow else str(calls)]
            with on(cores[-1:]):
                return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["best"]

        for k, (label, program) in enumerate(PROGRAMS.items()):
            made = folder / f"program{k}"
            if _built(program, made):
                lines[label] = lambda made=made, program=program: timed(made, program)
            else:
                left_out.append(f"{label} could not be compiled and is left out; it needs {program.needs}.")
        one = stack.enter_context(_sigmax(cores[-1:], folder / "z", tracks, calls))
        lines |= {f"sigmax {filter}": lambda filter=filter: one(f"batch {filter}") for filter in FILTERS}
        if len(cores) > 1:
            two = stack.enter_context(_sigmax(cores[-2:], folder / "z", tracks, calls))
            lines[TWO_CORES] = lambda: two("batch SRCKFB")
        lines[LIVE] = lambda: one("live SRCKFB")
        for turn in range(rounds + 1):  # the first one warms up
            for label, measured in lines.items():
                tick(label)
                found = measured()
                if turn:
                    seconds[label].append(found)
        for k, label in enumerate(PROGRAMS):
            if label in lines:
                means[label] = np.fromfile(folder / f"program{k}.mean").reshape(tracks, STEPS, len(MEAN))
    return PerCore({label: np.array(found) for label, found in seconds.items()}, means, left_out)


def section(found: PerCore, tracks: int, rounds: int) -> Section:
    """Times, and ratios to the C over lanes."""
    rows = []
    for label, seconds in found.seconds.items():
        each = spread(seconds * 1e6 / STEPS / (1 if label == LIVE else tracks))
        ratios = [str(spread(seconds / found.seconds[c])) if c in found.seconds else "–" for c in (LANES, UNROLLED)]
        rows.append((label, str(each), *(["–", "–"] if label == LIVE else ratios)))
    note = (
        f"{tracks} tracks of {STEPS} steps, means alone, all on the same core in turns; median (least–greatest) of "
        f"{rounds} rounds. The programs are SRCKFB; they check nothing, know no missing measurement and compute no "
        "likelihood. " + " ".join(found.left_out)
    )
    columns = ("", "µs per track and step", "time, in the lanes'", "in the unrolled lanes'")
    return Section("Per core, against programs written by hand", note.strip(), columns, rows)
