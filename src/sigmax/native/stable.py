"""What belongs to a library, and so changes with its version alone: by where it is, not by what it says of itself."""

import functools
import sys
import sysconfig
import types
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jaxlib
import numpy as np

_PACKAGES = {
    "sigmax": Path(__file__).parents[1],
    **{m.__name__: Path(str(m.__file__)).parent for m in (jax, jaxlib, np)},
}
# Of the standard library, what has no state.
_STANDARD = ("math", "functools", "operator", "itertools", "collections", "typing", "types", "enum", "abc")
_LIBRARY = tuple({sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib")})


def is_stable(thing: Any) -> bool:
    """Whether a module, a function or a class is one of a library's own."""
    if isinstance(thing, types.ModuleType):
        return _is_module(thing.__name__) and sys.modules.get(thing.__name__) is thing
    if isinstance(thing, types.FunctionType):
        # functools.wraps gives a function the name of another, not its code.
        return _is_file(thing.__code__.co_filename)
    if isinstance(thing, types.MethodType):
        return is_stable(thing.__func__)
    if isinstance(thing, functools.partial):
        return is_stable(thing.func)
    module = getattr(thing, "__module__", None) or ("numpy" if isinstance(thing, np.ufunc) else None)
    if module == "builtins":
        return resolved(thing) is thing
    if module is None or not _is_module(module):
        return False
    found = resolved(thing)
    return found is thing or (found is None and isinstance(thing, type))


def resolved(thing: Any) -> Any:
    """What stands under the name of a thing in its module, or None where there is nothing."""
    found: Any = sys.modules.get(getattr(thing, "__module__", None) or "numpy")
    for name in getattr(thing, "__qualname__", thing.__name__).split("."):
        found = getattr(found, name, None)
    return found


@cache
def _is_file(file: str) -> bool:
    """Whether a file is one of a library's own."""
    path = Path(file)
    if any(folder in path.parents for folder in _PACKAGES.values()):
        return True
    standard = file.startswith(_LIBRARY) and "-packages" not in file
    return standard and any(part in (path.stem, path.parent.name) for part in _STANDARD)


def _is_module(name: str) -> bool:
    """Whether the module of a name is a library's, not one of the same name that somebody has beside the program."""
    top = name.partition(".")[0]
    if top not in _PACKAGES and top not in _STANDARD and name != "_operator":
        return False
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    if file is None:
        origin = getattr(getattr(module, "__spec__", None), "origin", None)
        return origin in ("built-in", "frozen") or (module is not None and top in _PACKAGES)
    if top in _PACKAGES:
        return _PACKAGES[top] in Path(file).parents
    return file.startswith(_LIBRARY) and "-packages" not in file
