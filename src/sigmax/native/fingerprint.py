"""What a function is, in a few bytes: so that what was compiled from it is found again without tracing it.

Everything that a function's result can depend on goes in: its code, its constants, what it closes over, the
globals it names, and so on down. What this cannot see through (a method of an object, a module of the user's,
anything mutable it does not know) has no fingerprint, and the function is traced as if nothing were known.
"""

import builtins
import dataclasses
import functools
import hashlib
import sys
import types
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

# Packages that change with their version or with their files alone.
_STABLE = ("sigmax", "jax", "jaxlib", "numpy", "math", "functools", "operator", "itertools", "collections", "typing")
# A function that names one of these may look at more than its arguments: it is always traced.
_LOOKS_ABROAD = {
    *("open", "load", "loadtxt", "genfromtxt", "fromfile", "memmap", "read", "read_csv", "read_parquet", "read_text"),
    *("read_bytes", "environ", "getenv", "random", "time", "now", "today", "input", "getcwd", "exists", "globals"),
    *("eval", "exec", "__import__", "import_module"),
}
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


Seen = dict[int, tuple[int, Any]]  # by identity: its number, and the thing itself


class _Opaque(Exception):
    """Something that has no fingerprint."""


@cache
def installation() -> bytes:
    """What the library itself and those it stands on are: versions, and the files of this package."""
    package = Path(__file__).parents[1]
    files = sorted(path for path in package.rglob("*") if path.suffix in (".py", ".c", ".h"))
    about = [(str(path.relative_to(package)), *path.stat()[6:9:2]) for path in files]
    return repr((sys.version, jax.__version__, np.__version__, about)).encode()


def fingerprint(*things: Any, installed: bytes | None = None) -> str | None:
    """A digest of functions and values; None where something in them cannot be seen through.

    Args:
        things: what it is of.
        installed: what it stands on, if not this very installation.
    """
    digest = hashlib.sha256(installation() if installed is None else installed)
    try:
        for part in _parts(things, {}):
            digest.update(part)
            digest.update(b"\0")
    except _Opaque:
        return None
    return digest.hexdigest()


def _parts(thing: Any, seen: Seen) -> Iterator[bytes]:
    if isinstance(thing, _PLAIN):
        yield f"{type(thing).__qualname__} {thing!r}".encode()
        return
    if id(thing) in seen:
        yield f"again {seen[id(thing)][0]}".encode()
        return
    # Kept alive: something new at the address of what is gone would pass for it, and its contents for known.
    seen[id(thing)] = len(seen), thing
    if isinstance(thing, np.ndarray | np.generic | jax.Array):
        array = np.asarray(thing)
        if array.dtype.hasobject:
            raise _Opaque
        yield f"array {array.dtype} {array.shape}".encode() + array.tobytes()
    elif isinstance(thing, types.FunctionType):
        yield from _of_function(thing, seen)
    elif isinstance(thing, types.CodeType):
        yield from _of_code(thing, seen)
    elif isinstance(thing, types.ModuleType | type | types.BuiltinFunctionType | np.ufunc | np.dtype):
        yield _of_name(thing)
    elif isinstance(thing, functools.partial):
        yield b"partial"
        yield from _parts((thing.func, thing.args, thing.keywords), seen)
    elif isinstance(thing, types.CellType):
        yield from _parts(thing.cell_contents, seen)
    elif isinstance(thing, tuple | list | dict | frozenset | types.MappingProxyType):
        yield from _of_collection(thing, seen)
    elif hasattr(thing, "__wrapped__") and type(thing).__module__.startswith("jax"):
        yield b"compiled"
        yield from _parts(thing.__wrapped__, seen)
    elif _stable(type(thing).__module__):
        yield _of_name(type(thing))
        if dataclasses.is_dataclass(thing):
            yield from _parts({f.name: getattr(thing, f.name) for f in dataclasses.fields(thing)}, seen)
        elif hasattr(thing, "__dict__"):
            yield from _parts(vars(thing), seen)
        else:
            raise _Opaque
    else:
        raise _Opaque


def _stable(module: str | None) -> bool:
    return module is not None and module.partition(".")[0] in _STABLE


def _of_name(thing: Any) -> bytes:
    module = thing.__name__ if isinstance(thing, types.ModuleType) else getattr(thing, "__module__", "numpy")
    if isinstance(thing, np.dtype):
        return f"dtype {thing}".encode()
    if module != "builtins" and not _stable(module or "numpy"):
        raise _Opaque
    return f"name {module} {getattr(thing, '__qualname__', thing.__name__)}".encode()


def _of_collection(thing: Any, seen: Seen) -> Iterator[bytes]:
    named = isinstance(thing, tuple) and type(thing) is not tuple
    if named and not _stable(type(thing).__module__):
        raise _Opaque
    yield f"{type(thing).__qualname__} {len(thing)}".encode()
    if isinstance(thing, frozenset):
        yield from sorted(b"\1".join(_parts(item, {})) for item in thing)
        return
    for item in thing.items() if isinstance(thing, dict | types.MappingProxyType) else thing:
        if isinstance(item, tuple):
            yield b"tuple"
            for inner in item:
                yield from _parts(inner, seen)
        else:
            yield from _parts(item, seen)


def _of_function(function: types.FunctionType, seen: Seen) -> Iterator[bytes]:
    yield f"function {function.__module__} {function.__qualname__}".encode()
    yield from _parts((function.__defaults__, function.__kwdefaults__, function.__closure__), seen)
    # The code too, where the module says the rest: any number of functions are called <lambda>.
    yield from _parts(function.__code__, seen)
    if _stable(function.__module__):
        return
    named = _names(function.__code__)
    if named & _LOOKS_ABROAD:
        raise _Opaque
    for name in sorted(named):
        if name in function.__globals__:
            yield name.encode()
            yield from _parts(function.__globals__[name], seen)
        elif not hasattr(builtins, name):
            # The attribute of something; what it is an attribute of stands among the names too.
            yield name.encode()
    if hasattr(function, "__wrapped__"):
        yield from _parts(function.__wrapped__, seen)


def _of_code(code: types.CodeType, seen: Seen) -> Iterator[bytes]:
    yield code.co_code
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_argcount, code.co_flags)).encode()
    for constant in code.co_consts:
        yield from _parts(constant, seen)


def _names(code: types.CodeType) -> set[str]:
    found = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            found |= _names(constant)
    return found
