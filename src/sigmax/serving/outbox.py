"""What waits for a consumer: bounded, and never a reason for anyone else to wait."""

import asyncio
from collections import deque

# Bytes that may wait for one consumer; the messages themselves are shared by all.
ROOM = 32 << 20


class Outbox:
    """Messages for one consumer. Where it does not read, the oldest go, and it is told how many it missed."""

    def __init__(self, room: int = ROOM) -> None:
        self._room = room
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._missed = 0
        self._writing = False
        self._news, self._space = asyncio.Event(), asyncio.Event()
        self._space.set()

    @property
    def idle(self) -> bool:
        """Whether nothing waits, nor is being written."""
        return not self._waiting and not self._writing

    def put(self, message: bytes) -> None:
        """Add a message; the newest stays in any case."""
        self._waiting.append(message)
        self._bytes += len(message)
        while self._bytes > self._room and len(self._waiting) > 1:
            self._bytes -= len(self._waiting.popleft())
            self._missed += 1
        if self._bytes > self._room // 2 > 0:
            self._space.clear()
        self._news.set()

    async def get(self) -> bytes:
        """The next message as lines, after how many were missed, where any were."""
        while not self._waiting:
            self._news.clear()
            await self._news.wait()
        self._writing = True
        message = self._waiting.popleft()
        self._bytes -= len(message)
        if self._bytes <= self._room // 2:
            self._space.set()
        missed, self._missed = self._missed, 0
        return (b'{"missed":%d}\n' % missed if missed else b"") + message + b"\n"

    def done(self) -> None:
        """What `get` gave last has been written."""
        self._writing = False

    def close(self) -> None:
        """Nobody reads any more: nobody waits for space either."""
        self._space.set()
        self._room = 0

    def release(self) -> None:
        """Nobody waits for space any more, full as it may be."""
        self._space.set()

    async def space(self) -> None:
        """Wait until half of the room is free: for a pipe, in which nothing may be lost."""
        await self._space.wait()
