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
from sigmax.models.model import Model
from sigmax.models.switching import SwitchingModel
from sigmax.native.fingerprint import fingerprint
from sigmax.running.joining import modes_of
from sigmax.running.step import Belief

_BEGINNING = b"sigmax state 2\n"
_DIGEST = hashlib.sha256().digest_size


def identity(filter: Filter, model: Model) -> dict[str, Any]:
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
    parts = [fingerprint(filter, installed=b"")]
    parts += [fingerprint(f, installed=b"") for f in functions if callable(f)]
    if None in parts:
        return None
    numbers = [(np.shape(a), np.asarray(a, float).tobytes()) for a in jax.tree.leaves(model)]
    spaces = model.space, *(None if m is None else m.space for m in model.measured.values())
    about = parts, numbers, spaces, model.fusion
    return hashlib.sha256(repr(about).encode()).hexdigest()


def saved(belief: Belief, fault: Any, owner: dict[str, Any]) -> bytes:
    """A belief and its fault as bytes: a digest of the rest, what the state belongs to, its arrays."""
    arrays = [np.ascontiguousarray(a) for a in (*jax.tree.leaves(belief), np.ravel(np.asarray(fault, np.int8)))]
    about = {"owner": owner, "arrays": [[a.dtype.str, list(a.shape)] for a in arrays]}
    content = json.dumps(about).encode() + b"\n" + b"".join(a.tobytes() for a in arrays)
    return _BEGINNING + hashlib.sha256(content).digest() + content


def restored(content: bytes, like: Belief, fault: Any, owner: dict[str, Any]) -> tuple[Belief, np.ndarray]:
    """The belief of bytes, laid out as `like`, and the fault of each track.

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
    leaves, structure = jax.tree.flatten(like)
    wanted = [[np.dtype(a.dtype).str, list(np.shape(a))] for a in (*leaves, np.ravel(np.asarray(fault, np.int8)))]
    if about["arrays"] != wanted:
        raise InputError(f"the saved state has arrays {about['arrays']}, this filter needs {wanted}")
    found, at = [], 0
    for kind, shape in wanted:
        count = int(np.prod(shape))
        found.append(np.frombuffer(rest, kind, count, at).reshape(shape).copy())
        at += found[-1].nbytes
    if not all(np.isfinite(a).all() for a in found):
        raise InputError("the saved state is not finite")
    return jax.tree.unflatten(structure, found[:-1]), found[-1]


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
