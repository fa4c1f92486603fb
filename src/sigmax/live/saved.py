"""The state of a live filter as bytes that say what they belong to and notice any damage."""

import hashlib
import json
import platform
import sys
from typing import Any

import jax
import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.native.fingerprint import fingerprint
from sigmax.preparation.joining import modes_of

_BEGINNING = b"sigmax state 3\n"
_DIGEST = hashlib.sha256().digest_size


def identity(filter: Filter, model: Model, window: float, lag: float) -> dict[str, Any]:
    """What a state belongs to: whoever differs in one of these cannot take it up.

    The functions and numbers of filter and model are in the fingerprint, where they can be seen through; bytecode
    is part of it, so that it says something to the same Python only.
    """
    found = _fingerprint(filter, model)
    return {
        # Of the package itself, which imports this file and not the other way round.
        "version": sys.modules[__name__.partition(".")[0]].__version__,
        "filter": filter.name,
        "form": filter.form.name,
        "state": list(map(str, model.state)),
        "bias": [] if model.bias is None else list(map(str, model.bias.names)),
        "sensors": {s: None if names is None else list(map(str, names)) for s, names in model.measurement.items()},
        "window": window,
        "lag": lag,
        "fingerprint": None if found is None else f"{platform.python_version()} {found}",
    }


def _fingerprint(filter: Filter, model: Model) -> str | None:
    """Of functions and numbers one by one: which of them share what differs between a model and its pickled copy."""
    if isinstance(model, SwitchingModel):
        of_modes = [_fingerprint(own, part) for own, part in modes_of(filter, model)]
        change = fingerprint(model.transition, installed=b"") if callable(model.transition) else ""
        chain = [np.asarray(a, float).tobytes() for a in jax.tree.leaves(model)]
        modes = of_modes, change, chain, model.names, [name for name, *_ in model.entry]
        return None if None in (*of_modes, change) else hashlib.sha256(repr(modes).encode()).hexdigest()
    functions = [model.motion, *model.sensors.values(), model.domain, model.Q, *model.R.values()]
    if model.bias is not None:
        functions += [model.bias.motion, *model.bias.sensor.values(), model.bias.Q]
    functions += [c.function for c in model.constraints] + [joint for _, joint, _ in model.inside]
    parts = [fingerprint(filter, installed=b"")]
    parts += [fingerprint(f, installed=b"") for f in functions if callable(f)]
    if None in parts:
        return None
    numbers = [(np.shape(a), np.asarray(a, float).tobytes()) for a in jax.tree.leaves(model)]
    spaces = model.space, *(None if m is None else m.space for m in model.measured.values())
    bounds = [(c.low, c.high, c.when) for c in model.constraints]
    about = parts, numbers, spaces, model.fusion, bounds, [(of, size) for of, _, size in model.inside]
    return hashlib.sha256(repr(about).encode()).hexdigest()


def saved(value: list[Any], owner: dict[str, Any]) -> bytes:
    """A value of lists, dicts, text, numbers and arrays as bytes: a digest of the rest, what it belongs to, arrays."""
    arrays: list[np.ndarray] = []
    written = _written(value, arrays)
    about = {"owner": owner, "value": written, "arrays": [[a.dtype.str, list(a.shape)] for a in arrays]}
    content = json.dumps(about).encode() + b"\n" + b"".join(a.tobytes() for a in arrays)
    return _BEGINNING + hashlib.sha256(content).digest() + content


def restored(content: bytes, like: list[Any], owner: dict[str, Any], open_start: bool = False) -> list[Any]:
    """The value of bytes.

    Args:
        content: the bytes.
        like: a value of the same filter, whose belief [1] and faults [2] say which shapes are needed.
        owner: of `identity`.
        open_start: whether mean and factor may be NaN, which follow from what is behind them.

    Raises:
        InputError: where the bytes are no such state, damaged, of another filter or model, or not finite.
    """
    if not isinstance(content, bytes | bytearray | memoryview):
        raise InputError(f"a saved state is bytes, as Live.save gives them; this is {type(content).__name__}")
    content = bytes(content)
    start = len(_BEGINNING) + _DIGEST
    if not content.startswith(_BEGINNING):
        raise InputError(f"these {len(content)} bytes are no saved state of this version of sigmax")
    if hashlib.sha256(content[start:]).digest() != content[len(_BEGINNING) : start]:
        raise InputError(f"these {len(content)} bytes are no saved state any more: they were damaged or cut off")
    header, _, rest = content[start:].partition(b"\n")
    about = json.loads(header)
    _check_owner(about["owner"], owner)
    arrays, at = [], 0
    for kind, shape in about["arrays"]:
        arrays.append(np.frombuffer(rest, kind, int(np.prod(shape)), at).reshape(shape).copy())
        at += arrays[-1].nbytes
    value: list[Any] = _read(about["value"], arrays)
    found, wanted = ([[a.dtype.str, list(a.shape)] for a in (*one[1], one[2])] for one in (value, like))
    if found != wanted:
        raise InputError(f"the saved state has arrays {found}, this filter needs {wanted}")
    if not all(np.isfinite(a).all() for a in value[1][2 if open_start else 0 :]):
        raise InputError("the saved state is not finite")
    return value


def _written(value: Any, arrays: list[np.ndarray]) -> Any:
    """For JSON: an array as its number in a dict of its own."""
    if isinstance(value, np.ndarray | jax.Array):
        arrays.append(np.ascontiguousarray(value))
        return {"array": len(arrays) - 1, "axes": np.ndim(value)}
    if isinstance(value, list):
        return [_written(v, arrays) for v in value]
    return value


def _read(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, dict) and value.keys() == {"array", "axes"}:
        return arrays[value["array"]].reshape(arrays[value["array"]].shape[: value["axes"]])
    return [_read(v, arrays) for v in value] if isinstance(value, list) else value


def _check_owner(owner: dict[str, Any], wanted: dict[str, Any]) -> None:
    for what, value in wanted.items():
        if what != "fingerprint" and owner[what] != value:
            raise InputError(f"the saved state is of another {what}: it has {owner[what]}, here it needs {value}")
    ours, theirs = wanted["fingerprint"], owner["fingerprint"]
    # Of another Python, or of functions that cannot be seen through, the names have to do.
    if ours and theirs and ours.split()[0] == theirs.split()[0] and ours != theirs:
        raise InputError(
            "the saved state is of another model or filter of the same names: functions, noises or parameters differ; "
            "begin anew from its mean and covariance as a prior if that is meant"
        )
