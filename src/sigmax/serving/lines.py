"""Bytes to lines of a bounded length."""

from typing import NamedTuple

# So much of a line that is refused is quoted.
QUOTED = 200


class Line(NamedTuple):
    """A line without its end; `whole` tells whether it kept the limit, else `text` is its beginning."""

    text: bytes
    whole: bool


class Splitter:
    """Cuts a stream into lines, holding at most `limit` bytes of one.

    What a longer line has beyond the limit is passed over as it comes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._held = bytearray()
        self._over = False

    def feed(self, chunk: bytes) -> list[Line]:
        """The lines that end in this chunk; empty ones are none."""
        *ended, rest = chunk.split(b"\n")
        found = []
        for part in ended:
            self._hold(part)
            found += self.last()
        self._hold(rest)
        return found

    def last(self) -> list[Line]:
        """What stands there without an end, as a line; none where nothing does."""
        line = Line(bytes(self._held.strip() if not self._over else self._held[:QUOTED]), not self._over)
        self._held.clear()
        self._over = False
        return [line] if line.text or not line.whole else []

    def _hold(self, part: bytes) -> None:
        if self._over:
            return
        self._over = len(self._held) + len(part) > self.limit
        self._held += part[: self.limit - len(self._held)]


def quoted(text: bytes) -> str:
    """The beginning of a line, for people: what cannot be shown is escaped."""
    shown = text[:QUOTED].decode("utf-8", "backslashreplace")
    return ascii(shown)[1:-1] + ("…" if len(text) > QUOTED else "")
