"""A traced function as a list of equations with the calls of others written out, and how much it computes."""

import math
from collections.abc import Sequence
from itertools import count
from typing import Any, NamedTuple

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from sigmax.native.graph import numbers_of
from sigmax.native.interpret import RULES
from sigmax.native.structure import CALLS, algebra_written_out, body_of

# A loop of known length is written out up to so many passes.
_PASSES = 64
# Functions of the algebra that have a loop of their own, by the axes of their arguments: others are written out.
_MATRICES: dict[str, tuple[tuple[int, ...], ...]] = {
    "times": ((2, 1),),
    **dict.fromkeys(("product", "outer", "inner"), ((2, 2),)),
    **dict.fromkeys(("cholesky", "tria", "inverse_lower"), ((2,),)),
    "absorb": ((2, 2, 2), (1, 2, 2)),
    "release": ((2, 2, 2),),
    "solve_lower": ((2, 1), (2, 2)),
}


class Call(NamedTuple):
    """An equation; what it reads is a number of a value, or known."""

    equation: Any
    inputs: tuple[Any, ...]
    outputs: tuple[int, ...]
    label: str


class Flat(NamedTuple):
    """Equations in an order in which each comes after what it reads."""

    inputs: tuple[int, ...]
    calls: tuple[Call, ...]
    outputs: tuple[Any, ...]


def flat(closed: ClosedJaxpr) -> Flat:
    """A closed jaxpr with the calls of other functions written out, and loops that are short."""
    numbers, calls = count(), list[Call]()

    def through(body: ClosedJaxpr, arguments: Sequence[Any], label: str) -> list[Any]:
        jaxpr = body.jaxpr
        known: dict[Any, Any] = {v: numbers_of(c, _dtype(v)) for v, c in zip(jaxpr.constvars, body.consts, strict=True)}
        known |= zip(jaxpr.invars, arguments, strict=True)

        def read(v: Any) -> Any:
            return numbers_of(v.val, _dtype(v)) if isinstance(v, Literal) else known[v]

        for equation in jaxpr.eqns:
            given = [read(v) for v in equation.invars]
            own = label or str(equation.source_info.name_stack).partition("/")[0]
            name = equation.primitive.name
            if name in CALLS:
                made = through(body_of(equation), given, own)
            elif name == "scan" and equation.params["length"] <= _PASSES:
                made = through(_unrolled(equation), given, own)
            elif name.startswith("sigmax_") and not _of_matrices(equation):
                made = through(algebra_written_out(equation), given, own)
            else:
                made = [next(numbers) for _ in equation.outvars]
                calls.append(Call(equation, tuple(given), tuple(made), own))
            known |= zip(equation.outvars, made, strict=True)
        return [read(v) for v in jaxpr.outvars]

    inputs = tuple(next(numbers) for _ in closed.jaxpr.invars)
    outputs = through(closed, inputs, "")
    return Flat(inputs, _needed(calls, outputs), tuple(outputs))


def _dtype(variable: Any) -> Any:
    return variable.aval.dtype


def _of_matrices(equation: Any) -> bool:
    axes = tuple(len(v.aval.shape) for v in equation.invars)
    return axes in _MATRICES[equation.primitive.name.removeprefix("sigmax_")]


def _needed(calls: Sequence[Call], outputs: Sequence[Any]) -> tuple[Call, ...]:
    wanted = {o for o in outputs if isinstance(o, int)}
    kept = []
    for call in reversed(calls):
        if wanted.intersection(call.outputs) or call.equation.effects:
            kept.append(call)
            wanted.update(i for i in call.inputs if isinstance(i, int))
    return tuple(reversed(kept))


def _unrolled(equation: Any) -> ClosedJaxpr:
    p = equation.params
    fixed, carried, order = p["num_consts"], p["num_carry"], range(p["length"])[:: -1 if p["reverse"] else 1]
    body = jaxpr_as_fun(p["jaxpr"])

    def passes(*arrays: Any) -> list[Any]:
        constants, carry, series = arrays[:fixed], arrays[fixed : fixed + carried], arrays[fixed + carried :]
        rows = {}
        for i in order:
            made = body(*constants, *carry, *(s[i] for s in series))
            carry, rows[i] = made[:carried], made[carried:]
        several = [jax.numpy.stack(column) for column in zip(*(rows[i] for i in range(p["length"])), strict=True)]
        return [*carry, *several]

    return jax.make_jaxpr(passes)(*(jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars))


def operations(closed: ClosedJaxpr, choices: bool = True) -> int:
    """About how many scalar operations a function takes, zeros and all, but for what is known.

    Those on sides of choices are counted or not.
    """
    return _counted(closed.jaxpr, set(closed.jaxpr.constvars), choices)


def _counted(jaxpr: Jaxpr, known: set[Any], choices: bool) -> int:
    total = 0
    for equation in jaxpr.eqns:
        sure = [isinstance(v, Literal) or v in known for v in equation.invars]
        name, p = equation.primitive.name, equation.params
        if all(sure):
            known.update(equation.outvars)
        elif name in CALLS:
            total += _inside(body_of(equation), sure, choices)
        elif name == "scan":
            total += p["length"] * _inside(p["jaxpr"], [s and i < p["num_consts"] for i, s in enumerate(sure)], choices)
        elif name == "cond":
            total += sum(_inside(branch, sure[1:], choices) for branch in p["branches"] if choices)
        elif name == "while":
            total += _inside(p["body_jaxpr"], [False] * len(p["body_jaxpr"].jaxpr.invars), choices)
        else:
            total += _operations(equation)
    return total


def _inside(body: ClosedJaxpr, sure: Sequence[bool], choices: bool) -> int:
    known = {v for v, s in zip(body.jaxpr.invars, sure, strict=False) if s}
    return _counted(body.jaxpr, {*body.jaxpr.constvars, *known}, choices)


def _operations(equation: Any) -> int:
    name = equation.primitive.name
    shapes = [v.aval.shape for v in equation.invars]
    rule = RULES.get(name)
    if rule is not None and rule.moves:
        return 0
    if name.startswith("sigmax_"):
        return _of_algebra(name.removeprefix("sigmax_"), shapes)
    size = sum(math.prod(v.aval.shape) for v in equation.outvars)
    if name == "dot_general":
        (contracted, _), _ = equation.params["dimension_numbers"]
        return 2 * size * math.prod(shapes[0][d] for d in contracted)
    if name.startswith("reduce_"):
        return math.prod(shapes[0])
    return size


def _of_algebra(name: str, shapes: Sequence[tuple[int, ...]]) -> int:
    match name, shapes:
        case "times" | "product" | "outer" | "inner", [a, b]:
            inside = a[0] if name == "inner" else a[1]
            return 2 * math.prod(a) * math.prod(b) // max(inside, 1)
        case "cholesky" | "inverse_lower", [a]:
            return a[0] ** 3 // 3
        case "tria", [(r, k, *_)]:
            return 2 * r * r * k - 2 * r**3 // 3
        case "absorb", [_, (m, k, *_), (n, *_)]:
            return 2 * m * (m + 2 * n) * k
        case "release", [(n, *_), (_, q, *_), (p, *_)]:
            return 2 * n * (n + 2 * p) * q
        case "solve_lower", [a, b]:
            return a[0] * math.prod(b)
    return sum(map(math.prod, shapes))
