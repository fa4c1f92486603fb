"""A folder that is written beside its place and put there at the end, whole or not at all."""

import contextlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sigmax.errors import InputError
from sigmax.signals import undone_by_signal


@contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """A folder to write into that takes the place of `folder` at the end.

    An exception and a signal that ends the process remove what was begun; what a process left that was killed is
    removed here by the next one.

    Raises:
        InputError: where the disk does not take it.
    """
    folder = folder.absolute()
    above = [p for p in folder.parents if not p.exists()]
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    old = folder.with_name(f".{folder.name}.{os.getpid()}.old")

    def undo() -> None:
        _remove(part)
        if old.exists() and not folder.exists():
            old.rename(folder)
        for p in above:
            if p.is_dir() and not any(p.iterdir()):
                p.rmdir()

    try:
        clear_leftovers(folder)
        with undone_by_signal(undo):
            part.mkdir(parents=True)
            with _held(part):
                yield part
                if folder.exists():
                    folder.rename(old)
                part.rename(folder)
    except BaseException as error:
        undo()
        if isinstance(error, OSError):
            raise InputError(f"{folder} could not be written: {error}") from error
        raise
    finally:
        if folder.exists():
            _remove(old)


def clear_leftovers(folder: Path) -> None:
    """Remove what runs that were killed have left beside a folder; the result that one had set aside comes back.

    Only what belongs to this user, carries the number of no living process and is held by none is touched.
    """
    pattern = re.compile(re.escape(f".{folder.name}.") + r"(\d+)\.(part|old)")
    if not folder.parent.is_dir():
        return
    for path in folder.parent.iterdir():
        match = pattern.fullmatch(path.name)
        if match is None or path.is_symlink() or not path.is_dir() or _lives(int(match[1])):
            continue
        with contextlib.suppress(OSError):
            if hasattr(os, "geteuid") and path.stat().st_uid != os.geteuid():
                continue
            with _held(path):
                if match[2] == "old" and not folder.exists():
                    path.rename(folder)
                else:
                    _remove(path)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Lock a folder as long as this process lives; a process elsewhere that shares it sees that, not our number.

    Raises:
        OSError: where another process holds it.
    """
    if os.name != "posix":
        yield
        return
    import fcntl

    number = os.open(folder, os.O_RDONLY)
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


def _remove(folder: Path) -> None:
    """Remove a folder, again as long as another thread still writes into it."""
    for _ in range(50):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
