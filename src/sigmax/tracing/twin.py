"""A user's function with other eyes: the same code, that sees NumPy and its own arrays as `namespaces` has them.

Why not the real modules with other functions for a moment: other threads, and JAX itself, use them meanwhile. And why
not the objects' own methods alone: `np.zeros` and `math.cos` never ask an object.
"""

import functools
import sysconfig
import types
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sigmax.native.stable import is_stable
from sigmax.tracing.namespaces import own_builtins, stands_for
from sigmax.tracing.values import wrapped

_LIBRARY = sysconfig.get_paths()["stdlib"]
_FOREIGN = tuple(str(Path(str(m.__file__)).parent) for m in (jax, np))
# Larger arrays are data that nobody assigns to: they stay as they are.
_MOST = 4096


class Twins:
    """The twins of all that one function can see, each made once."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[Any, Any]] = {}
        self._builtins = own_builtins(self.of)

    def of(self, thing: Any) -> Any:
        """What stands for a thing: a twin of a function of the user's, an array that may hold traced numbers."""
        known = self._made.get(id(thing))
        if known is not None:
            return known[1]
        found = stands_for(thing)
        if found is NotImplemented:
            found = self._made_of(thing)
        self._made[id(thing)] = thing, found
        return found

    def _made_of(self, thing: Any) -> Any:
        kind = type(thing)
        if kind is types.FunctionType:
            return self._function(thing) if _is_users(thing) else thing
        if kind is types.MethodType:
            return types.MethodType(self.of(thing.__func__), self.of(thing.__self__))
        if kind is functools.partial:
            named = {k: self.of(v) for k, v in thing.keywords.items()}
            return functools.partial(self.of(thing.func), *map(self.of, thing.args), **named)
        if isinstance(thing, jax.Array) or (kind is np.ndarray and thing.dtype.kind == "f" and thing.size <= _MOST):
            return wrapped(thing)
        if kind in (list, tuple):
            return kind(map(self.of, thing))
        if kind is dict:
            return {k: self.of(v) for k, v in thing.items()}
        if isinstance(thing, tuple) and hasattr(thing, "_fields"):
            return kind(*map(self.of, thing))
        inner = getattr(thing, "py_func", None) or (thing.__wrapped__ if kind is functools._lru_cache_wrapper else None)
        if inner is not None:
            return self.of(inner)
        if isinstance(thing, types.ModuleType):
            return _Module(thing, self) if _is_users_file(getattr(thing, "__file__", None)) else thing
        return self._instance(thing) if _is_users_class(kind) else thing

    def _function(self, function: types.FunctionType) -> types.FunctionType:
        cells = tuple(types.CellType() for _ in function.__closure__ or ())
        code, names = function.__code__, _Globals(function.__globals__, self)
        made = types.FunctionType(code, names, function.__name__, None, cells or None)
        # Before what it sees is looked at: that may be itself.
        self._made[id(function)] = function, made
        for cell, own in zip(cells, function.__closure__ or (), strict=True):
            try:
                cell.cell_contents = self.of(own.cell_contents)
            except ValueError:  # it is empty
                continue
        made.__defaults__ = self.of(function.__defaults__)
        made.__kwdefaults__ = self.of(function.__kwdefaults__)
        made.__qualname__ = function.__qualname__
        return made

    def _instance(self, thing: Any) -> Any:
        """An object of the same class to every eye, whose methods are twins; its attributes follow when asked for."""

        def attribute(this: Any, name: str) -> Any:
            found = self.of(getattr(thing, name))
            if name in getattr(thing, "__dict__", {}):
                this.__dict__[name] = found
            return found

        kind = type(thing)
        methods: dict[str, Any] = {}
        for base in reversed([c for c in kind.__mro__ if _is_users_class(c)]):
            for name, own in vars(base).items():
                if name in ("__getattr__", "__getattribute__", "__new__", "__init__", "__init_subclass__"):
                    continue
                if isinstance(own, property):
                    methods[name] = property(self.of(own.fget))
                elif isinstance(own, staticmethod | classmethod):
                    methods[name] = type(own)(self.of(own.__func__))
                elif isinstance(own, types.FunctionType):
                    methods[name] = self.of(own)
        try:
            found: Any = object.__new__(type(kind.__name__, (kind,), {**methods, "__getattr__": attribute}))
        except TypeError:  # of a class that is built in, or forbids it
            return thing
        # What is an attribute of its own would be found in the class first.
        own = getattr(thing, "__dict__", {})
        found.__dict__.update({name: self.of(own[name]) for name in own if hasattr(kind, name)})
        return found


class _Globals(dict[str, Any]):
    """The globals of a function, each as it stands when first asked for."""

    def __init__(self, real: dict[str, Any], twins: Twins) -> None:
        super().__init__(__builtins__=twins._builtins, __name__=real.get("__name__"))
        self._real, self._twins = real, twins

    def __missing__(self, name: str) -> Any:
        found = self[name] = self._twins.of(self._real[name])
        return found


class _Module(types.ModuleType):
    """A module of the user's."""

    def __init__(self, real: types.ModuleType, twins: Twins) -> None:
        super().__init__(real.__name__)
        self._real, self._twins = real, twins

    def __getattr__(self, name: str) -> Any:
        return self._twins.of(getattr(self._real, name))


def _is_users(function: types.FunctionType) -> bool:
    return _is_users_file(function.__code__.co_filename) and not is_stable(function)


def _is_users_file(file: str | None) -> bool:
    if file is None or file.startswith("<frozen"):
        return False
    return not file.startswith(_FOREIGN) and (not file.startswith(_LIBRARY) or "-packages" in file)


def _is_users_class(kind: type) -> bool:
    """Whether a class has methods of the user's."""
    if kind.__module__ == "builtins" or issubclass(kind, type | BaseException | np.ndarray) or is_stable(kind):
        return False
    own = [v for v in vars(kind).values() if isinstance(v, types.FunctionType)]
    return any(map(_is_users, own)) if own else hasattr(kind, "__dict__") and kind.__module__ == "__main__"
