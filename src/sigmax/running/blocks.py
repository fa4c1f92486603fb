"""More tracks than memory: a batch filtered block by block."""

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.results.result import Result
from sigmax.running.run import run

# Axes of what is given by track, that of the tracks being the first; R is told by its second, which is time.
_AXES = {"dt": 2, "t": 2, "t0": 1, "inputs": 3}


def run_in_blocks(
    filter: Filter | str | None, model: Model, prior: Gaussian, z: Any, *, tracks: int = 4096, **given: Any
) -> Iterator[tuple[slice, Result]]:
    """Filter a batch so many tracks at a time, bit for bit as `run` does: only one block takes memory.

    Args:
        filter: as in `run`.
        model: as in `run`.
        prior: as in `run`.
        z: as in `run`; of an array in a file, such as `numpy.memmap`, a block is read at a time.
        tracks: in a block.
        given: everything else that `run` takes, for all tracks or one for each.

    Yields:
        Which tracks, as a slice, and their result.

    Raises:
        InputError: where nothing is given by track, or the batches differ in size; with the first block whatever `run`
            raises.
    """
    inspect.signature(run).bind(filter, model, prior, z, **given)
    if isinstance(tracks, bool) or not isinstance(tracks, int | np.integer) or tracks < 1:
        raise InputError(f"tracks must be how many are filtered at a time, 1 or more; it is {tracks!r}")
    whole = {"z": z, **given}
    by_track = dict(_by_track(whole))
    sizes = {name: len(a) for name, a in by_track.items()}
    sizes |= {f"the prior's {what}": len(a) for what, a, core in _parts(prior) if np.ndim(a) > core}
    if len(set(sizes.values())) != 1:
        if not sizes:
            raise InputError("there is one track: give z as (B, T, m), or filter it by run")
        raise InputError(f"the batches differ in size: {sizes}")
    (count,) = set(sizes.values())
    blocks = [slice(k, min(k + tracks, count)) for k in range(0, count, tracks)]
    return _blocks(filter, model, prior, whole, by_track, blocks)


def _blocks(
    filter: Any, model: Model, prior: Gaussian, whole: Any, by_track: Mapping[str, Any], blocks: list[slice]
) -> Iterator[tuple[slice, Result]]:
    for block in blocks:
        here = dict(whole)
        for name, array in by_track.items():
            what, _, sensor = name.partition(" of ")
            here[what] = {**here[what], sensor: array[block]} if isinstance(here[what], Mapping) else array[block]
        mean, cov = (a[block] if np.ndim(a) > core else a for _, a, core in _parts(prior))
        yield block, run(filter, model, Gaussian(mean, cov), **here)


def _parts(prior: Gaussian) -> list[tuple[str, Any, int]]:
    if not isinstance(prior, Gaussian):
        raise InputError(f"prior must be a sigmax.Gaussian, it is {type(prior).__name__}")
    return [("mean", prior.mean, 1), ("covariance", prior.cov, 2)]


def _by_track(whole: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """What is given for each track, a sensor's by its name behind that of the argument."""
    measured = _each("z", whole["z"])
    batched = {np.shape(a)[:2] for _, a in measured if np.ndim(a) == 3}
    steps = {np.shape(a)[-2] for _, a in measured if np.ndim(a) > 1}
    for name, array in measured:
        if np.ndim(array) == 3:
            yield name, array
    for name, axes in _AXES.items():
        array = whole.get(name)
        if array is not None and np.ndim(array) == axes:
            yield name, array if hasattr(array, "shape") else np.asarray(array)
    for name, array in _each("R", whole.get("R")):
        shape = np.shape(array)
        # (T, d, d) is for all tracks, (B, T, d) is not.
        if len(shape) == 4 or (len(shape) == 3 and (shape[:2] in batched or (not batched and shape[1] in steps))):
            yield name, array


def _each(name: str, given: Any) -> list[tuple[str, Any]]:
    if given is None:
        return []
    if isinstance(given, Mapping):
        return [(f"{name} of {s}", array) for s, array in given.items()]
    return [(name, given if hasattr(given, "shape") else np.asarray(given))]
