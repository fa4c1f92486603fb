"""The memory that is left, asked before it is taken."""

import contextlib
import os
from pathlib import Path

from sigmax.errors import InputError


def check_room(name: str, needed: float, size: str) -> None:
    """Refuse a file that the memory cannot take.

    Args:
        name: of the file.
        needed: bytes that it will take.
        size: of the file, in words.

    Raises:
        InputError: where less is left.
    """
    left = memory_left()
    if needed > left:
        raise InputError(
            f"{name} has {size}: about {needed / 1e9:.1f} GB of memory would be needed, {left / 1e9:.1f} GB are left; "
            "split it by time or by track, or leave out columns that are not needed"
        )


def memory_left() -> float:
    """Bytes that this process may still take: of the machine, of its container, of its own limit; else infinity."""
    return min(_of_machine(), _of_container(), _of_process())


def _of_machine() -> float:
    with contextlib.suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    return float("inf")


def _of_container() -> float:
    """What a control group leaves, of version 2 or 1; what its files hold in memory can be given up."""
    left = float("inf")
    for folder, most, used in (
        (Path("/sys/fs/cgroup"), "memory.max", "memory.current"),
        (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes", "memory.usage_in_bytes"),
    ):
        with contextlib.suppress(OSError, ValueError):
            limit = int((folder / most).read_text())
            counts = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            left = min(left, limit - int((folder / used).read_text()) + int(counts.get("inactive_file", 0)))
    return left


def _of_process() -> float:
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            return float(limit - pages * os.sysconf("SC_PAGE_SIZE"))
    return float("inf")
