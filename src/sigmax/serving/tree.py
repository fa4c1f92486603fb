"""Values of named tuples, lists, mappings and arrays as bytes and back, bit for bit, running no code of theirs."""

import importlib
import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from sigmax.errors import InputError

# Only classes of ours are looked up by name.
_OURS = "sigmax."
# What reading damaged bytes may end in; a flipped bit can look like a password or a newer format.
_DAMAGED = (
    OSError, ValueError, LookupError, EOFError, AttributeError, ImportError, TypeError, RuntimeError,
    zipfile.BadZipFile,
)  # fmt: skip


def dumped(value: Any) -> bytes:
    """The bytes of a value.

    Raises:
        InputError: for something else than numbers, text, arrays, and lists, mappings and our named tuples of them.
    """
    arrays: list[np.ndarray] = []
    text = json.dumps(_encoded(value, arrays))
    buffer = io.BytesIO()
    np.savez(buffer, *arrays, tree=np.frombuffer(text.encode(), np.uint8))
    return buffer.getvalue()


def loaded(data: bytes) -> Any:
    """The value of bytes that `dumped` gave.

    Raises:
        InputError: where they are none.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = [stored[f"arr_{i}"] for i in range(len(stored.files) - 1)]
            return _decoded(json.loads(stored["tree"].tobytes()), arrays)
    except _DAMAGED as error:
        raise InputError(f"these {len(data)} bytes are no saved value: {error}") from error


def _encoded(value: Any, arrays: list[np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        # NumPy's float64 is a float, and comes back as one.
        return ["v", float(value) if isinstance(value, np.floating) else value]
    if isinstance(value, np.ndarray | np.generic):
        arrays.append(np.asarray(value))
        return ["a" if isinstance(value, np.ndarray) else "s", len(arrays) - 1]
    if isinstance(value, Mapping):
        return ["d", [[_encoded(k, arrays), _encoded(v, arrays)] for k, v in value.items()]]
    kind = type(value)
    if isinstance(value, tuple) and hasattr(value, "_fields") and kind.__module__.startswith(_OURS):
        return ["n", kind.__module__, kind.__qualname__, [_encoded(v, arrays) for v in value]]
    if kind in (list, tuple):
        return ["l" if kind is list else "t", [_encoded(v, arrays) for v in value]]
    raise InputError(f"a value of {kind.__module__}.{kind.__qualname__} cannot be saved")


def _decoded(node: Any, arrays: list[np.ndarray]) -> Any:
    tag, *rest = node
    if tag == "v":
        return rest[0]
    if tag in "as":
        return arrays[rest[0]] if tag == "a" else arrays[rest[0]][()]
    if tag == "d":
        return {_decoded(k, arrays): _decoded(v, arrays) for k, v in rest[0]}
    members = [_decoded(v, arrays) for v in rest[-1]]
    if tag == "n":
        module, name, _ = rest
        kind = getattr(importlib.import_module(module), name) if module.startswith(_OURS) else None
        if not (isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")):
            raise ValueError(f"{module}.{name} is no named tuple of sigmax")
        return kind(*members)
    return members if tag == "l" else tuple(members)
