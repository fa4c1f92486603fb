"""A folder that is written beside its place and put there at the end, whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sigmax.errors import InputError
from sigmax.leftovers import clear_leftovers, held, part_of, remove
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
    part = part_of(folder)
    old = part.with_suffix(".old")

    def undo() -> None:
        remove(part)
        if old.exists() and not folder.exists():
            old.rename(folder)
        for p in above:
            if p.is_dir() and not any(p.iterdir()):
                p.rmdir()

    try:
        clear_leftovers(folder)
        with undone_by_signal(undo):
            part.mkdir(parents=True)
            with held(part):
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
            remove(old)
