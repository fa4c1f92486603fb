"""What a signal that ends the process does: what was begun is undone, one line is written, the status is the shell's.

An exception raised by a signal is lost in the middle of an import, in a callback or while a compiler is at work.
Here a thread waits for signals, so that they are heard at any moment at which Python runs or a library lets it run.
"""

# What is loaded here is loaded before a signal can be heard: the least.
import _thread
import atexit
import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType

_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "the terminal was closed"}
_undo: list[Callable[[], object]] = []
_consequence = ""
_first = _thread.allocate_lock()


@contextlib.contextmanager
def undone_by_signal(action: Callable[[], object]) -> Iterator[None]:
    """Within the block a signal that ends the process calls `action` first."""
    _undo.append(action)
    try:
        yield
    finally:
        _undo.remove(action)


def say_on_signal(consequence: str) -> None:
    """What a user should know when a signal ends the process, such as "nothing was written"."""
    global _consequence
    _consequence = consequence


@contextlib.contextmanager
def ends_by_signal() -> Iterator[None]:
    """Within the block SIGINT, SIGTERM and SIGHUP end the process with one line and the status 128 + number.

    A signal that was ignored before stays so. Outside of the main thread nothing changes.
    """
    numbers = [getattr(signal, name) for name in _WORDS if hasattr(signal, name)]
    heard = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    try:
        before = {number: signal.signal(number, _pause) for number in heard}
    except ValueError:
        # Another thread than the main one: signals do what they did.
        yield
        return
    ours, wakes = os.pipe()
    os.set_blocking(wakes, False)
    try:
        before_fd = signal.set_wakeup_fd(wakes, warn_on_full_buffer=False)
    except ValueError:
        # A system that takes no pipe hears a signal when Python comes to it.
        before_fd = -1
    _thread.start_new_thread(_watch, (ours, heard))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(before_fd)
        # The thread that waits sees the end of the pipe.
        os.close(wakes)
        # While the interpreter takes itself down all is done, and Python would write of where it was.
        atexit.register(_ignore, heard)
        say_on_signal("")


def _ignore(heard: list[int]) -> None:
    for number in heard:
        signal.signal(number, signal.SIG_IGN)


def _watch(ours: int, heard: list[int]) -> None:
    while told := os.read(ours, 64):
        for number in told:
            if number in heard:
                _end(number)
    os.close(ours)


def _pause(number: int, frame: FrameType | None) -> None:
    """Keep the main thread from going on; an event loop may have taken the place where `_watch` waits."""
    _thread.start_new_thread(_end, (number,))
    while True:
        time.sleep(1)


def _end(number: int) -> None:
    if not _first.acquire(blocking=False):
        return
    for action in reversed(_undo):
        with contextlib.suppress(Exception):
            action()
    _end_children()
    consequence = f"; {_consequence}" if _consequence else ""
    line = f"sigmax: {_WORDS[signal.Signals(number).name]}{consequence}\n"
    with contextlib.suppress(OSError):
        if os.isatty(2):
            # A progress bar has hidden the cursor and stands in this line.
            line = f"\r\x1b[2K\x1b[?25h{line}"
        os.write(2, line.encode())
    os._exit(128 + number)


def _end_children() -> None:
    """Compilers and workers that were started; where the system does not tell of them they end by themselves."""
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError):
        for task in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError), open(f"/proc/self/task/{task}/children") as listed:
                for child in listed.read().split():
                    os.kill(int(child), signal.SIGTERM)
