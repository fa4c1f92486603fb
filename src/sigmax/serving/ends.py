"""Where lines come from and where updates go: `-`, `tcp:PORT`, `tcp:HOST:PORT`, `nats:HOST:PORT/SUBJECT`."""

import asyncio
import contextlib
import os
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import orjson

from sigmax.errors import InputError

T = TypeVar("T")
LOOPBACK = "127.0.0.1"
_FORMS = "-, tcp:PORT, tcp:HOST:PORT or nats:HOST:PORT/SUBJECT"


class End(NamedTuple):
    """One end of the service: `kind` is "pipe", "tcp" or "nats"."""

    kind: str
    host: str = ""
    port: int = 0
    subject: str = ""

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return "-" if self.kind == "pipe" else f"{self.kind}:{host}:{self.port}{self.subject and '/' + self.subject}"


def parse_end(text: str, option: str) -> End:
    """An end as it is written on the command line; a host that is not named is this machine's loopback.

    Raises:
        InputError: for anything else.
    """
    if text == "-":
        return End("pipe")
    kind, _, rest = text.partition(":")
    address, _, subject = rest.partition("/")
    host, _, port = address.rpartition(":")
    fits = kind in ("tcp", "nats") and port.isdecimal() and int(port) < 65536 and bool(subject) == (kind == "nats")
    if not fits or any(c.isspace() for c in text):
        raise InputError(f"{option} is {_FORMS}; it is {text!r}")
    return End(kind, host.strip("[]") or LOOPBACK, int(port), subject)


async def in_thread(work: Callable[[], T]) -> T:
    """What a call that may never return gives; it does not keep the process from ending."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def settle(how: Callable[..., None], value: Any) -> None:
        if not done.done():
            how(value)

    def run() -> None:
        try:
            result = work()
        except BaseException as error:
            # The loop may be gone by then.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(settle, done.set_exception, error)
        else:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(settle, done.set_result, result)

    threading.Thread(target=run, daemon=True).start()
    return await done


async def read_pipe() -> bytes:
    """Some bytes of standard input; none at its end."""
    return await in_thread(lambda: os.read(0, 1 << 16))


async def write_pipe(data: bytes) -> None:
    """All of the bytes to standard output."""

    def write() -> None:
        left = memoryview(data)
        while left:
            left = left[os.write(1, left) :]

    await in_thread(write)


async def connect(end: End, told: Callable[[str], None]) -> Any:
    """A client of the NATS server at an end, which reconnects for as long as it takes.

    Raises:
        InputError: where nats-py is not installed, or no server answers.
    """
    try:
        from nats.aio.client import Client
    except ImportError as error:
        raise InputError("NATS needs the client: pip install 'sigmax[nats]'") from error
    client = Client()

    async def failed(error: Exception) -> None:
        told(f"nats: {error or type(error).__name__}")

    try:
        # The client itself would try for ever.
        _, writer = await asyncio.wait_for(asyncio.open_connection(end.host, end.port), 5)
        writer.close()
        await client.connect(
            f"nats://{end.host}:{end.port}", error_cb=failed, max_reconnect_attempts=-1, connect_timeout=5
        )
    except Exception as error:
        raise InputError(f"no NATS server at {end.host}:{end.port}: {error or type(error).__name__}") from error
    return client


async def turn_away(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, why: str) -> None:
    """End a connection that there is no room for, and tell it why."""
    # At the end of the service asyncio would print the cancellation as if it were a fault.
    with contextlib.suppress(OSError, TimeoutError, asyncio.CancelledError):
        writer.write(orjson.dumps({"closed": f"{why}: try again when one has gone"}) + b"\n")
        writer.write_eof()
        # What came and is not read would end the connection with a reset, and the reason with it.
        async with asyncio.timeout(1.0):
            while await reader.read(1 << 12):
                pass
    writer.close()
