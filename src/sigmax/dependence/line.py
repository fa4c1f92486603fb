"""A traced function as one straight line of equations, evaluated at distinct points only."""

from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import source_info_util
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

# Calls whose body is as good as written out in their place; those with derivatives of their own are kept whole.
_INLINED = ("pjit", "jit", "closed_call", "core_call")
_SLICED = 64


class Call(NamedTuple):
    """One equation with the places of what it reads and gives."""

    equation: Any
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


class Line(NamedTuple):
    """A function as calls one after the other, values being numbered places.

    Attributes:
        calls: in an order in which each comes after what it reads.
        constants: values that are there from the start, by place.
        inputs: places of the arguments.
        output: place of the one result.
    """

    calls: tuple[Call, ...]
    constants: Mapping[int, Any]
    inputs: tuple[int, ...]
    output: int

    def __call__(self, *arguments: Any, stopped: frozenset[int] = frozenset()) -> jax.Array:
        """The result; derivatives do not pass the calls that are `stopped`, by number."""
        known = dict(self.constants) | dict(zip(self.inputs, arguments, strict=True))
        for number, call in enumerate(self.calls):
            values = [known[i] for i in call.inputs]
            if number in stopped:
                values = [jax.lax.stop_gradient(v) for v in values]
            known |= zip(call.outputs, _bound(call.equation, values), strict=True)
        return known[self.output]

    def at_points(self, points: jax.Array, rest: Sequence[Any], levels: Mapping[int, int], groups: "Groups") -> Any:
        """The result at many values of the first argument, points (n, d): (m, d).

        Args:
            points: one a column.
            rest: the other arguments, the same for all points.
            levels: of each place; a value of level p is the same at all points of a group of that level,
                one of level 0 at all points.
            groups: of the points, by level.
        """
        known: dict[int, tuple[Any, int | None]] = {i: (v, 0) for i, v in self.constants.items()}
        known |= zip(self.inputs, [(points, None), *((v, 0) for v in rest)], strict=True)
        kept: dict[tuple[int, int], Any] = {}

        def read(place: int, level: int) -> tuple[Any, int | None]:
            """A value at the points of a level, and the axis of the points."""
            value, have = known[place]
            if have == 0:
                return value, None
            if have == level:
                return value, -1
            if (place, level) not in kept:
                columns = groups.first[level] if have is None else groups.where[have][groups.first[level]]
                kept[place, level] = _columns(value, columns)
            return kept[place, level], -1

        for call in self.calls:
            # What gives nothing, such as a print, is done at every distinct point of what it reads.
            level = max((levels[i] for i in call.outputs or call.inputs), default=0)
            if level == 0:
                given = [read(i, 1) for i in call.inputs]
                values = [v if axis is None else v[..., 0] for v, axis in given]
                made = _bound(call.equation, values)
            else:
                made = _over_columns(call.equation, [read(i, level) for i in call.inputs])
            known |= {i: (v, level) for i, v in zip(call.outputs, made, strict=True)}
        value, have = known[self.output]
        if have == 0:
            return jnp.broadcast_to(value[..., None], (*value.shape, points.shape[1]))
        return value if have is None else _columns(value, groups.where[have])


class Groups(NamedTuple):
    """Which points share their first p coordinates.

    Attributes:
        first: by level p, one point of each group.
        where: by level p, the group of each point.
    """

    first: tuple[np.ndarray, ...]
    where: tuple[np.ndarray, ...]


def grouped(points: np.ndarray) -> Groups:
    """Points (d, q), one a row, by their first 0, 1, …, q coordinates; groups in the order of their first points."""
    first, where = [], []
    rounded = np.round(points, 12) + 0.0
    for p in range(points.shape[1] + 1):
        seen: dict[bytes, int] = {}
        group = [seen.setdefault(row.tobytes(), len(seen)) for row in rounded[:, :p]]
        where.append(np.array(group))
        first.append(np.array([group.index(i) for i in range(len(seen))]))
    return Groups(tuple(first), tuple(where))


def _columns(value: Any, columns: np.ndarray) -> Any:
    """Some of the last axis: slices where they are few, which a compiler sees through."""
    if np.array_equal(columns, np.arange(value.shape[-1])):
        return value
    if len(columns) > _SLICED:
        return value[..., columns]
    return jnp.stack([value[..., i] for i in columns.tolist()], axis=-1)


def _bound(equation: Any, values: Sequence[Any]) -> list[Any]:
    found = equation.primitive.get_bind_params(equation.params)
    # Before JAX 0.8 functions came apart from the other parameters.
    functions, parameters = found if isinstance(found, tuple) else ((), found)
    names = source_info_util.current_name_stack() + equation.source_info.name_stack
    # What goes wrong later is told with the line of the model that it came from.
    with source_info_util.user_context(equation.source_info.traceback, name_stack=names):
        made = equation.primitive.bind(*functions, *values, **parameters)
    if not equation.outvars:
        # Of "dce_sink" under vmap JAX gives back the argument.
        return []
    return list(made) if equation.primitive.multiple_results else [made]


def _over_columns(equation: Any, given: Sequence[tuple[Any, int | None]]) -> list[Any]:
    axes = [axis for _, axis in given]
    if all(axis is None for axis in axes):
        raise AssertionError("a value that differs between points is made from values that do not")
    run: Callable[..., list[Any]] = jax.vmap(lambda *v: _bound(equation, v), in_axes=axes, out_axes=-1)
    return run(*(v for v, _ in given))


def straightened(closed: ClosedJaxpr) -> Line:
    """A closed jaxpr of one result with the calls of other functions written out.

    A function that holds a reference or a token is one call: what is written to a reference cannot be seen in places.
    """
    numbers = count()
    calls: list[Call] = []
    constants: dict[int, Any] = {}
    if other := _no_array(closed.jaxpr):
        with source_info_util.user_context(other.source_info.traceback):
            closed = jax.make_jaxpr(jax.jit(jaxpr_as_fun(closed)))(*closed.in_avals)

    def constant(value: Any) -> int:
        place = next(numbers)
        constants[place] = value
        return place

    def walk(jaxpr: Jaxpr, consts: Sequence[Any], arguments: Sequence[int], source: Any = None) -> list[int]:
        known = dict(zip(jaxpr.constvars, map(constant, consts), strict=True))
        known |= zip(jaxpr.invars, arguments, strict=True)

        def place(variable: Any) -> int:
            return constant(variable.val) if isinstance(variable, Literal) else known[variable]

        for equation in jaxpr.eqns:
            inputs = [place(v) for v in equation.invars]
            inner = equation.params.get("jaxpr") if equation.primitive.name in _INLINED else None
            if isinstance(inner, ClosedJaxpr) and not _no_array(inner.jaxpr):
                outputs = walk(inner.jaxpr, inner.consts, inputs, source or equation.source_info)
            else:
                outputs = [next(numbers) for _ in equation.outvars]
                # Of a function that was traced before, the equations know the line of its first caller alone.
                told = equation if source is None else equation.replace(source_info=source)
                calls.append(Call(told, tuple(inputs), tuple(outputs)))
            known |= zip(equation.outvars, outputs, strict=True)
        return [place(v) for v in jaxpr.outvars]

    arguments = [next(numbers) for _ in closed.jaxpr.invars]
    (output,) = walk(closed.jaxpr, closed.consts, arguments)
    return Line(tuple(calls), constants, tuple(arguments), output)


def _no_array(jaxpr: Jaxpr) -> Any:
    """The first equation that reads or gives something else than arrays, None if there is none."""

    def plain(equation: Any) -> bool:
        return all(isinstance(v.aval, jax.core.ShapedArray) for v in (*equation.invars, *equation.outvars))

    return next((e for e in jaxpr.eqns if not plain(e)), None)
