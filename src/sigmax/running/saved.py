"""The state of a live filter as bytes."""

import io
import zipfile
from typing import Any

import jax
import numpy as np

from sigmax.errors import InputError
from sigmax.running.step import Belief


def saved(belief: Belief, fault: Any) -> bytes:
    """A belief and its fault as bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, *[np.asarray(a) for a in jax.tree.leaves(belief)], fault=np.asarray(fault))
    return buffer.getvalue()


def restored(content: bytes, like: Belief) -> tuple[Belief, np.ndarray]:
    """The belief and the fault of bytes, laid out as `like`.

    Raises:
        InputError: where the bytes are no such state.
    """
    leaves, structure = jax.tree.flatten(like)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            found = [stored[f"arr_{i}"] for i in range(len(stored.files) - 1)]
            fault = stored["fault"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"these {len(content)} bytes are no saved state: {error}") from error
    have, want = ([(a.shape, str(a.dtype)) for a in arrays] for arrays in (found, leaves))
    if have != want:
        raise InputError(f"the saved state has arrays {have}, this filter needs {want}")
    return jax.tree.unflatten(structure, found), fault
