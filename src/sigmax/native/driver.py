"""Compiled steps called from Python: over records, backwards, and over rows."""

import ctypes
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from sigmax.native.build import load, load_all, remember, remembered
from sigmax.native.emit import lanes_source
from sigmax.native.loops import Loops, loops_in
from sigmax.native.machine import cores, lane_bytes, vector_functions
from sigmax.native.pieces import LARGEST, LARGEST_TABLES, Program
from sigmax.native.refusal import Refused

_DRIVER = Path(__file__).parent / "c" / "record.c"


class Step(NamedTuple):
    """A compiled program.

    Attributes:
        address: of its C function.
        setup: what stays the same over all steps, from the parameters.
        workspace: numbers of each lane that it needs room for.
        preparing: the address of the C function behind `setup`.
        constants: how many numbers that makes.
    """

    address: int
    setup: Callable[[np.ndarray], np.ndarray]
    workspace: int
    preparing: int
    constants: int


class Series(ctypes.Structure):
    """An array by track and step, see record.c."""

    _fields_ = [("data", ctypes.c_void_p), *((k, ctypes.c_long) for k in ("size", "per_track", "per_step"))]


# Nothing to read, of any track and step.
EMPTY = Series(None, 0, 0, 0)


class SensorJob(ctypes.Structure):
    """One sensor of a record, see record.c."""

    _fields_ = [
        ("correct", ctypes.c_void_p),
        ("c", ctypes.c_void_p),
        ("z", Series),
        ("dim", ctypes.c_long),
        ("residual", ctypes.c_void_p),
        ("factor", ctypes.c_void_p),
    ]


class Settled(ctypes.Structure):
    """A step at a factor and an interval that stay the same, see record.c."""

    _fields_ = [
        *((k, ctypes.c_void_p) for k in ("step", "setup", "numbers")),
        *((k, ctypes.c_long) for k in ("count", "constants")),
    ]


class RecordJob(ctypes.Structure):
    """A record to be filtered, see record.c."""

    _fields_ = [
        *((k, ctypes.c_long) for k in ("tracks", "steps", "points", "n", "size")),
        *((k, ctypes.c_void_p) for k in ("predict", "c")),
        *((k, Series) for k in ("dt", "u")),
        ("sensors", ctypes.c_long),
        ("sensor", ctypes.POINTER(SensorJob)),
        *(
            (k, ctypes.c_void_p)
            for k in ("state", "total", "mean", "factor", "nis", "log_likelihood", "fault", "dof", "rest")
        ),
        ("moving_from", ctypes.c_long),
        ("workspace", ctypes.c_long),
        ("settled", ctypes.POINTER(Settled)),
    ]


class SmoothingJob(ctypes.Structure):
    """A record to be smoothed, see record.c."""

    _fields_ = [
        *((k, ctypes.c_long) for k in ("tracks", "steps", "points", "n", "size")),
        *((k, ctypes.c_void_p) for k in ("back", "c")),
        *((k, Series) for k in ("mean", "factor", "rest", "fault", "dt", "u")),
        *((k, ctypes.c_void_p) for k in ("new_mean", "new_factor", "new_rest", "failed")),
        ("workspace", ctypes.c_long),
    ]


class RowsJob(ctypes.Structure):
    """A function of rows, see record.c."""

    _fields_ = [
        *((k, ctypes.c_void_p) for k in ("map", "c")),
        ("given", Series),
        ("size", ctypes.c_long),
        ("made", ctypes.c_void_p),
        ("workspace", ctypes.c_long),
    ]


class TotalsJob(ctypes.Structure):
    """A function to be added up over tracks, see record.c."""

    _fields_ = [
        *((k, ctypes.c_void_p) for k in ("map", "c")),
        *((k, ctypes.c_long) for k in ("steps", "parts", "size")),
        ("part", ctypes.POINTER(Series)),
        ("sums", ctypes.c_void_p),
        ("workspace", ctypes.c_long),
    ]


class Squares(ctypes.Structure):
    """Factors to be squared, see record.c."""

    _fields_ = [
        *((k, ctypes.c_long) for k in ("n", "per", "packed")),
        *((k, ctypes.c_void_p) for k in ("factor", "cov")),
    ]


def steps(
    programs: Sequence[tuple[str | None, Callable[[], Program | Loops]]], single: bool, alone: bool = False
) -> list[Step]:
    """Programs compiled side by side, each given by what makes it.

    A fingerprint before it, if there is one, says under which name its source is remembered from another
    process: then it need not be made. `alone` is for a single track: less work, and the same bits.

    Raises:
        Refused: where a program cannot be made.
        Unavailable: without a compiler, or where it fails.
    """
    vectors = vector_functions(single)
    lanes = lane_bytes() // (4 if single else 8) if alone else 0

    def source(fingerprint: str | None, make: Callable[[], Program | Loops]) -> str:
        name = None if fingerprint is None else f"{fingerprint}-{lane_bytes()}-{len(vectors)}-{lanes}"
        known = None if name is None else remembered(name)
        if known is None:
            program = make()
            known = program.source if isinstance(program, Loops) else _straight(program, vectors, lanes)
            if name is not None:
                remember(name, known)
        return known

    sources = [(_DRIVER.read_text(), single, False, alone)]
    sources += [(made, single, not loops_in(made), alone) for made in (source(*program) for program in programs)]
    _, *libraries = load_all(sources)
    return [_step(library, np.dtype(np.float32 if single else np.float64)) for library in libraries]


def _straight(program: Program, vectors: Mapping[str, str], lanes: int) -> str:
    if program.operations > LARGEST:
        raise Refused(f"a half-step of {program.operations:,} operations, more than {LARGEST:,}")
    numbers = sum(table.size for table in program.graph.tables)
    if numbers > LARGEST_TABLES:
        raise Refused(f"a half-step with tables of {numbers:,} numbers, more than {LARGEST_TABLES:,}")
    return lanes_source(program, vectors, lanes)


def _step(library: ctypes.CDLL, dtype: np.dtype[Any]) -> Step:
    library.constants.restype = library.workspace.restype = ctypes.c_long
    size = library.constants()

    def setup(parameters: np.ndarray) -> np.ndarray:
        given, made = np.ascontiguousarray(parameters, dtype), np.empty(size, dtype)
        library.setup(ctypes.c_void_p(given.ctypes.data), ctypes.c_void_p(made.ctypes.data))
        return made

    address, preparing = (ctypes.cast(f, ctypes.c_void_p).value for f in (library.step, library.setup))
    assert address is not None
    assert preparing is not None
    return Step(address, setup, library.workspace(), preparing, size)


@cache
def driver(single: bool, alone: bool = False) -> Mapping[str, Any]:
    """The functions of record.c by name; `alone` where the steps that they call are."""
    library = load(_DRIVER.read_text(), single, straight=False, alone=alone)
    made = {}
    for name in ("record", "backwards", "rows", "totals", "squares"):
        function = getattr(library, name)
        function.restype = None
        function.argtypes = [ctypes.c_void_p, ctypes.c_long, ctypes.c_long]
        made[name] = function
    return made


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="sigmax")


# The threads stay behind in the process that forks.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def over_cores(function: Any, job: ctypes.Structure, tracks: int, single: bool) -> None:
    """Call a function of the driver over all tracks, in parts of whole lanes, one for each core."""
    lanes = lane_bytes() // (4 if single else 8)
    address = ctypes.addressof(job)
    parts = cores() if tracks >= 2 * lanes else 1
    if parts == 1:
        function(address, 0, tracks)
        return
    size = -(-tracks // (parts * lanes)) * lanes
    bounds = [(first, min(first + size, tracks)) for first in range(0, tracks, size)]
    for done in [_pool().submit(function, address, *bound) for bound in bounds]:
        done.result()


def pointer(array: np.ndarray | None) -> int | None:
    """The address of an array's numbers."""
    if array is None:
        return None
    try:
        # What `array.ctypes.data` is, in a quarter of the time.
        return ctypes.addressof(ctypes.c_char.from_buffer(cast(Any, array)))
    except (BufferError, TypeError, ValueError):  # nothing in it, read only, or not in one piece
        return array.ctypes.data


def series(array: np.ndarray, core: int, track: bool, step: bool) -> Series:
    """An array with the axes (track, step, …) as far as it has them, the last `core` being one element's."""
    size = math.prod(array.shape[array.ndim - core :])
    steps_ = array.shape[1 if track else 0] if step else 1
    return Series(pointer(array), size, size * steps_ if track else 0, size if step else 0)
