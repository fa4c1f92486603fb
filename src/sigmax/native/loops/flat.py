"""A traced function as a list of equations with the calls of others written out, and how much it computes."""

import math
from collections.abc import Sequence
from itertools import count
from typing import Any, NamedTuple

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from sigmax.native.graph import numbers_of
from sigmax.native.primitives.interpret import RULES, dtype_of
from sigmax.native.primitives.kernels import KERNELS
from sigmax.native.primitives.structure import CALLS, algebra_written_out, body_of

# A loop of known length is written out up to so many passes.
_PASSES = 64


class FlatCall(NamedTuple):
    """An equation; what it reads is a number of a value, or known."""

    equation: Any
    inputs: tuple[Any, ...]
    outputs: tuple[int, ...]
    label: str


class FlatTrace(NamedTuple):
    """Equations in an order in which each comes after what it reads."""

    inputs: tuple[int, ...]
    calls: tuple[FlatCall, ...]
    outputs: tuple[Any, ...]


def flat(closed: ClosedJaxpr) -> FlatTrace:
    """A closed jaxpr with the calls of other functions written out, and loops that are short."""
    numbers, calls = count(), list[FlatCall]()

    def through(body: ClosedJaxpr, arguments: Sequence[Any], label: str) -> list[Any]:
        jaxpr = body.jaxpr
        known: dict[Any, Any] = {
            v: numbers_of(c, dtype_of(v)) for v, c in zip(jaxpr.constvars, body.consts, strict=True)
        }
        known |= zip(jaxpr.invars, arguments, strict=True)

        def read(v: Any) -> Any:
            return numbers_of(v.val, dtype_of(v)) if isinstance(v, Literal) else known[v]

        for equation in jaxpr.eqns:
            given = [read(v) for v in equation.invars]
            own = label or str(equation.source_info.name_stack).partition("/")[0]
            name = equation.primitive.name
            if name in CALLS:
                made = through(body_of(equation), given, own)
            elif name == "scan" and equation.params["length"] <= _PASSES:
                made = through(_unrolled(equation), given, own)
            elif name in KERNELS and not KERNELS[name].fits(equation):
                made = through(algebra_written_out(equation), given, own)
            else:
                made = [next(numbers) for _ in equation.outvars]
                calls.append(FlatCall(equation, tuple(given), tuple(made), own))
            known |= zip(equation.outvars, made, strict=True)
        return [read(v) for v in jaxpr.outvars]

    inputs = tuple(next(numbers) for _ in closed.jaxpr.invars)
    outputs = through(closed, inputs, "")
    return FlatTrace(inputs, _needed(calls, outputs), tuple(outputs))


def _needed(calls: Sequence[FlatCall], outputs: Sequence[Any]) -> tuple[FlatCall, ...]:
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
    if name in KERNELS:
        return KERNELS[name].operations(*shapes)
    size = sum(math.prod(v.aval.shape) for v in equation.outvars)
    if name == "dot_general":
        (contracted, _), _ = equation.params["dimension_numbers"]
        return 2 * size * math.prod(shapes[0][d] for d in contracted)
    if name.startswith("reduce_"):
        return math.prod(shapes[0])
    return size
