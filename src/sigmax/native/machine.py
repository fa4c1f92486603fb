"""What this machine has: a C compiler, its widest lanes, a vector library of functions."""

import ctypes
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

from sigmax.native.operations import OPERATIONS


class Compiler(NamedTuple):
    """How to call a C compiler, and what tells its output from another's."""

    command: tuple[str, ...]
    identity: str

    @property
    def is_gcc(self) -> bool:
        """Whether it is GCC, by the name of the file that is run in the end."""
        return len(self.command) == 1 and "gcc" in Path(self.command[0]).resolve().name


@cache
def compiler() -> Compiler | None:
    """The compiler that SIGMAX_CC names, else cc, gcc or clang, else that of the package ziglang.

    SIGMAX_CC may hold arguments too; empty it means none.
    """
    named = os.environ.get("SIGMAX_CC")
    for words in [shlex.split(named)] if named is not None else [["cc"], ["gcc"], ["clang"]]:
        found = shutil.which(words[0]) if words else None
        if found:
            return Compiler((found, *words[1:]), _file_identity(Path(found)))
    if named is None and importlib.util.find_spec("ziglang"):
        zig = Path(str(importlib.util.find_spec("ziglang").origin)).parent / "zig"  # type: ignore[union-attr]
        return Compiler((sys.executable, "-m", "ziglang", "cc"), _file_identity(zig))
    return None


def _file_identity(path: Path) -> str:
    path = path.resolve()
    try:
        about = path.stat()
    except OSError:
        return str(path)
    return f"{path} {about.st_size} {about.st_mtime_ns}"


@cache
def features() -> frozenset[str]:
    """The instruction sets of the processor, where the system tells them."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return frozenset()
    lines = (line.partition(":")[2] for line in text.splitlines() if line.lower().startswith(("flags", "features")))
    return frozenset(next(lines, "").split())


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """What code for "this machine" depends on."""
    told = " ".join([platform.machine(), platform.processor(), *sorted(features())])
    return hashlib.sha256(told.encode()).hexdigest()


# The width of the vector registers that every processor has.
NARROWEST = 16


@cache
def lane_bytes() -> int:
    """The width of the widest useful vector registers."""
    if {"avx512f", "avx512dq"} <= features():
        return 64
    return 32 if "avx2" in features() else NARROWEST


@cache
def vector_functions(single: bool) -> dict[str, str]:
    """The vector functions of the C library by operation, loaded so that compiled steps find them."""
    if platform.machine() != "x86_64" or platform.system() != "Linux":
        return {}
    try:
        library = ctypes.CDLL("libmvec.so.1", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return {}
    width = lane_bytes()
    lanes = width // (4 if single else 8)
    letter = {64: "e", 32: "d", 16: "b"}[width]
    found = {}
    for operation in OPERATIONS.values():
        if operation.calls:
            kind = "v" * operation.arity
            symbol = f"_ZGV{letter}N{lanes}{kind}_{operation.calls}{'f' if single else ''}"
            if hasattr(library, symbol):
                found[operation.calls] = symbol
    return found
