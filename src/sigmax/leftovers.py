"""What processes begin under hidden names, `.NAME.NUMBER.part`, and leave behind when they are killed."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def part_of(place: Path) -> Path:
    """Where this process writes a file or folder before it takes its place."""
    return place.with_name(f".{place.name}.{os.getpid()}.part")


def clear_leftovers(place: Path) -> None:
    """Remove what processes that were killed have left beside a file or folder; what one had set aside comes back.

    Only what belongs to this user, carries the number of no living process and is held by none is touched.
    """
    pattern = re.compile(re.escape(f".{place.name}.") + r"(\d+)\.(part|old)")
    if not place.parent.is_dir():
        return
    for path in place.parent.iterdir():
        match = pattern.fullmatch(path.name)
        if match is None or path.is_symlink() or _lives(int(match[1])):
            continue
        with contextlib.suppress(OSError):
            if hasattr(os, "geteuid") and path.stat().st_uid != os.geteuid():
                continue
            with held(path):
                if match[2] == "old" and not place.exists():
                    path.rename(place)
                else:
                    remove(path)


@contextmanager
def held(place: Path) -> Iterator[None]:
    """Lock a file or folder as long as this process lives; one elsewhere that shares it sees that, not our number.

    Raises:
        OSError: where another process holds it.
    """
    if os.name != "posix":
        yield
        return
    import fcntl

    number = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(number)


def _lives(process: int) -> bool:
    if os.name != "posix":
        # There is no asking without harm.
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def remove(place: Path) -> None:
    """Remove a file, or a folder, again as long as another thread still writes into it."""
    for _ in range(50):
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                place.unlink()
        if not place.exists():
            return
