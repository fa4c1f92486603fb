"""Rules of what moves elements about, and of what calls other functions."""

from typing import Any

import numpy as np

from sigmax.native.elementwise import each
from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.interpret import evaluate, evaluate_open, rule
from sigmax.native.refusal import Refused

_LONGEST_LOOP = 10_000


@rule("broadcast_in_dim")
def _broadcast(g: Graph, equation: Any, a: Array, *_: Array) -> Array:
    shape = equation.params["shape"]
    aligned = [1] * len(shape)
    for place, size in zip(equation.params["broadcast_dimensions"], a.shape, strict=True):
        aligned[place] = size
    return np.broadcast_to(a.reshape(aligned), shape)


@rule("reshape", tables=True)
def _reshape(g: Graph, equation: Any, a: Array, *_: Array) -> Array:
    return a.reshape(equation.params["new_sizes"])


@rule("expand_dims", "squeeze", tables=True)
def _to_shape(g: Graph, equation: Any, a: Array) -> Array:
    return a.reshape(equation.outvars[0].aval.shape)


@rule("transpose", tables=True)
def _transpose(g: Graph, equation: Any, a: Array) -> Array:
    return a.transpose(equation.params["permutation"])


@rule("rev", tables=True)
def _rev(g: Graph, equation: Any, a: Array) -> Array:
    return np.flip(a, equation.params["dimensions"])


@rule("concatenate")
def _concatenate(g: Graph, equation: Any, *arrays: Array) -> Array:
    return np.concatenate(arrays, equation.params["dimension"])


@rule("stack")
def _stack(g: Graph, equation: Any, *arrays: Array) -> Array:
    return np.stack(arrays, equation.params["axis"])


@rule("split")
def _split(g: Graph, equation: Any, a: Array) -> list[Array]:
    places = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(a, places, equation.params["axis"]))


@rule("slice", tables=True)
def _slice(g: Graph, equation: Any, a: Array) -> Array:
    p = equation.params
    strides = p["strides"] or (1,) * a.ndim
    return a[tuple(map(slice, p["start_indices"], p["limit_indices"], strides))]


@rule("pad")
def _pad(g: Graph, equation: Any, a: Array, value: Array) -> Array:
    out = np.full(equation.outvars[0].aval.shape, value[()], dtype=object)
    for place in np.ndindex(a.shape):
        at = [
            low + i * (inside + 1) for i, (low, _, inside) in zip(place, equation.params["padding_config"], strict=True)
        ]
        if all(0 <= i < size for i, size in zip(at, out.shape, strict=True)):
            out[tuple(at)] = a[place]
    return out


@rule("iota")
def _iota(g: Graph, equation: Any) -> Array:
    shape, dimension = equation.params["shape"], equation.params["dimension"]
    counted = np.arange(shape[dimension], dtype=float).reshape([-1 if i == dimension else 1 for i in range(len(shape))])
    return g.constants(np.broadcast_to(counted, shape))


@rule(
    "pjit",
    "jit",
    "closed_call",
    "core_call",
    "custom_jvp_call",
    "custom_vjp_call",
    "remat",
    "checkpoint",
    "remat2",
    tables=True,
)
def _call(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    p = equation.params
    inner = p.get("jaxpr", p.get("call_jaxpr", p.get("fun_jaxpr")))
    if inner is None:
        raise Refused(f"the call {equation.primitive.name!r}, whose body cannot be seen, cannot be lowered to C")
    if not hasattr(inner, "consts"):
        return evaluate_open(g, inner, [], arrays)
    return evaluate_open(g, inner.jaxpr, [g.constants(c) for c in inner.consts], arrays)


@rule("cond")
def _cond(g: Graph, equation: Any, which: Array, *arrays: Array) -> list[Array]:
    """All branches are computed; the lanes of a batch need not take the same one."""
    branches = equation.params["branches"]
    place = which[()]
    if place.known:
        return evaluate(g, branches[min(max(int(place.value), 0), len(branches) - 1)], arrays)
    made = [evaluate(g, branch, arrays) for branch in branches]
    if place.truth:
        return [each(g, "select")(which, b, a) for a, b in zip(*made, strict=True)]
    result = made[-1]
    for number in range(len(branches) - 2, -1, -1):
        chosen = g.apply("<=", place, g.constant(float(number)))
        result = [
            np.frompyfunc(lambda a, b, p=chosen: g.apply("select", p, a, b), 2, 1)(a, b)
            for a, b in zip(made[number], result, strict=True)
        ]
    return result


@rule("while")
def _while(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    p = equation.params
    of_test, of_body = arrays[: p["cond_nconsts"]], arrays[p["cond_nconsts"] :][: p["body_nconsts"]]
    carry = list(arrays[p["cond_nconsts"] + p["body_nconsts"] :])
    for _ in range(_LONGEST_LOOP):
        (go_on,) = evaluate(g, p["cond_jaxpr"], [*of_test, *carry])
        if not go_on[()].known:
            raise Refused("a loop whose length depends on the data cannot be lowered to C")
        if not go_on[()].value:
            return carry
        carry = evaluate(g, p["body_jaxpr"], [*of_body, *carry])
    raise Refused(f"a loop of more than {_LONGEST_LOOP} passes cannot be lowered to C")


@rule("scan")
def _scan(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    p = equation.params
    length, fixed, carried = p["length"], p["num_consts"], p["num_carry"]
    if length > _LONGEST_LOOP:
        raise Refused(f"a loop of more than {_LONGEST_LOOP} passes cannot be lowered to C")
    constants, carry, series = arrays[:fixed], list(arrays[fixed : fixed + carried]), arrays[fixed + carried :]
    given: list[list[Array]] = []
    for i in range(length)[:: -1 if p["reverse"] else 1]:
        made = evaluate(g, p["jaxpr"], [*constants, *carry, *(boxed(s[i]) for s in series)])
        carry, out = made[:carried], made[carried:]
        given.append(out)
    if p["reverse"]:
        given.reverse()
    shapes = [v.aval.shape for v in equation.outvars[carried:]]
    stacked = [
        np.stack([row[k] for row in given]) if given else np.empty(shape, dtype=object)
        for k, shape in enumerate(shapes)
    ]
    return [*carry, *stacked]


@rule("cholesky")
def _cholesky(g: Graph, equation: Any, a: Array) -> Array:
    if a.ndim != 2:
        raise Refused("a batch of factorisations cannot be lowered to C")
    n = len(a)
    out = np.full((n, n), g.constant(0.0), dtype=object)
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot = g.apply("-", pivot, g.apply("*", out[j, k], out[j, k]))
        out[j, j] = g.apply("sqrt", pivot)
        for i in range(j + 1, n):
            rest = a[i, j]
            for k in range(j):
                rest = g.apply("-", rest, g.apply("*", out[i, k], out[j, k]))
            out[i, j] = g.apply("/", rest, out[j, j])
    return out


@rule("triangular_solve")
def _triangular_solve(g: Graph, equation: Any, a: Array, b: Array) -> Array:
    p = equation.params
    if a.ndim != 2 or p.get("conjugate_a"):
        raise Refused("a batch of triangular solutions cannot be lowered to C")
    lower = bool(p["lower"])
    if p["transpose_a"]:
        a, lower = a.T, not lower
    if not p["left_side"]:
        a, b, lower = a.T, b.T, not lower
    n, x = len(a), np.empty(b.shape, dtype=object)
    order = range(n) if lower else range(n - 1, -1, -1)
    minus, times, over = each(g, "-"), each(g, "*"), each(g, "/")
    for i in order:
        rest = b[i]
        for j in range(i) if lower else range(n - 1, i, -1):
            rest = minus(rest, times(a[i, j], x[j]))
        x[i] = rest if p["unit_diagonal"] else over(rest, a[i, i])
    return x if p["left_side"] else x.T
