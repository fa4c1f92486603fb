"""Those who send lines: each waits for itself, and is told what became of its lines."""

import asyncio
import contextlib
from collections import deque
from typing import Any

import orjson

from sigmax.errors import InputError
from sigmax.serving.ends import End, read_pipe, turn_away
from sigmax.serving.lines import Splitter
from sigmax.serving.service import Service, Verdict, complaint

# Connections at a time, and complaints that wait for one of them.
_MOST, _COMPLAINTS = 64, 16


class Sender:
    """Counts the lines of one sender that have been dealt with; this one tells nobody."""

    def tell(self, verdict: Verdict) -> None:
        """What became of its next line."""


class _Connection(Sender):
    """Tells them to a socket: {"ack": n} after the first n lines have been dealt with, and complaints."""

    def __init__(self) -> None:
        self._dealt, self._acknowledged = 0, 0
        self._complaints: deque[dict[str, Any]] = deque(maxlen=_COMPLAINTS)
        self._news = asyncio.Event()

    def tell(self, verdict: Verdict) -> None:
        self._dealt += 1
        if not verdict.taken:
            self._complaints.append(complaint(self._dealt, verdict))
        self._news.set()

    async def answer(self, writer: asyncio.StreamWriter, hello: bytes) -> None:
        """Write for ever; a sender that does not read its answers gets fewer of them."""
        writer.write(hello + b"\n")
        while True:
            await writer.drain()
            await self._news.wait()
            self._news.clear()
            while self._complaints:
                writer.write(orjson.dumps(self._complaints.popleft()) + b"\n")
            if self._dealt > self._acknowledged:
                self._acknowledged = self._dealt
                writer.write(b'{"ack":%d}\n' % self._acknowledged)


class _Request(Sender):
    """Tells it to a NATS client that asked for an answer, once the last line of its message is dealt with."""

    def __init__(self, lines: int, message: Any) -> None:
        self._left, self._lines, self._message = lines, lines, message
        self._complaints: list[dict[str, Any]] = []
        self._answers: set[asyncio.Task[None]] = set()

    def tell(self, verdict: Verdict) -> None:
        self._left -= 1
        if not verdict.taken and len(self._complaints) < _COMPLAINTS:
            self._complaints.append(complaint(self._lines - self._left, verdict))
        if not self._left and self._message.reply:
            answer = {"ack": self._lines, **({"refused": self._complaints} if self._complaints else {})}
            task = asyncio.create_task(self._respond(orjson.dumps(answer)))
            self._answers.add(task)

    async def _respond(self, answer: bytes) -> None:
        # Without a connection there is no acknowledgement: the sender will send again.
        with contextlib.suppress(Exception):
            await self._message.respond(answer)


async def from_pipe(queue: asyncio.Queue[Any], limit: int) -> None:
    """Lines of standard input, to its end."""
    splitter, sender = Splitter(limit), Sender()
    while chunk := await read_pipe():
        for line in splitter.feed(chunk):
            await queue.put((sender, line))
    for line in splitter.last():
        await queue.put((sender, line))


async def from_tcp(queue: asyncio.Queue[Any], limit: int, end: End, service: Service) -> asyncio.Server:
    """A server whose every connection may send lines; each is read only while there is room for its lines.

    Raises:
        InputError: where the address cannot be had.
    """
    connections = 0

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        if connections >= _MOST:
            await turn_away(reader, writer, f"{_MOST} senders are connected, which is the most")
            return
        connections += 1
        connection, splitter = _Connection(), Splitter(limit)
        hello = orjson.dumps({"taken": service.counts["taken"], "serials": service.serials})
        answering = asyncio.create_task(connection.answer(writer, hello))
        try:
            while chunk := await reader.read(1 << 16):
                for line in splitter.feed(chunk):
                    await queue.put((connection, line))
        except (OSError, asyncio.CancelledError):
            # The line broke, or the service ends: asyncio would print either as if it were a fault.
            pass
        finally:
            connections -= 1
            # A sender that closed its side may still wait for the last acknowledgement.
            answering.add_done_callback(lambda t: t.cancelled() or t.exception())
            asyncio.get_running_loop().call_later(5.0, answering.cancel)
            asyncio.get_running_loop().call_later(5.0, writer.close)

    try:
        return await asyncio.start_server(connected, end.host, end.port, limit=1 << 16)
    except OSError as error:
        raise InputError(f"cannot listen at {end}: {error.strerror or error}") from error


async def from_nats(queue: asyncio.Queue[Any], limit: int, end: End, client: Any) -> None:
    """Lines of the messages of a subject; what the bounded buffer of the client cannot hold is dropped and told."""

    async def arrived(message: Any) -> None:
        splitter = Splitter(limit)
        lines = [*splitter.feed(message.data), *splitter.last()]
        sender = _Request(len(lines), message)
        for line in lines:
            await queue.put((sender, line))

    await client.subscribe(end.subject, cb=arrived, pending_msgs_limit=4096, pending_bytes_limit=16 << 20)
    await asyncio.sleep(float("inf"))
