"""Whether what a function reads is still what it was when it was compiled, found out in less than a microsecond."""

import types
from collections.abc import Callable, Mapping
from operator import is_
from typing import Any

import numpy as np

from sigmax.functions.environment import read
from sigmax.native.stable import is_stable

# Values that never change.
_PLAIN = (bool, int, float, complex, str, bytes, type(None), types.BuiltinFunctionType, np.ufunc, np.dtype)
_MISSING = object()


def watched(*functions: Any) -> Callable[[], bool]:
    """A check that nothing has changed which these functions can see.

    Globals, closures, defaults and attributes are compared by identity, arrays by their bytes. Where they see more than
    that, such as lists, all of it is read again, which takes some microseconds.
    """
    found = _Seen()
    if all(map(found.follow, functions)):
        return found.check()
    before = [(read(f).values, f) for f in functions]
    kept = [read(f).kept for f in functions]  # so that no address is given to something else
    return lambda: bool(kept) and all(read(f).values == values for values, f in before)


class _Seen:
    """What is read by name, and arrays."""

    def __init__(self) -> None:
        self.names: list[tuple[Mapping[str, Any], str]] = []
        self.sizes: list[Mapping[str, Any]] = []
        self.cells: list[types.CellType] = []
        self.arrays: list[np.ndarray] = []
        self.done: list[Any] = []

    def follow(self, thing: Any) -> bool:
        """Take up what a thing reads; False where it cannot be watched."""
        if isinstance(thing, _PLAIN) or any(thing is d for d in self.done):
            return True
        self.done.append(thing)
        if isinstance(thing, types.MethodType):
            return self.follow(thing.__func__) and self.follow(thing.__self__)
        if isinstance(thing, np.ndarray):
            self.arrays.append(thing)
            return not thing.dtype.hasobject
        if isinstance(thing, types.FunctionType):
            return is_stable(thing) or self._function(thing)
        if _is_object(thing):
            return self._object(thing)
        # Modules and classes of the user's have more in them than is followed here.
        return isinstance(thing, np.generic) or (isinstance(thing, types.ModuleType | type) and is_stable(thing))

    def _function(self, function: types.FunctionType) -> bool:
        held: list[Any] = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
        for cell in function.__closure__ or ():
            self.cells.append(cell)
            held.append(cell.cell_contents)
        for name in _names(function.__code__):
            if name in function.__globals__:
                self.names.append((function.__globals__, name))
                held.append(function.__globals__[name])
        return all(map(self.follow, held))

    def _object(self, thing: Any) -> bool:
        held = [vars(thing), *(vars(c) for c in type(thing).__mro__ if not is_stable(c))]
        self.sizes += held
        values: list[Any] = []
        for names in held:
            for name, value in names.items():
                if name.startswith("__") and name != "__call__":
                    continue
                self.names.append((names, name))
                values += [value.fget] if isinstance(value, property) else [getattr(value, "__func__", value)]
        return all(map(self.follow, values))

    def check(self) -> Callable[[], bool]:
        """The check, of what was taken up."""
        names, cells, arrays, sizes = self.names, self.cells, self.arrays, self.sizes
        before = [d[name] for d, name in names] + [c.cell_contents for c in cells]
        contents, lengths = [a.tobytes() for a in arrays], list(map(len, sizes))
        if not before and not arrays:
            return lambda: True

        def unchanged() -> bool:
            now = [d.get(name, _MISSING) for d, name in names]
            if cells:
                now += [c.cell_contents for c in cells]
            if not all(map(is_, now, before)) or (sizes and list(map(len, sizes)) != lengths):
                return False
            return not arrays or [a.tobytes() for a in arrays] == contents

        return unchanged


def _is_object(thing: Any) -> bool:
    """Whether it has attributes of its own alone: none in slots, and none that are found by a function."""
    kind = type(thing)
    plain = "__getattribute__" not in vars(kind) and not hasattr(kind, "__getattr__")
    slots = any("__slots__" in vars(c) for c in kind.__mro__)
    return plain and not slots and hasattr(thing, "__dict__") and kind.__bases__ == (object,) and not is_stable(kind)


def _names(code: types.CodeType) -> set[str]:
    inner = [_names(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*inner)
