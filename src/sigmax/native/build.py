"""C source to a loaded library, through a cache on disk."""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path

import platformdirs

from sigmax.native.machine import NARROWEST, compiler, cores, lane_bytes, processor
from sigmax.native.refusal import say_once
from sigmax.ownership import stranger
from sigmax.signals import undone_by_signal

# Without errno and traps compilers may use vector instructions; NaN and infinity keep their meaning.
_FLAGS = (
    *("-std=gnu99", "-march=native", "-fPIC", "-shared", "-w"),
    *("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast"),
)
# A step comes without anything to propagate, to merge or to drop: looking for it takes most of the time.
_IDLE = ("dse", "tree-dse", "tree-fre", "tree-dominator-opts", "tree-pta", "tree-ccp", "tree-copy-prop")
_HERE = Path(__file__).parent / "c"
_LONGEST_SECONDS = 900
# For nobody else, whatever the mask of the user says.
_OURS = 0o700
# Some hundred kilobytes each at most.
_MOST_FILES = 4000
_one_at_a_time = threading.Lock()


class Unavailable(Exception):
    """There is no compiler, or it failed; the message says why."""


def cache_folder() -> Path | None:
    """Where compiled steps are kept: SIGMAX_CACHE, else the user's cache folder; None where that cannot be used.

    Nothing is taken from a folder in which other users may write, and nothing is left there.
    """
    folder = Path(os.environ.get("SIGMAX_CACHE") or platformdirs.user_cache_path("sigmax"))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=_OURS, exist_ok=True)
        folder = folder.resolve()
        with tempfile.TemporaryFile(dir=folder):
            pass
        reason = stranger(folder, folder)
        if not reason:
            return folder
    except OSError as error:
        reason = error.strerror or str(error)
    _tell(folder, reason)
    return None


def _tell(place: Path, reason: str) -> None:
    say_once(f"sigmax does not use {place} and compiles for this process alone: {reason}")


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="sigmax-", ignore_cleanup_errors=True)


def _folder() -> Path:
    """The cache folder, or one that lasts as long as the process."""
    with _one_at_a_time:
        return _found_folder(os.environ.get("SIGMAX_CACHE"))


@cache
def _found_folder(named: str | None) -> Path:
    return cache_folder() or Path(_temporary().name).resolve()


@cache
def _foundation() -> bytes:
    """What every compiled step depends on beside its source."""
    found = compiler()
    if found is None:
        raise Unavailable("there is no C compiler (looked for cc, gcc, clang and the package ziglang)")
    headers = "\n".join((_HERE / name).read_text() for name in ("lanes.h", "kernels.h"))
    return "\n".join([headers, *_FLAGS, *found.command, found.identity, processor()]).encode()


@cache
def load(source: str, single: bool, straight: bool, alone: bool) -> ctypes.CDLL:
    """The library made from C source that includes lanes.h: from this process, the cache or the compiler.

    `single` makes R a float; `straight` says that the source is a straight line; `alone`, that it is for one track.

    Safe beside other processes doing the same; a damaged file in the cache is made again.

    Raises:
        Unavailable: without a compiler, or where it fails.
    """
    defined = {"FLOAT": int(single), "BYTES": NARROWEST if alone else lane_bytes(), "WIDE": lane_bytes()}
    settings = [f"-DSIGMAX_{name}={value}" for name, value in defined.items()]
    path = built(source, (*_optimisation(straight), *settings))
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise Unavailable(f"what was compiled cannot be loaded: {error}") from error


def built(source: str, settings: tuple[str, ...]) -> Path:
    """The shared library made from C source by the compiler with these settings, from the cache if it is there.

    Raises:
        Unavailable: without a compiler, or where it fails.
    """
    key = hashlib.sha256(b"\n".join([_foundation(), *(s.encode() for s in settings), source.encode()])).hexdigest()
    root = _folder()
    try:
        return _kept(root, key) or _compiled(root, key, source, settings)
    except OSError as error:
        _tell(root / key[:2], error.strerror or str(error))
    try:
        private = Path(_temporary().name).resolve()
        return _kept(private, key) or _compiled(private, key, source, settings)
    except OSError as error:
        raise Unavailable(f"nowhere to keep what is compiled: {error}") from error


def _optimisation(straight: bool) -> list[str]:
    found = compiler()
    if not straight:
        return ["-O2"]
    # Fused multiplications are made by a pass that -O1 leaves out.
    fused = ["-O1", "-fexpensive-optimizations"]
    return [*fused, *(f"-fno-{name}" for name in _IDLE)] if found is not None and found.is_gcc else ["-O1"]


def load_all(sources: list[tuple[str, bool, bool, bool]]) -> list[ctypes.CDLL]:
    """Several libraries, compiled side by side."""
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(lambda one: load(*one), sources))


def remembered(name: str) -> str | None:
    """The source that was kept under a name, if it is whole."""
    root = _folder()
    path = root / name[:2] / f"{name}.c"
    try:
        if stranger(path, root):
            return None
        digest, _, source = path.read_text(encoding="utf-8").partition("\n")
        os.utime(path)
    except (OSError, UnicodeDecodeError):
        return None
    if digest != f"/* {_digest(source.encode())} */":
        return None
    return source


def remember(name: str, source: str) -> None:
    """Keep a source under a name; a cache that cannot be written is no error."""
    folder = _folder() / name[:2]
    try:
        folder.mkdir(mode=_OURS, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
            file.write(f"/* {_digest(source.encode())} */\n{source}")
        Path(file.name).replace(folder / f"{name}.c")
    except OSError:
        return


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _kept(root: Path, key: str) -> Path | None:
    """The library of this key whose content is what its name says."""
    for path in (root / key[:2]).glob(f"{key}-*.so"):
        try:
            if who := stranger(path, root):
                say_once(f"sigmax does not load {path}: {who}")
            elif path.stem.endswith(_digest(path.read_bytes())):
                os.utime(path)
                return path
        except OSError:
            continue
    return None


def _compiled(root: Path, key: str, source: str, settings: tuple[str, ...]) -> Path:
    found, folder = compiler(), root / key[:2]
    assert found is not None
    folder.mkdir(mode=_OURS, exist_ok=True)
    if who := stranger(folder, root):
        raise PermissionError(who)
    with tempfile.TemporaryDirectory(dir=folder) as work, undone_by_signal(partial(shutil.rmtree, work)):
        made = Path(work) / "step.so"
        command = [*found.command, *_FLAGS, *settings, f"-I{_HERE}", "-x", "c", "-", "-o", str(made), "-lm"]
        try:
            done = subprocess.run(
                command, input=source, capture_output=True, text=True, timeout=_LONGEST_SECONDS, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Unavailable(f"the compiler {found.command[0]} could not be used: {error}") from error
        if done.returncode or not made.exists():
            reason = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200]).strip()
            raise Unavailable(f"the compiler {' '.join(found.command)} ended with {done.returncode}: {reason}")
        final = folder / f"{key}-{_digest(made.read_bytes())}.so"
        made.chmod(_OURS)
        made.replace(final)
    _prune(root)
    return final


def _prune(cache: Path) -> None:
    """Let the files go that were not used for longest, where there are more than `_MOST_FILES`."""
    try:
        files = [path for path in cache.glob("??/*") if path.suffix in (".so", ".c")]
        if len(files) > _MOST_FILES:
            for path in sorted(files, key=lambda path: path.stat().st_mtime_ns)[: len(files) // 4]:
                path.unlink(missing_ok=True)
    except OSError:
        # Another process is at it.
        return
