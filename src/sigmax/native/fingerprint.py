"""What a function is, in a few bytes: so that what was compiled from it is found again without tracing it.

Everything that a function's result can depend on goes in: its code, its constants, what it closes over, the
globals it names, and so on down. What this cannot see through (a method of an object, a module of the user's,
anything mutable it does not know) has no fingerprint, and the function is traced as if nothing were known.
"""

import builtins
import collections
import dataclasses
import dis
import functools
import hashlib
import sys
import types
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jaxlib
import numpy as np

from sigmax.native.refusal import defects_raised
from sigmax.native.stable import is_stable

# A function that names one of these may look at more than its arguments: it is always traced.
_LOOKS_ABROAD = {
    *("open", "load", "loadtxt", "genfromtxt", "fromfile", "memmap", "read", "read_csv", "read_parquet", "read_text"),
    *("read_bytes", "environ", "getenv", "random", "time", "now", "today", "input", "getcwd", "exists", "globals"),
    *("eval", "exec", "__import__", "import_module", "setattr", "locals", "vars"),
}
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
_COLLECTIONS = (tuple, list, dict, frozenset, types.MappingProxyType, collections.OrderedDict)
# Attributes that functools.wraps copies, of which nothing is computed.
# And how a ready-made part was made, which it has made so far, and which way a function is traced.
FOR_READERS = ("__annotations__", "__doc__", "__type_params__", "_made_by", "_parts_made", "_way")
# What changes how JAX traces.
_SETTINGS = ("enable_x64", "numpy_dtype_promotion", "default_dtype_bits", "default_matmul_precision")


Seen = dict[int, tuple[int, Any]]  # by identity: its number, and the thing itself


class _SeenObjects(Seen):
    """But for plain values: equal ones are the same, whether or not they are one, as in a pickled copy."""

    def __setitem__(self, key: int, value: tuple[int, Any]) -> None:
        if not isinstance(value[1], tuple | list | dict | frozenset | str | np.ndarray | np.generic | jax.Array):
            super().__setitem__(key, value)


class _Opaque(Exception):
    """Something that has no fingerprint."""


@cache
def installation() -> bytes:
    """What the library itself and those it stands on are: versions, and the files of this package."""
    package = Path(__file__).parents[1]
    files = sorted(path for path in package.rglob("*") if path.suffix in (".py", ".c", ".h"))
    about = [(str(path.relative_to(package)), *path.stat()[6:9:2]) for path in files]
    return repr((sys.version, jax.__version__, jaxlib.version.__version__, np.__version__, about)).encode()


def fingerprint(*things: Any, installed: bytes | None = None) -> str | None:
    """A digest of functions and values; None where something in them cannot be seen through.

    Args:
        things: what it is of.
        installed: what it stands on, if not this very installation; for a digest that a pickled copy has too.
    """
    digest = hashlib.sha256(installation() if installed is None else installed)
    digest.update(repr([getattr(jax.config, f"jax_{name}", None) for name in _SETTINGS]).encode())
    try:
        for part in _parts(things, {} if installed is None else _SeenObjects()):
            digest.update(part)
            digest.update(b"\0")
    except _Opaque:
        return None
    except Exception:
        # What cannot even be looked at is not known.
        if defects_raised():
            raise
        return None
    return digest.hexdigest()


def _parts(thing: Any, seen: Seen) -> Iterator[bytes]:
    if type(thing) in _PLAIN:
        yield f"{type(thing).__qualname__} {thing!r}".encode()
        return
    if id(thing) in seen:
        yield f"again {seen[id(thing)][0]}".encode()
        return
    # Kept alive: something new at the address of what is gone would pass for it, and its contents for known.
    seen[id(thing)] = len(seen), thing
    if isinstance(thing, jax.core.Tracer):
        raise _Opaque
    if isinstance(thing, np.ndarray | np.generic | jax.Array):
        yield _of_array(thing)
    elif isinstance(thing, types.FunctionType):
        yield from _of_function(thing, seen)
    elif isinstance(thing, types.CodeType):
        yield from _of_code(thing, seen)
    elif isinstance(thing, types.ModuleType | type | types.BuiltinFunctionType | np.ufunc | np.dtype):
        yield _of_name(thing)
        if isinstance(thing, type):
            # Those with two underscores are made by decorators.
            methods = {k: v for k, v in vars(thing).items() if k == "__call__" or not k.startswith("__")}
            yield from _replaced(methods, seen)
    elif isinstance(thing, types.CellType):
        yield from _parts(_content(thing), seen)
    elif type(thing) in _COLLECTIONS or (isinstance(thing, tuple) and is_stable(type(thing))):
        yield from _of_collection(thing, seen)
    elif is_stable(type(thing)):
        yield from _of_object(thing, seen)
    else:
        raise _Opaque


def _of_array(thing: Any) -> bytes:
    if not is_stable(type(thing)) or jax.dtypes.issubdtype(thing.dtype, jax.dtypes.extended):  # type: ignore[attr-defined]
        raise _Opaque
    array = np.asarray(thing)
    if array.dtype.hasobject or isinstance(thing, np.ma.MaskedArray):
        raise _Opaque
    kind = "jax" if isinstance(thing, jax.Array) else type(thing).__qualname__
    about = array.dtype, array.shape, array.strides, getattr(thing, "weak_type", None)
    return f"array {kind} {about}".encode() + array.tobytes()


def _content(cell: types.CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        raise _Opaque from None


def _of_name(thing: Any) -> bytes:
    if isinstance(thing, np.dtype):
        return f"dtype {thing}".encode()
    if not is_stable(thing):
        raise _Opaque
    module = thing.__name__ if isinstance(thing, types.ModuleType) else getattr(thing, "__module__", "numpy")
    return f"name {module} {getattr(thing, '__qualname__', thing.__name__)}".encode()


def _of_collection(thing: Any, seen: Seen) -> Iterator[bytes]:
    yield f"{type(thing).__qualname__} {len(thing)}".encode()
    if isinstance(thing, frozenset):
        yield from sorted(b"\1".join(_parts(item, {})) for item in thing)
        return
    for item in thing.items() if isinstance(thing, dict | types.MappingProxyType) else thing:
        if type(item) is tuple:
            yield b"tuple"
            for inner in item:
                yield from _parts(inner, seen)
        else:
            yield from _parts(item, seen)


def _of_object(thing: Any, seen: Seen) -> Iterator[bytes]:
    """Of a class of a library: its class, its value if it is a number or a text, and its attributes."""
    yield from _parts(type(thing), seen)
    wrapped = getattr(thing, "__wrapped__", None)
    if wrapped is not None and type(thing).__module__.startswith("jaxlib"):
        # A compiled function.
        yield b"compiled"
        yield from _parts(wrapped, seen)
        return
    for plain in (str, float, int):
        if isinstance(thing, plain):
            yield plain.__repr__(thing).encode()
    if dataclasses.is_dataclass(thing) and not hasattr(thing, "__dict__"):
        yield from _parts({f.name: getattr(thing, f.name) for f in dataclasses.fields(thing)}, seen)
    elif hasattr(thing, "__dict__"):
        yield from _parts({k: v for k, v in vars(thing).items() if k not in FOR_READERS}, seen)
        if isinstance(thing, functools.partial):
            yield from _parts((thing.func, thing.args, thing.keywords), seen)
    elif not isinstance(thing, str | float | int):
        raise _Opaque


def _of_function(function: types.FunctionType, seen: Seen) -> Iterator[bytes]:
    yield f"function {function.__module__} {function.__qualname__}".encode()
    yield from _parts((function.__defaults__, function.__kwdefaults__, function.__closure__), seen)
    # The code too, where the module says the rest: any number of functions are called <lambda>.
    yield from _parts(function.__code__, seen)
    named = _names(function.__code__)
    found = {name: function.__globals__[name] for name in sorted(named) if name in function.__globals__}
    if is_stable(function):
        yield from _replaced(found, seen)
        return
    if named & _LOOKS_ABROAD or not all(is_stable(sys.modules.get(name)) for name in _imports(function.__code__)):
        raise _Opaque
    yield from _parts({k: v for k, v in vars(function).items() if k not in ("__wrapped__", *FOR_READERS)}, seen)
    for name in sorted(named):
        yield name.encode()
        if name in found:
            yield from _parts(found[name], seen)
            if isinstance(found[name], types.ModuleType):
                yield from _of_attributes(found[name], named, seen)
        elif hasattr(builtins, name):
            yield from _replaced({name: getattr(builtins, name)}, seen)
    if hasattr(function, "__wrapped__"):
        yield from _parts(function.__wrapped__, seen)


def _of_attributes(module: types.ModuleType, named: set[str], seen: Seen) -> Iterator[bytes]:
    """What a function may read of a library's module: numbers, and what is there in place of the library's own."""
    for name in sorted(named & vars(module).keys()):
        value = vars(module)[name]
        if isinstance(value, types.ModuleType):
            if is_stable(value) and id(value) not in seen:
                seen[id(value)] = len(seen), value
                yield from _of_attributes(value, named, seen)
        elif type(value) in _PLAIN:
            yield from _parts(value, seen)
        else:
            yield from _replaced({name: value}, seen)


def _replaced(named: Any, seen: Seen) -> Iterator[bytes]:
    """Of things of a library those that are not its own: somebody put them there."""
    for name, value in named.items():
        inner = getattr(value, "__wrapped__", value)
        for one in (value, inner):
            if isinstance(one, types.FunctionType | types.MethodType | functools.partial) and not is_stable(one):
                yield f"replaced {name}".encode()
                yield from _parts(one, seen)


def _of_code(code: types.CodeType, seen: Seen) -> Iterator[bytes]:
    yield code.co_code
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, counts)).encode()
    for constant in code.co_consts:
        yield from _parts(constant, seen)


def _imports(code: types.CodeType) -> set[str]:
    """Modules that the code imports when it runs: what they hold then is not seen before."""
    found = {str(i.argval) for i in dis.get_instructions(code) if i.opname == "IMPORT_NAME"}
    return found.union(*(_imports(c) for c in code.co_consts if isinstance(c, types.CodeType)))


def _names(code: types.CodeType) -> set[str]:
    found = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            found |= _names(constant)
    return found
