"""What a function reads besides its arguments, as it is now: told from what it was by plain comparison."""

import dis
import functools
import sys
import sysconfig
import types
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from sigmax.functions import places
from sigmax.functions.places import Place, seen_now
from sigmax.native.fingerprint import FOR_READERS

_PLACES = sysconfig.get_paths()
_LIBRARIES = (str(Path(__file__).parents[1]), *(_PLACES[k] for k in ("stdlib", "platstdlib", "purelib", "platlib")))
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
_BY_IDENTITY = (types.BuiltinFunctionType, np.ufunc, np.dtype, jax.Array, types.CodeType)
# What JAX remembers by the function that is handed to it.
_LOOPS = {"fori_loop", "while_loop", "scan", "map", "associative_scan", "cond", "switch", "checkpoint", "remat"}


class Environment(NamedTuple):
    """What was read.

    Attributes:
        values: plain values and identities, in the order in which they were come by.
        kept: all that an identity stands for, so that none is given to something else.
        within: functions by identity that JAX itself remembers, and what each of them reads.
        places: where all of it was read: as long as they hold the same things, so does all that they lead to.
    """

    values: list[Any]
    kept: list[Any]
    within: dict[int, tuple[Any, list[Any]]]
    places: list[Place]

    def look(self, how: Callable[[Any], Any], at: Any) -> Any:
        """What is at a place now, which is remembered."""
        self.places.append(seen_now(how, at))
        return self.places[-1].seen


def read(thing: Any) -> Environment:
    """All that a function or an object can see of what may change: globals, closures, attributes, contents.

    What belongs to a library, and what cannot be looked into, is known by its identity.
    """
    found = Environment([], [], {}, [])
    _walk(thing, found, set())
    return found


class _Code(NamedTuple):
    names: frozenset[str]
    named: Callable[[Any], Any]
    imports: tuple[str, ...]
    imported: Callable[[Any], Any]
    library: bool
    loops: bool


@cache
def _about(code: types.CodeType) -> _Code:
    names, imports = set(code.co_names), [i.argval for i in dis.get_instructions(code) if i.opname == "IMPORT_NAME"]
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner = _about(constant)
            names |= inner.names
            imports += inner.imports
    named, imported = (partial(places.named, tuple(those)) for those in (sorted(names), imports))
    library = code.co_filename.startswith(_LIBRARIES)
    return _Code(frozenset(names), named, tuple(imports), imported, library, bool(names & _LOOPS))


def _is_library(name: str) -> bool:
    """Whether a module of this name is not the user's."""
    module = sys.modules.get(name)
    if module is None or name == "__main__" or getattr(module, "__spec__", None) is None:
        return False
    file = getattr(module, "__file__", None)
    return file is None or file.startswith(_LIBRARIES)


def _walk(thing: Any, found: Environment, seen: set[int]) -> None:
    kind = type(thing)
    if kind in _PLAIN:
        # 0.0 == -0.0 and NaN is not itself, 1 == 1.0 == True.
        found.values.append((kind, repr(thing) if kind in (float, complex) else thing))
        return
    if kind is types.MethodType:
        # Another object whenever it is asked for.
        _walk(thing.__func__, found, seen)
        _walk(thing.__self__, found, seen)
        return
    one = id(thing)
    found.values.append(one)
    if one in seen:
        return
    seen.add(one)
    found.kept.append(thing)
    if isinstance(thing, np.ndarray):
        _array(thing, found, seen)
    elif isinstance(thing, _BY_IDENTITY):
        return
    elif kind is types.FunctionType:
        _function(thing, found, seen)
    elif kind is types.CellType:
        held = found.look(places.of_cell, thing)
        if held:
            _walk(held[0], found, seen)
        else:
            found.values.append("empty")
    elif isinstance(thing, types.ModuleType):
        return
    elif isinstance(thing, type):
        _class(thing, found, seen)
    else:
        _object(thing, found, seen)


def _array(thing: np.ndarray, found: Environment, seen: set[int]) -> None:
    if thing.dtype.hasobject:
        found.values.append((thing.dtype.str, thing.shape))
        for item in found.look(places.items, thing):
            _walk(item, found, seen)
    else:
        found.values.append(found.look(places.content, thing))


def _function(function: types.FunctionType, found: Environment, seen: set[int]) -> None:
    found.look(places.of_function, function)
    code = function.__code__
    about = _about(code)
    found.values.append(id(code))
    found.kept.append(code)
    for part in (function.__defaults__, function.__kwdefaults__, function.__closure__):
        if part:
            for item in part.values() if isinstance(part, dict) else part:
                _walk(item, found, seen)
    if function.__dict__:
        _attributes(function.__dict__, found, seen)
    if about.library:
        return
    if about.loops:
        _within(function, found)
    names = function.__globals__
    found.look(about.named, names)
    for name in about.names:
        if name in names:
            value = names[name]
            _walk(value, found, seen)
            if isinstance(value, types.ModuleType):
                _module(value, about, found, seen)
    if about.imports:
        found.look(about.imported, sys.modules)
    for name in about.imports:
        module = sys.modules.get(name)
        if module is None:
            found.values.append("not there yet")
        elif not _is_library(name):
            _walk(module, found, seen)
            _module(module, about, found, seen)


def _module(module: types.ModuleType, about: _Code, found: Environment, seen: set[int]) -> None:
    """What is read of a module: what is named; of a library's, whether it is the same thing."""
    there, library = vars(module), _is_library(module.__name__)
    found.look(about.named, there)
    for name in about.names:
        if name not in there:
            continue
        value = there[name]
        if library and type(value) not in _PLAIN:
            found.values.append(id(value))
            found.kept.append(value)
            continue
        fresh = id(value) not in seen
        _walk(value, found, seen)
        if isinstance(value, types.ModuleType) and fresh:
            _module(value, about, found, seen)


def _class(thing: type, found: Environment, seen: set[int]) -> None:
    for base in found.look(places.bases, thing):
        if _is_library(base.__module__):
            continue
        found.look(places.of_class, base)
        for name, value in vars(base).items():
            if not name.startswith("__") or name in ("__call__", "__getattr__", "__getitem__"):
                _walk(value, found, seen)


def _object(thing: Any, found: Environment, seen: set[int]) -> None:
    kind = type(thing)
    found.look(places.of_object, thing)
    if isinstance(thing, dict | types.MappingProxyType):
        found.look(places.of_dict, thing)
        for key, value in thing.items():
            _walk(key, found, seen)
            _walk(value, found, seen)
    elif isinstance(thing, list | tuple | set | frozenset):
        found.values.append(len(thing))
        for item in found.look(tuple, thing):
            _walk(item, found, seen)
    elif isinstance(thing, bytearray | np.generic | float | int | str):
        found.values.append(found.look(repr, thing))
    elif isinstance(thing, functools.partial):
        for part in found.look(places.of_partial, thing):
            _walk(part, found, seen)
    elif isinstance(thing, property):
        _walk(thing.fget, found, seen)
    elif isinstance(thing, staticmethod | classmethod):
        _walk(thing.__func__, found, seen)
    elif kind.__module__.startswith("jaxlib") and hasattr(thing, "__wrapped__"):
        _within(thing, found)
        (inner,) = found.look(places.wrapped, thing)
        _walk(inner, found, seen)
        return
    _walk(kind, found, seen)
    attributes = getattr(thing, "__dict__", None)
    if type(attributes) is dict:
        _attributes(attributes, found, seen)
    for base in kind.__mro__:
        slots = vars(base).get("__slots__", ())
        names = (slots,) if isinstance(slots, str) else slots
        members = [m for name in names if isinstance(m := vars(base).get(name), types.MemberDescriptorType)]
        if members:
            for value in found.look(partial(places.of_slots, members), thing):
                _walk(value, found, seen)


def _attributes(there: dict[str, Any], found: Environment, seen: set[int]) -> None:
    for name, value in there.items():
        if name not in FOR_READERS:
            found.values.append(name)
            _walk(value, found, seen)


def _within(thing: Any, found: Environment) -> None:
    """What a function reads that JAX remembers."""
    if id(thing) in found.within:
        return
    found.within[id(thing)] = thing, []
    own = Environment([], found.kept, found.within, found.places)
    inside: set[int] = set()
    if isinstance(thing, types.FunctionType):
        # By itself, not by way of its loops.
        _walk(thing, own, inside)
    else:
        _walk(thing.__wrapped__, own, inside)
    found.within[id(thing)] = thing, own.values
