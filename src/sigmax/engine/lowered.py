"""The half-steps of a filter lowered to C and compiled for this machine."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np

from sigmax.algebra.kernel import kernels
from sigmax.engine import half_step_trace
from sigmax.engine.half_step_trace import HalfStepTrace
from sigmax.engine.half_steps import back_steps, half_steps
from sigmax.engine.packing import Packing
from sigmax.engine.steady_step import steady_step
from sigmax.filters import Filter
from sigmax.functions.current import found_once
from sigmax.modelling.model import Model
from sigmax.native import Graph, Program
from sigmax.native.driver import Step, driver, steps
from sigmax.native.fingerprint import fingerprint
from sigmax.native.graph import Array, array_of
from sigmax.native.loops import Loops
from sigmax.preparation.fusing import with_members_live
from sigmax.rewriting.fusion import Fused

# What `correct` tells, in the order of record.c.
TOLD = ("nis", "log_likelihood", "dof", "fault")


class Lowered:
    """The compiled half-steps of one filter on models of one structure; made when they are first needed.

    Args:
        filter: the filter.
        structure: the model's, as JAX flattens it.
        zeros: of each of the model's arrays of numbers, its shape and which of its entries are always 0.
        inputs: how many inputs u has.
        dtype: float64 or float32.
        alone: whether they are for a single track: the same bits in less time.
        numbers: the model's arrays of numbers where they are to be constants of the programs, else
            they are parameters.
        longest: about how many scalar operations a half-step may have to be a straight line; a longer one is loops.
    """

    def __init__(
        self,
        filter: Filter,
        structure: Any,
        zeros: tuple[Any, ...],
        inputs: int,
        dtype: Any,
        alone: bool = False,
        numbers: Sequence[np.ndarray] | None = None,
        longest: float = half_step_trace.LONGEST,
    ) -> None:
        self.filter, self.structure, self.inputs, self.dtype = filter, structure, inputs, np.dtype(dtype)
        self._alone, self._numbers, self._longest = alone, numbers, longest
        self.zeros = [np.array(pattern).reshape(shape) for shape, pattern in zeros]
        self.packing = Packing.of(filter, self._model([np.zeros(z.shape) for z in self.zeros]))
        self._made: dict[tuple[Any, ...], Step] = {}

    def need(self, *parts: tuple[Any, ...]) -> list[Step]:
        """Compiled parts: ("start",), ("predict",), ("correct", sensor, size), ("steady", sensor, size) or ("back",).

        Raises:
            Refused: for what cannot be lowered.
            Unavailable: without a compiler, or where it fails.
        """
        missing = [part for part in parts if part not in self._made]
        if missing:
            programs = [(self._fingerprint(part), partial(self._chosen, *part)) for part in missing]
            self._made |= zip(missing, steps(programs, self.dtype == np.float32, self._alone), strict=True)
        return [self._made[part] for part in parts]

    @property
    def driver(self) -> Mapping[str, Any]:
        """The functions that call the compiled parts, by name."""
        return driver(self.dtype == np.float32, self._alone)

    def program(self, part: str, *about: Any) -> Program:
        """One part of the filter as a straight line: see `need`.

        Raises:
            Refused: for what cannot be lowered.
        """
        return self._traced(part, *about).straight()

    def _traced(self, part: str, *about: Any) -> HalfStepTrace:
        made: HalfStepTrace = getattr(self, f"_{part}")(*about)
        return made

    def _chosen(self, part: str, *about: Any) -> Program | Loops:
        """One part of the filter as it is compiled; what runs but once in the least time."""
        if part == "steady":  # what it supposes is known of scalars alone
            return self.program(part, *about)
        return self._traced(part, *about).chosen(self._longest / (10 if part == "start" else 1))

    def _fingerprint(self, part: tuple[Any, ...]) -> str | None:
        """What a part is compiled from, or None where that cannot be told."""
        zeros = [(z.shape, z.tobytes()) for z in self.zeros]
        model = vars(self._model([np.zeros(z.shape) for z in self.zeros]))
        return fingerprint(part, self.filter, model, zeros, self.inputs, str(self.dtype), self._longest)

    def parameters(self, model: Model) -> np.ndarray:
        """The model's numbers in one row, as the compiled steps take them."""
        leaves = [np.ravel(leaf) for leaf in jax.tree.leaves(model)]
        return np.concatenate([*leaves, np.zeros(1)]).astype(self.dtype)

    def _model(self, leaves: Sequence[Any]) -> Model:
        return jax.tree.unflatten(self.structure, leaves)

    def _program(
        self, function: Callable[..., Any], inputs: dict[str, list[Array]], g: Graph, made: Callable[..., Any]
    ) -> HalfStepTrace:
        """Trace a function of the model's numbers and of the inputs."""
        noises, place = [], 0
        for zero in self.zeros if self._numbers is None else ():
            symbols = array_of(
                g.constant(0.0) if z else g.input("parameters", place + i, True) for i, z in enumerate(zero.flat)
            ).reshape(zero.shape)
            place += zero.size
            noises.append(symbols)
        noises += [g.constants(a) for a in self._numbers or ()]
        arrays = [*noises, *(a for group in inputs.values() for a in group)]
        specs = [jax.ShapeDtypeStruct(a.shape, self.dtype) for a in arrays]
        count = len(noises)
        with kernels():
            closed = jax.make_jaxpr(lambda *a: function(self._model(a[:count]), *a[count:]))(*specs)
        return HalfStepTrace(g, tuple(inputs), closed, arrays, made)

    def _given(self, g: Graph, *shapes: tuple[int, ...]) -> list[Array]:
        """Arrays of inputs that follow each other in one group."""
        flat = g.inputs("given", (sum(int(np.prod(s)) for s in shapes),))
        bounds = np.cumsum([int(np.prod(s)) for s in shapes])[:-1]
        return [part.reshape(shape) for part, shape in zip(np.split(flat, bounds), shapes, strict=True)]

    def _start(self) -> HalfStepTrace:
        """Mean and covariance, row by row below the diagonal -> belief, and whether it is one."""
        g = Graph(self.dtype)
        n = self.packing.n
        mean, lower = self._given(g, (self.packing.points,), (n * (n + 1) // 2,))
        cov = np.empty((n, n), dtype=object)
        for place, node in zip(zip(*np.tril_indices(n), strict=True), lower, strict=True):
            cov[place] = cov[place[::-1]] = node

        def function(model: Model, mean: Any, cov: Any) -> Any:
            belief, sound = half_steps(self.filter, model).begin(mean, cov)
            return *self.packing.arrays(belief), sound

        def made(out: list[Array]) -> dict[str, Any]:
            return {"made": self.packing.nodes(out[:-1]), "told": [out[-1][()]]}

        return self._program(function, {"given": [mean, cov]}, g, made)

    def _predict(self) -> HalfStepTrace:
        g = Graph(self.dtype)

        def function(model: Model, *given: Any) -> Any:
            arrays, (dt, *u) = given[: self.packing.length], given[self.packing.length :]
            new, fault = half_steps(self.filter, model).predict(self.packing.belief(arrays), dt, u[0] if u else None)
            return *self.packing.arrays(new), fault

        given = self._given(g, (), *(((self.inputs,),) if self.inputs else ()))
        inputs = {"state": self.packing.symbols(g, "state"), "given": given}
        return self._program(
            function, inputs, g, lambda out: {"next": self.packing.nodes(out[:-1]), "told": [out[-1][()]]}
        )

    def _correct(self, sensor: str, size: int, together: Callable[[Any, Any], Fused] | None = None) -> HalfStepTrace:
        """A measurement (m,), or what several sensors measured, put together before: (z, u) -> the one it makes."""
        g = Graph(self.dtype)

        def function(model: Model, *given: Any) -> Any:
            arrays, (z, *inputs) = given[: self.packing.length], given[self.packing.length :]
            u = inputs[0] if inputs else None
            fused = None if together is None else together(z, u)
            if fused is not None:
                z, u = fused.z, fused.u
            new, told, fault = half_steps(self.filter, model).correct(sensor, None, self.packing.belief(arrays), z, u)
            if fused is not None:
                told = with_members_live(told, fused)
            return [
                *self.packing.arrays(new),
                told.nis,
                told.log_likelihood,
                told.dof,
                fault,
                told.residual,
                told.factor,
            ]

        given = self._given(g, (size,), *(((self.inputs,),) if self.inputs else ()))
        inputs = {"state": self.packing.symbols(g, "state"), "given": given}
        told = len(TOLD) + 2
        return self._program(
            function,
            inputs,
            g,
            lambda out: {"next": self.packing.nodes(out[:-told]), "told": [x for a in out[-told:] for x in a.flat]},
        )

    def _steady(self, sensor: str, size: int) -> HalfStepTrace:
        about = steady_step(self.filter, self.packing, self.dtype, sum(z.size for z in self.zeros), sensor, size)
        return self._program(*about)._replace(inputs=("state", "given"))

    def _back(self) -> HalfStepTrace:
        """A step of the smoother: the filtered state, the smoothed later one -> the smoothed one."""
        g = Graph(self.dtype)

        def function(model: Model, *given: Any) -> Any:
            count = self.packing.length
            (now, later), (dt, fault, *u) = (given[:count], given[count : 2 * count]), given[2 * count :]
            beliefs = self.packing.belief(now), self.packing.belief(later)
            new, failed = back_steps(self.filter, model).back(*beliefs, fault, dt, u[0] if u else None)
            return *self.packing.arrays(new), failed

        dt, *u, fault = self._given(g, (), *(((self.inputs,),) if self.inputs else ()), ())
        later, state = self.packing.symbols(g, "later"), self.packing.symbols(g, "state")
        inputs = {"state": state, "later": later, "given": [dt, fault, *u]}
        return self._program(
            function, inputs, g, lambda out: {"next": self.packing.nodes(out[:-1]), "told": [out[-1][()]]}
        )


@lru_cache(maxsize=256)
def _lowered(
    filter: Filter, structure: Any, zeros: tuple[Any, ...], inputs: int, dtype: Any, alone: bool, longest: float
) -> Lowered:
    return Lowered(filter, structure, zeros, inputs, dtype, alone, longest=longest)


def lowered(
    filter: Filter, model: Model, inputs: int, dtype: Any, known_zeros: bool = True, alone: bool = False
) -> Lowered:
    """The compiled half-steps for a model, shared by models that differ in the numbers of their noises alone."""
    return _of_model(model, filter, inputs, np.dtype(dtype), known_zeros, alone, half_step_trace.LONGEST)


@found_once
def _of_model(
    model: Model, filter: Filter, inputs: int, dtype: Any, known_zeros: bool, alone: bool, longest: int
) -> Lowered:
    leaves, structure = jax.tree.flatten(model)
    return _lowered(filter, structure, _zeros(leaves, known_zeros), inputs, dtype, alone, longest)


def with_numbers(filter: Filter, model: Model, inputs: int, dtype: Any) -> Lowered:
    """The half-steps with the numbers of the noises as constants."""
    leaves, structure = jax.tree.flatten(model)
    return Lowered(
        filter, structure, _zeros(leaves, True), inputs, dtype, numbers=[np.asarray(leaf) for leaf in leaves]
    )


def _zeros(leaves: Sequence[Any], known: bool) -> tuple[Any, ...]:
    arrays = [np.asarray(leaf) for leaf in leaves]
    return tuple((a.shape, tuple((a == 0).ravel().tolist() if known else [False] * a.size)) for a in arrays)
