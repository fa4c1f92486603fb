"""Those who read updates: each has an outbox of its own."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

from sigmax.errors import InputError
from sigmax.serving.ends import End, turn_away, write_pipe
from sigmax.serving.outbox import Outbox
from sigmax.serving.service import Service

_MOST = 256


class Consumers:
    """All consumers of a service; a new one is sent what the state means, and the latest update.

    Args:
        service: whose updates they read.
        lossless: wait for the consumer rather than drop updates.
        told: is given each message for people.
    """

    def __init__(self, service: Service, *, lossless: bool, told: Callable[[str], None]) -> None:
        self._service, self._lossless, self._told = service, lossless, told
        self._boxes: dict[Outbox, asyncio.Task[None]] = {}
        self._server: asyncio.Server | None = None

    async def open(self, end: End, client: Any) -> End:
        """Begin to serve an end; where it is, with the port that was given for 0.

        Raises:
            InputError: where the address cannot be had.
        """
        if end.kind == "pipe":
            self._add(write_pipe, greet=True)
        elif end.kind == "nats":
            self._add(lambda data: _published(client, end.subject, data, self._told), greet=False)
        else:
            try:
                self._server = await asyncio.start_server(self._connected, end.host, end.port, limit=1 << 12)
            except OSError as error:
                raise InputError(f"cannot listen at {end}: {error.strerror or error}") from error
            return end._replace(port=self._server.sockets[0].getsockname()[1])
        return end

    async def put(self, update: bytes) -> None:
        """Give an update to all."""
        for box in list(self._boxes):
            box.put(update)
            if self._lossless:
                await box.space()

    def hurry(self) -> None:
        """From now on wait for no consumer."""
        self._lossless = False
        for box in self._boxes:
            box.release()

    async def close(self, grace: float) -> None:
        """End, leaving consumers some seconds to read what waits for them."""
        if self._server is not None:
            self._server.close()
        loop = asyncio.get_running_loop()
        until = loop.time() + grace
        # A pipe that nothing may be lost in is waited for; who reads it may end it.
        while not all(b.idle for b in self._boxes) and (self._lossless or loop.time() < until):
            await asyncio.sleep(0.01)
        for task in self._boxes.values():
            task.cancel()

    def _add(self, write: Callable[[bytes], Awaitable[None]], *, greet: bool) -> Outbox:
        box = Outbox()
        if greet:
            box.put(self._service.hello)
            if self._service.latest is not None:
                box.put(self._service.latest)
        self._boxes[box] = asyncio.create_task(self._deliver(box, write))
        return box

    async def _deliver(self, box: Outbox, write: Callable[[bytes], Awaitable[None]]) -> None:
        try:
            while True:
                message = await box.get()
                await write(message)
                box.done()
        except OSError as error:
            if not self._server:
                self._told(f"updates can no longer be written: {error.strerror or error}")
        finally:
            self._boxes.pop(box, None)
            box.close()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._boxes) >= _MOST:
            await turn_away(reader, writer, f"{_MOST} consumers are connected, which is the most")
            return
        writer.transport.set_write_buffer_limits(high=1 << 16)

        async def write(data: bytes) -> None:
            writer.write(data)
            await writer.drain()

        box = self._add(write, greet=True)
        delivering = self._boxes[box]
        # At the end of the service asyncio would print the cancellation as if it were a fault.
        with contextlib.suppress(OSError, asyncio.CancelledError):
            # A consumer sends nothing; the end of its side is its end.
            while await reader.read(1 << 12):
                pass
        delivering.cancel()
        writer.close()


async def _published(client: Any, subject: str, data: bytes, told: Callable[[str], None]) -> None:
    """One message a line; one that the server does not take, such as one beyond its limit, is told and left out."""
    try:
        for line in data.splitlines():
            await client.publish(subject, line)
        await client.flush(timeout=10)
    except Exception as error:
        told(f"nats: an update of {len(data)} bytes was not published: {error or type(error).__name__}")
