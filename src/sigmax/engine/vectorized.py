"""A small function applied to many rows of numbers, on the engines that run the filters."""

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, TypeVar

import jax
import numpy as np

from sigmax.algebra.compiling import compiled
from sigmax.engine.backend import attempt
from sigmax.engine.job import rows, without_numbers
from sigmax.functions.current import current
from sigmax.native import Graph, Program, evaluate
from sigmax.native.calls import ready
from sigmax.native.driver import Series, Step, TotalsJob, driver, over_cores, pointer, series, steps
from sigmax.native.fingerprint import fingerprint
from sigmax.native.machine import lane_bytes

Shapes = tuple[tuple[int, ...], ...]
Kind = TypeVar("Kind", bound=tuple[Any, ...])


def vectorized(function: Callable[..., Any], *arrays: np.ndarray, backend: str | None = None) -> tuple[np.ndarray, ...]:
    """What `function` gives for each row of arrays (B, …): one array (B, …) or several, always as a tuple.

    Natively a row's bits do not depend on the rows beside it. Compiled once for a function and the shapes
    of its arguments; a function is told from another by its identity
    and by what it reads.

    Args:
        function: of arrays (…), traceable by JAX, giving an array or a tuple of arrays.
        arrays: the arguments for each row, float64.
        backend: as in `run`.
    """
    function = current(function)
    each = [np.ascontiguousarray(a, np.float64) for a in arrays]
    shapes = tuple(a.shape[1:] for a in each)

    def native() -> tuple[np.ndarray, ...]:
        step, made_shapes = _lowered(function, shapes)
        count = len(each[0])
        given = np.ascontiguousarray(np.concatenate([a.reshape(count, -1) for a in each], axis=1))
        sizes = [int(np.prod(shape)) for shape in made_shapes]
        made = np.empty((count, sum(sizes)))
        part = without_numbers(step)
        over_cores(driver(False)["rows"], rows(part, given, made), count, False)
        parts = np.split(made, np.cumsum(sizes)[:-1], axis=1)
        return tuple(part.reshape(count, *shape) for part, shape in zip(parts, made_shapes, strict=True))

    return attempt(backend, False, native, lambda: tuple(map(np.asarray, _vectorised(function)(*each))))


def totals(function: Callable[..., Any], *arrays: np.ndarray, backend: str | None = None) -> tuple[np.ndarray, ...]:
    """Sums over the first axis of arrays (B, T, …) of what `function` gives: always a tuple of arrays (T, …).

    Natively in a fixed order, on one core, without Python's lock and without an array of B × T results.

    Args:
        function: as in `vectorized`.
        arrays: the arguments for each run and step, float64.
        backend: as in `run`.
    """
    function = current(function)
    given = [np.ascontiguousarray(a, np.float64) for a in arrays]
    B, T = given[0].shape[:2]

    def native() -> tuple[np.ndarray, ...]:
        step, made_shapes = _lowered(function, tuple(a.shape[2:] for a in given))
        sizes = [int(np.prod(shape)) for shape in made_shapes]
        sums = np.zeros((T, sum(sizes), lane_bytes() // 8))
        parts = (Series * len(given))(*(series(a, a.ndim - 2, True, True) for a in given))
        part = without_numbers(step)
        job = TotalsJob(
            part.step.address,
            pointer(part.constants),
            T,
            len(given),
            sum(sizes),
            parts,
            pointer(sums),
            part.step.workspace,
        )
        driver(False)["totals"](ctypes.addressof(job), 0, B)
        split = np.split(sums.sum(-1), np.cumsum(sizes)[:-1], axis=1)
        return tuple(part.reshape(T, *shape) for part, shape in zip(split, made_shapes, strict=True))

    return attempt(backend, False, native, lambda: tuple(map(np.asarray, _added(function)(*given))))


def bound(function: Callable[..., Any], shapes: Shapes, kind: type[Kind]) -> Callable[..., Kind]:
    """A function of arrays of these shapes, made ready to be called often with one of each: some microseconds a call.

    The call copies what it is given, gives new arrays as a tuple of the type `kind`, and NotImplemented where something
    is not an array of numbers of its shape.

    Args:
        function: of arrays, traceable by JAX, giving a tuple of arrays.
        shapes: of its arguments.
        kind: a named tuple with a field for each array it gives.

    Raises:
        Refused: where the function cannot be lowered.
        Unavailable: without a compiler, or where it fails.
    """
    step, made_shapes = _lowered(function, shapes, True)
    sizes = [[int(np.prod(shape)) for shape in some] for some in (shapes, made_shapes)]
    given, made = (np.zeros(sum(some)) for some in sizes)
    part = without_numbers(step)
    inputs, outputs = (
        tuple(part.reshape(shape) for part, shape in zip(np.split(flat, np.cumsum(some)[:-1]), each, strict=True))
        for flat, some, each in ((given, sizes[0], shapes), (made, sizes[1], made_shapes))
    )
    return ready(driver(False, True)["rows"], rows(part, given, made), 1, inputs, outputs, kind, kept=part)


@lru_cache(maxsize=64)
def _added(function: Callable[..., Any]) -> Callable[..., Any]:
    each = jax.vmap(jax.vmap(partial(_listed, function)))
    return compiled(lambda *given: tuple(part.sum(0) for part in each(*given)))


@lru_cache(maxsize=64)
def _vectorised(function: Callable[..., Any]) -> Callable[..., Any]:
    return compiled(jax.vmap(partial(_listed, function)))


def _listed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    made = function(*arguments)
    return tuple(made) if isinstance(made, tuple) else (made,)


@lru_cache(maxsize=64)
def _lowered(function: Callable[..., Any], shapes: Shapes, alone: bool = False) -> tuple[Step, Shapes]:
    specs = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
    name = fingerprint("vectorized", function, shapes)
    made = jax.eval_shape(partial(_listed, function), *specs)

    def program() -> Program:
        g = Graph()
        flat = g.inputs("given", (sum(int(np.prod(shape)) for shape in shapes),))
        bounds = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
        given = [part.reshape(shape) for part, shape in zip(np.split(flat, bounds), shapes, strict=True)]
        out = evaluate(g, jax.make_jaxpr(partial(_listed, function))(*specs), given)
        return Program(g, ("given",), {"made": [node for a in out for node in a.flat], "told": []})

    (step,) = steps([(name, program)], False, alone)
    return step, tuple(leaf.shape for leaf in made)
