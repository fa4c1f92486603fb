"""A folder from which a service goes on after any kind of end: the last state, and a journal of the lines since."""

import contextlib
import fcntl
import os
import shutil
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from sigmax.errors import InputError
from sigmax.ownership import stranger
from sigmax.serving.tree import dumped, loaded

# A longer journal gives way to a new state.
JOURNAL = 16 << 20
_ANEW = "give another folder, or remove it to begin anew"


class Checkpoint:
    """The folder: `state-K` and the lines taken since it, `journal-K`.

    A line is durable once `append` has returned: it is written and synchronised. A new state is written beside the
    old, synchronised and renamed, so that at any moment one whole state and its journal are there.

    Args:
        folder: made where it is not there; one service at a time may hold it.
        digest: of all that the state depends on.

    Attributes:
        state: the last state, None where there is none.
        lines: the lines of the journal since.
        torn: bytes at the end of the journal that could not be used.
        beyond: whole lines among them: the journal was damaged, not only cut; it is kept as `damaged-K`.

    Raises:
        InputError: where another service holds the folder, another user could have written it, it belongs to another
            description, or cannot be used.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._digest = folder, digest
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if who := stranger(folder):
                raise InputError(
                    f"the checkpoint {folder} is not used: {who}; change that with chown or chmod, or {_ANEW}"
                )
            self._lock = (folder / "lock").open("wb")
        except OSError as error:
            raise InputError(f"the checkpoint {folder} cannot be written: {error}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._lock.close()
            raise InputError(f"the checkpoint {folder} is in use by another service") from error
        try:
            self._count, self.state = self._last()
            self.lines, whole, size, self.beyond = _read(self._path("journal"))
            self.torn = size - whole
            if self.beyond:
                shutil.copyfile(self._path("journal"), self._path("damaged"))
            if self.torn:
                os.truncate(self._path("journal"), whole)
            self._journal: BinaryIO = self._path("journal").open("ab")
            self._length = whole
            self._clear()
        except (InputError, OSError) as error:
            self._lock.close()
            if isinstance(error, OSError):
                raise InputError(f"the checkpoint {folder} cannot be used: {error}") from error
            raise

    @property
    def full(self) -> bool:
        """Whether it is time for a new state."""
        return self._length > JOURNAL

    def append(self, lines: Iterable[bytes]) -> None:
        """Write lines, without ends of line in them, so that they outlast a crash of the machine.

        Raises:
            InputError: where the disk does not take them.
        """
        data = b"".join(b"%08x %s\n" % (zlib.crc32(line), line) for line in lines)
        if data:
            with self._writing():
                self._journal.write(data)
                self._journal.flush()
                os.fdatasync(self._journal.fileno())
            self._length += len(data)

    def keep(self, state: Any) -> None:
        """Write the state that all lines so far have led to; the journal begins anew.

        Raises:
            InputError: where the disk does not take it.
        """
        with self._writing():
            self._write(state)
            self._journal.close()
            self._journal = self._path("journal").open("wb")
            self._length = 0
            self._clear()

    def close(self) -> None:
        """Let the folder go."""
        self._journal.close()
        self._lock.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"the checkpoint {self._folder} cannot be written: {error}; nothing acknowledged is lost"
            ) from error

    def _path(self, kind: str) -> Path:
        return self._folder / f"{kind}-{self._count}"

    def _write(self, state: Any) -> None:
        """The next state, beside the one before."""
        fresh = self._folder / "state.new"
        with fresh.open("wb") as file:
            file.write(dumped((self._digest, state)))
            file.flush()
            os.fsync(file.fileno())
        self._count += 1
        fresh.rename(self._path("state"))

    def _clear(self) -> None:
        """Make the names durable, and remove what is no longer needed."""
        number = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
        now = self._path("state"), self._path("journal")
        for path in [*self._folder.glob("state-*"), *self._folder.glob("journal-*")]:
            if path not in now:
                path.unlink(missing_ok=True)

    def _last(self) -> tuple[int, Any]:
        counts = []
        for path in self._folder.glob("state-*"):
            with contextlib.suppress(ValueError):
                counts.append(int(path.name.removeprefix("state-")))
        self._count = max(counts, default=0)
        if not counts:
            if any(self._folder.glob("journal-*")):
                raise InputError(f"{self._folder} has a journal without the state it began with; {_ANEW}")
            self._write(None)
            return self._count, None
        if who := stranger(self._path("state")):
            raise InputError(f"the checkpoint {self._folder} is not used: {who}; {_ANEW}")
        try:
            digest, state = loaded(self._path("state").read_bytes())
        except InputError as error:
            raise InputError(f"{self._path('state')} is damaged: {error}; {_ANEW}") from error
        if digest != self._digest:
            raise InputError(
                f"the checkpoint {self._folder} was made with another description, filter or version of sigmax; {_ANEW}"
            )
        return self._count, state


def _read(path: Path) -> tuple[list[bytes], int, int, int]:
    """The whole lines of a journal, the bytes they take, its size, and how many whole lines follow a damaged one."""
    if not path.exists():
        return [], 0, 0, 0
    data = path.read_bytes()
    # What follows the last end of line is no line.
    found = data.split(b"\n")[:-1]
    sound = [raw[:9] == b"%08x " % zlib.crc32(raw[9:]) for raw in found]
    first = sound.index(False) if False in sound else len(found)
    whole = sum(len(raw) + 1 for raw in found[:first])
    return [raw[9:] for raw in found[:first]], whole, len(data), sum(sound[first:])
