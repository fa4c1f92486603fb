"""Rules of what moves elements about, and of what calls other functions."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from sigmax.native.graph import Array, Graph, boxed
from sigmax.native.primitives.interpret import evaluate, evaluate_closed, rule
from sigmax.native.primitives.kernels import KERNELS
from sigmax.native.refusal import Refused

_LONGEST_LOOP = 10_000


@rule("broadcast_in_dim", parameters="shape broadcast_dimensions", moves=True)
def _broadcast(g: Graph, equation: Any, a: Array) -> Array:
    shape = equation.params["shape"]
    aligned = [1] * len(shape)
    for place, size in zip(equation.params["broadcast_dimensions"], a.shape, strict=True):
        aligned[place] = size
    return np.broadcast_to(np.reshape(a, aligned), shape)


@rule("reshape", parameters="new_sizes dimensions", moves=True)
def _reshape(g: Graph, equation: Any, a: Array) -> Array:
    read = equation.params["dimensions"]
    return np.reshape(a if read is None else np.transpose(a, read), equation.params["new_sizes"])


@rule("expand_dims", "squeeze", parameters="dimensions", moves=True)
def _to_shape(g: Graph, equation: Any, a: Array) -> Array:
    return np.reshape(a, equation.outvars[0].aval.shape)


@rule("transpose", parameters="permutation", moves=True)
def _transpose(g: Graph, equation: Any, a: Array) -> Array:
    return np.transpose(a, equation.params["permutation"])


@rule("rev", parameters="dimensions", moves=True)
def _rev(g: Graph, equation: Any, a: Array) -> Array:
    return np.flip(a, equation.params["dimensions"])


@rule("concatenate", parameters="dimension", moves=True)
def _concatenate(g: Graph, equation: Any, *arrays: Array) -> Array:
    return np.concatenate(g.alike(arrays), equation.params["dimension"])


@rule("stack", parameters="axis", moves=True)
def _stack(g: Graph, equation: Any, *arrays: Array) -> Array:
    return np.stack(g.alike(arrays), equation.params["axis"])


@rule("tile", parameters="reps", moves=True)
def _tile(g: Graph, equation: Any, a: Array) -> Array:
    return np.tile(a, equation.params["reps"])


@rule("split", parameters="sizes axis", moves=True)
def _split(g: Graph, equation: Any, a: Array) -> list[Array]:
    places = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(a, places, equation.params["axis"]))


@rule("unstack", parameters="axis", moves=True)
def _unstack(g: Graph, equation: Any, a: Array) -> list[Array]:
    return [boxed(part) for part in np.moveaxis(a, equation.params["axis"], 0)]


@rule("slice", parameters="start_indices limit_indices strides", moves=True)
def _slice(g: Graph, equation: Any, a: Array) -> Array:
    p = equation.params
    strides = p["strides"] or (1,) * a.ndim
    return a[tuple(map(slice, p["start_indices"], p["limit_indices"], strides))]


@rule("pad", parameters="padding_config", moves=True)
def _pad(g: Graph, equation: Any, a: Array, value: Array) -> Array:
    a, value = g.alike([a, value])
    out = np.full(equation.outvars[0].aval.shape, value[()], dtype=a.dtype)
    for place in np.ndindex(a.shape):
        at = [
            low + i * (inside + 1) for i, (low, _, inside) in zip(place, equation.params["padding_config"], strict=True)
        ]
        if all(0 <= i < size for i, size in zip(at, out.shape, strict=True)):
            out[tuple(at)] = a[place]
    return out


_OF_CALLS = (
    "jaxpr call_jaxpr fun_jaxpr jvp_jaxpr_fun jvp_jaxpr_thunk fwd_jaxpr_thunk bwd num_consts out_trees symbolic_zeros "
    "in_shardings out_shardings in_layouts out_layouts donated_invars ctx_mesh name keep_unused inline "
    "compiler_options_kvs prevent_cse differentiated policy attributes version"
)


CALLS = (
    *("pjit", "jit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr"),
    *("remat", "checkpoint", "remat2", "composite"),
)


@rule(*CALLS, parameters=_OF_CALLS, calls=True)
def _call(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    return evaluate_closed(g, body_of(equation), arrays)


def body_of(equation: Any) -> ClosedJaxpr:
    """What a call calls.

    Raises:
        Refused: where it cannot be seen.
    """
    p = equation.params
    inner = p.get("jaxpr", p.get("call_jaxpr", p.get("fun_jaxpr")))
    if inner is None:
        raise Refused(f"the call {equation.primitive.name!r}, whose body cannot be seen, cannot be lowered to C")
    return inner if hasattr(inner, "consts") else ClosedJaxpr(inner, [])


@rule(*KERNELS, parameters="function tree", calls=True)
def _of_algebra(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    return evaluate_closed(g, algebra_written_out(equation), arrays)


def algebra_written_out(equation: Any) -> ClosedJaxpr:
    """The body of a function of the algebra."""
    p = equation.params
    return _traced_body(p["function"], p["tree"], tuple((v.aval.shape, v.aval.dtype) for v in equation.invars))


@functools.lru_cache(maxsize=256)
def _traced_body(function: Callable[..., Any], tree: Any, leaves: tuple[tuple[Any, Any], ...]) -> ClosedJaxpr:
    """A step takes the same few bodies many times, and so does the next filter."""
    specs = [jax.ShapeDtypeStruct(*leaf) for leaf in leaves]
    # Without calls of functions of NumPy, whose tracing takes twice the time of what they do.
    with jax.disable_jit():
        return jax.make_jaxpr(lambda *given: function(*jax.tree.unflatten(tree, given)))(*specs)


@rule("cond", parameters="branches", calls=True)
def _cond(g: Graph, equation: Any, which: Array, *arrays: Array) -> list[Array]:
    """A choice between all branches, for the lanes of a batch need not take the same one."""
    branches = equation.params["branches"]
    if which.dtype != object:
        return evaluate_closed(g, branches[min(max(int(which), 0), len(branches) - 1)], arrays)
    place = g.certain(which[()])
    made = [evaluate(g, branch, arrays) for branch in branches]
    result = made[-1]
    for number in range(len(branches) - 2, -1, -1):
        first = g.apply("not", place) if place.truth else g.apply("<=", place, g.constant(float(number)))
        # A choice by what is not so is made by what is.
        g.choices.add((first.arguments[0] if first.operation == "not" else first).index)
        result = [
            np.frompyfunc(lambda a, b, p=first: g.apply("select", p, a, b), 2, 1)(a, b)
            for a, b in zip(made[number], result, strict=True)
        ]
    return result


@rule("while", parameters="cond_jaxpr body_jaxpr cond_nconsts body_nconsts", calls=True)
def _while(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    p = equation.params
    of_test, of_body = arrays[: p["cond_nconsts"]], arrays[p["cond_nconsts"] :][: p["body_nconsts"]]
    carry = list(arrays[p["cond_nconsts"] + p["body_nconsts"] :])
    for _ in range(_LONGEST_LOOP):
        (go_on,) = evaluate_closed(g, p["cond_jaxpr"], [*of_test, *carry])
        go_on = g.known(go_on, bool)
        if go_on.dtype == object:
            raise Refused("a loop whose length depends on the data ('while') cannot be lowered to C")
        if not go_on.all():
            return carry
        carry = evaluate_closed(g, p["body_jaxpr"], [*of_body, *carry])
    raise Refused(f"a loop of more than {_LONGEST_LOOP} passes cannot be lowered to C")


@rule("scan", parameters="jaxpr length reverse num_consts num_carry linear unroll _split_transpose", calls=True)
def _scan(g: Graph, equation: Any, *arrays: Array) -> list[Array]:
    p = equation.params
    length, fixed, carried = p["length"], p["num_consts"], p["num_carry"]
    if length > _LONGEST_LOOP:
        raise Refused(f"a loop of more than {_LONGEST_LOOP} passes cannot be lowered to C")
    constants, carry, series = arrays[:fixed], list(arrays[fixed : fixed + carried]), arrays[fixed + carried :]
    rows: list[list[Array]] = []
    for i in range(length)[:: -1 if p["reverse"] else 1]:
        made = evaluate_closed(g, p["jaxpr"], [*constants, *carry, *(boxed(s[i]) for s in series)])
        carry = made[:carried]
        rows.append([g.opened(a) for a in made[carried:]])
    if p["reverse"]:
        rows.reverse()
    shapes = [v.aval.shape for v in equation.outvars[carried:]]
    stacked = [
        np.stack([row[k] for row in rows]) if rows else np.empty(shape, dtype=object) for k, shape in enumerate(shapes)
    ]
    return [*carry, *stacked]
