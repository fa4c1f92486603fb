"""The service with its ends: one loop takes lines from all senders in turn and hands updates to all consumers."""

import asyncio
import contextlib
import signal
from collections.abc import Callable
from typing import NamedTuple

from sigmax.errors import InputError
from sigmax.serving.consumers import Consumers
from sigmax.serving.ends import End, connect
from sigmax.serving.lines import Line, quoted
from sigmax.serving.senders import Sender, from_nats, from_pipe, from_tcp
from sigmax.serving.service import FLUSH, Service

# Lines that may wait; senders wait beyond it.
_WAITING = 64
# Seconds that consumers are given to read what is left at the end.
_GRACE = 3.0
_TOLD = 20


class Limits(NamedTuple):
    """Bounds of a service.

    Attributes:
        line: bytes of a line.
        quiet: seconds without a line after which scans that are open are taken as complete.
    """

    line: int = 1 << 20
    quiet: float = 1.0


async def serve(service: Service, source: End, sink: End, limits: Limits, told: Callable[[str], None]) -> None:
    """Run until standard input ends or SIGTERM or SIGINT comes; then all that was taken is tracked and kept.

    Args:
        service: what becomes of lines.
        source: where they come from.
        sink: where updates go. From a pipe to a pipe nothing is dropped, and the reader sets the pace; any other
            consumer that does not read misses updates, and is told how many.
        limits: bounds.
        told: is given each message for people.

    Raises:
        InputError: where an address cannot be had, before anything is taken.
    """
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    consumers = Consumers(service, lossless=source.kind == sink.kind == "pipe", told=told)

    def halt() -> None:
        stop.set()
        # A reader that does not read must not keep the service from ending.
        consumers.hurry()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, halt)
    queue: asyncio.Queue[tuple[Sender, Line]] = asyncio.Queue(_WAITING)
    async with contextlib.AsyncExitStack() as stack:
        clients = {}
        for end in {e[1:3]: e for e in (source, sink) if e.kind == "nats"}.values():
            clients[end[1:3]] = await connect(end, told)
            stack.push_async_callback(clients[end[1:3]].close)
        stack.push_async_callback(consumers.close, _GRACE)
        at = await consumers.open(sink, clients.get(sink[1:3]))
        work = asyncio.create_task(_work(service, queue, consumers, limits.quiet, told))
        if source.kind == "pipe":
            taking = asyncio.create_task(from_pipe(queue, limits.line))
        elif source.kind == "tcp":
            server = await from_tcp(queue, limits.line, source, service)
            stack.callback(server.close)
            source = source._replace(port=server.sockets[0].getsockname()[1])
            taking = asyncio.create_task(asyncio.sleep(float("inf")))
        else:
            taking = asyncio.create_task(from_nats(queue, limits.line, source, clients[source[1:3]]))
        told(f"plots from {source}, updates to {at}")
        asked = asyncio.create_task(stop.wait())
        try:
            await asyncio.wait([taking, asked, work], return_when=asyncio.FIRST_COMPLETED)
        finally:
            taking.cancel()
            asked.cancel()
        ending = asyncio.create_task(_end(queue, taking if source.kind == "pipe" and not stop.is_set() else None))
        # Where the work has failed nobody makes room in the queue.
        await asyncio.wait([ending, work], return_when=asyncio.FIRST_COMPLETED)
        if work.done():
            ending.cancel()
        else:
            await ending
        await work
        service.keep()


_END = Line(b"", True)


async def _end(queue: asyncio.Queue[tuple[Sender, Line]], taken: asyncio.Task[None] | None) -> None:
    """The last lines: after all that were taken the open scans are complete."""
    if taken is not None:
        await taken
        await queue.put((Sender(), FLUSH))
    await queue.put((Sender(), _END))


async def _work(
    service: Service,
    queue: asyncio.Queue[tuple[Sender, Line]],
    consumers: Consumers,
    quiet: float,
    told: Callable[[str], None],
) -> None:
    """Lines to updates, as many lines at a time as wait: they share one synchronisation of the journal."""
    refused = failed = 0
    while True:
        try:
            batch = [await asyncio.wait_for(queue.get(), quiet if service.open else None)]
        except TimeoutError:
            batch = [(Sender(), FLUSH)]
        while not queue.empty() and batch[-1][1] is not _END:
            batch.append(queue.get_nowait())
        last = batch[-1][1] is _END
        lines = [line for _, line in batch if line is not _END]
        # A thread of its own leaves the loop free for those who read and write meanwhile.
        verdicts = await asyncio.to_thread(service.accept, lines)
        for (sender, _), verdict in zip(batch, verdicts, strict=False):
            sender.tell(verdict)
            if not verdict.taken:
                refused += 1
                _tell(told, refused, "line refused", f"{verdict.why}: {quoted(verdict.line.text)}")
        updates = service.work()
        while (update := await asyncio.to_thread(next, updates, None)) is not None:
            await consumers.put(update)
        while service.failures:
            failed += 1
            _tell(told, failed, "scan that could not be tracked", service.failures.popleft())
        if last:
            return


def _tell(told: Callable[[str], None], number: int, what: str, why: str) -> None:
    """Tell of the first of many, then of each thousandth."""
    if number <= _TOLD or number % 1000 == 0:
        told(f"{what} ({number} so far): {why}")


def checked_limits(line: int, quiet: float) -> Limits:
    """Limits that make sense.

    Raises:
        InputError: for others.
    """
    if not 100 <= line <= 1 << 30:
        raise InputError(f"--max-line is a number of bytes between 100 and {1 << 30}; it is {line}")
    if not quiet > 0:
        raise InputError(f"--quiet is in seconds, above 0; it is {quiet}")
    return Limits(line, quiet)
