"""Functions lowered to C against JAX, operation by operation, with the tolerance that their own rounding asks for.

The reference evaluates the jaxpr one primitive at a time, many rows at once, and once more for each sample with every
rounded result off by a few units in its last place (Monte Carlo arithmetic, Parker 1997). What that spreads is what two
correct evaluations may differ by; where it is large, such as beside a jump, nothing is judged.
"""

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.native import Graph, Program, Refused, evaluate
from sigmax.native.driver import RowsJob, driver, over_cores, pointer, series, steps

SAMPLES = 6
# How often that is done for what seems wrong.
AGAIN = 8
# What gives one of its arguments, or an integer, or is rounded in one way only: no two evaluations differ.
_EXACT = {
    *("reshape", "broadcast_in_dim", "squeeze", "expand_dims", "transpose", "rev", "concatenate", "split", "slice"),
    *("pad", "gather", "dynamic_slice", "dynamic_update_slice", "sort"),
    *("scatter", "scatter_max", "scatter-max", "scatter_min", "scatter-min", "stack", "unstack"),
    *("select_n", "select_and_gather_add", "max", "min", "clamp", "neg", "abs", "sign", "floor", "ceil", "round"),
    *("iota", "copy", "copy_p", "stop_gradient", "optimization_barrier", "reduce_max", "reduce_min", "cummax"),
    *("cummin", "argmax", "argmin", "device_put", "name", "nextafter", "rem", "reduce_precision"),
    *("bitcast_convert_type", "convert_element_type", "real", "imag", "top_k", "tile"),
}
# What gives whole numbers of whole numbers, of which none is rounded as long as they fit.
_WHOLE = {"add", "add_any", "sub", "mul"}
# What JAX cannot batch.
_ALONE = {"rng_uniform"}
# What adds up inside: its arguments are off too.
_SUMS = {"dot_general", "reduce_sum", "cumsum", "triangular_solve", "cholesky", "lu", "scatter-add", "scatter_add"}
# Where NumPy does by definition what JAX does, and does it at once.
_AT_ONCE: dict[str, Any] = {
    **dict(
        add=np.add, add_any=np.add, sub=np.subtract, mul=np.multiply, neg=np.negative, max=np.maximum, min=np.minimum
    ),
    **dict(lt=np.less, le=np.less_equal, gt=np.greater, ge=np.greater_equal, eq=np.equal, ne=np.not_equal, abs=np.abs),
    **dict(sqrt=np.sqrt, square=np.square, floor=np.floor, ceil=np.ceil, is_finite=np.isfinite),
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
}
_CALLS = (
    "composite",
    "pjit",
    "jit",
    "closed_call",
    "core_call",
    "custom_jvp_call",
    "custom_vjp_call",
    "remat",
    "remat2",
)


class Judged(NamedTuple):
    """What a function gives by row (rows, m), how far a correct evaluation may be off, and where that can be told."""

    value: np.ndarray
    tolerance: np.ndarray
    sure: np.ndarray


def reference(closed: Any, rows: list[np.ndarray], seed: int = 0) -> Judged:
    """The first output of a closed jaxpr at rows of its arguments, each (rows, ...)."""
    count = len(rows[0])
    dtype = closed.in_avals[0].dtype
    noise = _Noise(count, np.finfo(dtype), np.random.default_rng(seed))
    many = [
        np.concatenate([np.asarray(a, v.dtype)] * (SAMPLES + 1)) for a, v in zip(rows, closed.in_avals, strict=True)
    ]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        made = np.asarray(_run(closed.jaxpr, closed.consts, many, noise)[0])
        exact = made.dtype.kind in "biu"
        made = made.astype(float).reshape(SAMPLES + 1, count, -1)
        value, others = made[0], made[1:]
        same = (np.isnan(others) == np.isnan(value)).all(0) & (np.isinf(others) == np.isinf(value)).all(0)
        spread = np.where(np.isfinite(value), np.abs(others - value), 0).max(0)
    rounding = 0.0 if exact else 16 * noise.eps * np.abs(np.where(np.isfinite(value), value, 0))
    # What falls below the smallest normal number on its way is gone.
    tolerance = 32 * spread + rounding + 1000 * float(np.finfo(dtype).tiny)
    sure = same & ~noise.lost.reshape(SAMPLES + 1, count).any(0)[:, None]
    return Judged(value, tolerance, sure & ~(tolerance > 1e-2 * (np.abs(value) + noise.eps**0.5)))


class _Noise:
    """A few units in the last place, other ones for each sample; none for the first."""

    def __init__(self, count: int, about: Any, rng: np.random.Generator) -> None:
        self.count, self.eps, self.most, self.rng = count, float(about.eps), float(about.max), rng
        self.lost = np.zeros(count * (SAMPLES + 1), bool)

    def sign(self, shape: tuple[int, ...]) -> np.ndarray:
        """1 or -1; 1 in the first sample."""
        sign = self.rng.choice([-1.0, 1.0], shape)
        sign[: self.count] = 1
        return sign

    def on(self, values: np.ndarray) -> np.ndarray:
        off = self.rng.choice([-2.0, -1.0, 1.0, 2.0], values.shape)
        off[: self.count] = 0
        return (values * (1 + self.eps * off)).astype(values.dtype)


def _run(jaxpr: Any, consts: Any, arguments: list[Any], noise: _Noise) -> list[Any]:
    """All outputs, with the rows first; what does not differ between rows is spread over them."""
    count = len(arguments[0]) if arguments else len(noise.lost)

    def spread(value: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(value), (count, *np.shape(value)))

    known = dict(zip(jaxpr.constvars, map(spread, consts), strict=True))
    known |= zip(jaxpr.invars, arguments, strict=True)
    for equation in jaxpr.eqns:
        given = [spread(v.val) if hasattr(v, "val") else known[v] for v in equation.invars]
        known |= zip(equation.outvars, _equation(equation, given, count, noise), strict=True)
    return [spread(v.val) if hasattr(v, "val") else known[v] for v in jaxpr.outvars]


def _equation(equation: Any, given: list[Any], count: int, noise: _Noise) -> list[Any]:
    name, p = equation.primitive.name, equation.params
    inner = p.get("jaxpr", p.get("call_jaxpr", p.get("fun_jaxpr")))
    if name in _CALLS and inner is not None:
        return _run(getattr(inner, "jaxpr", inner), getattr(inner, "consts", []), given, noise)
    if name == "cond":
        made = [_run(b.jaxpr, b.consts, given[1:], noise) for b in p["branches"]]
        made = [[np.broadcast_to(a, (count, *a.shape[1:])) for a in branch] for branch in made]
        which = np.clip(given[0].astype(int), 0, len(made) - 1)
        return [np.stack(results)[which, np.arange(count)] for results in zip(*made, strict=True)]
    if name == "scan":
        return _scan(p, given, count, noise)
    if name == "while":
        return _while(p, given, count, noise)

    if name in _AT_ONCE or name == "div":
        # One number beside an array has no axes of its own.
        rank = max(a.ndim for a in given)
        given = [a.reshape(*a.shape, *[1] * (rank - a.ndim)) for a in given]
    if name in _SUMS:
        given = [noise.on(a) if a.dtype.kind == "f" else a for a in given]
    results = _at_once(equation, given, count)
    if results is None:
        results = _by_jax(equation, given, count)
    for a in given:
        # Which infinity or NaN comes of an infinity is a matter of the last bits before it; and 0 · x and 0 / x are 0
        # for any x where the 0 is known.
        if name != "select_n" and not _is_key(a) and a.dtype.kind == "f":
            odd = ~(np.abs(a) <= noise.most) if name in ("mul", "div", "dot_general") else np.abs(a) > noise.most
            noise.lost |= odd.reshape(count, -1).any(1)
    if name == "div" and given[1].dtype.kind == "f":
        noise.lost |= ((given[0] == 0) & (given[1] == 0)).reshape(count, -1).any(1)
    if name in _EXACT:
        return results
    if name in _SUMS:
        # Nor does anybody say which zero a sum of zeros is.
        results = [a * np.where(a == 0, noise.sign(a.shape), 1).astype(a.dtype) for a in results]
    if name == "lgamma":
        # JAX's own is exact to some units of 1, not of the result, where that is near 0: more of them unoptimised.
        return [noise.on(results[0] + 8.0) - 8.0]
    if name in _WHOLE and results[0].dtype.kind == "f":
        # A loop counts in floats, and what it does next hangs on the count.
        a, b = (a == np.floor(a) for a in given)
        whole = a & b & (np.abs(results[0]) < 1 / noise.eps)
        return [np.where(whole, results[0], noise.on(results[0]))]
    return [noise.on(a) if not _is_key(a) and a.dtype.kind == "f" else a for a in results]


def _at_once(equation: Any, given: list[Any], count: int) -> list[Any] | None:
    """What NumPy gives for the commonest operations, None for all others."""
    name, p = equation.primitive.name, equation.params
    if name in _AT_ONCE or (name == "div" and given[0].dtype.kind == "f"):
        return [_AT_ONCE.get(name, np.divide)(*given)]
    if name == "broadcast_in_dim":
        shape = [1] * len(p["shape"])
        for axis, size in zip(p["broadcast_dimensions"], given[0].shape[1:], strict=True):
            shape[axis] = size
        return [np.broadcast_to(given[0].reshape(count, *shape), (count, *p["shape"]))]
    if name in ("squeeze", "expand_dims") or (name == "reshape" and p["dimensions"] is None):
        return [given[0].reshape(count, *equation.outvars[0].aval.shape)]
    if name == "rev":
        return [np.flip(given[0], [1 + i for i in p["dimensions"]])]
    if name in ("reduce_sum", "reduce_max", "reduce_min") and given[0].size and given[0].dtype.kind == "f":
        return [getattr(np, name[7:])(given[0], axis=tuple(1 + i for i in p["axes"]))]
    if name == "transpose":
        return [given[0].transpose(0, *(1 + i for i in p["permutation"]))]
    if name == "concatenate":
        return [np.concatenate(given, 1 + p["dimension"])]
    if name == "slice":
        strides = p["strides"] or [1] * len(p["start_indices"])
        return [given[0][:, *map(slice, p["start_indices"], p["limit_indices"], strides)]]
    if name == "select_n" and given[0].dtype == bool and given[0].ndim == given[1].ndim:
        return [np.where(*given[:1], *given[:0:-1])] if len(given) == 3 else None
    if name == "convert_element_type" and (given[0].dtype.kind in "bf" and p["new_dtype"].kind == "f"):
        return [given[0].astype(p["new_dtype"])]
    return None


def _by_jax(equation: Any, given: list[Any], count: int) -> list[Any]:
    p = equation.params

    def bound(*values: Any) -> Any:
        found = equation.primitive.get_bind_params(p)
        functions, parameters = found if isinstance(found, tuple) else ((), found)
        return equation.primitive.bind(*functions, *values, **parameters)

    if given and equation.primitive.name not in _ALONE:
        made = jax.vmap(bound)(*given)
    elif given:
        made = jax.tree.map(lambda *rows: np.stack(rows), *(bound(*row) for row in zip(*given, strict=True)))
    else:
        made = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a), (count, *a.shape)), bound())
    return [a if _is_key(a) else np.asarray(a) for a in (made if equation.primitive.multiple_results else [made])]


def _is_key(a: Any) -> bool:
    return jnp.issubdtype(a.dtype, jax.dtypes.extended)


def _scan(p: Any, given: list[Any], count: int, noise: _Noise) -> list[Any]:
    fixed, carried = p["num_consts"], p["num_carry"]
    carry, rows = given[fixed : fixed + carried], []
    for i in range(p["length"])[:: -1 if p["reverse"] else 1]:
        at = [s[:, i] for s in given[fixed + carried :]]
        made = _run(p["jaxpr"].jaxpr, p["jaxpr"].consts, [*given[:fixed], *carry, *at], noise)
        carry = made[:carried]
        rows.append(made[carried:])
    rows = rows[::-1] if p["reverse"] else rows
    return [*carry, *(np.stack(parts, 1) for parts in zip(*rows, strict=True))]


def _while(p: Any, given: list[Any], count: int, noise: _Noise) -> list[Any]:
    tests, bodies = p["cond_nconsts"], p["body_nconsts"]
    of_test, of_body, carry = given[:tests], given[tests : tests + bodies], given[tests + bodies :]
    for _ in range(1000):
        (go_on,) = _run(p["cond_jaxpr"].jaxpr, p["cond_jaxpr"].consts, [*of_test, *carry], noise)
        if not go_on.any():
            return carry
        after = _run(p["body_jaxpr"].jaxpr, p["body_jaxpr"].consts, [*of_body, *carry], noise)
        # Of a loop under vmap there is one condition for each member.
        on = [go_on.reshape(*go_on.shape, *[1] * (a.ndim - go_on.ndim)) for a in carry]
        carry = [np.where(o, a, b) for o, a, b in zip(on, after, carry, strict=True)]
    raise AssertionError("a loop of more than 1000 passes")


def traced(function: Any, sizes: tuple[int, ...], dtype: Any) -> Any:
    """The closed jaxpr of a function of vectors of these sizes, its result as one vector of numbers."""

    def flat(*given: Any) -> Any:
        parts = [jnp.ravel(jnp.asarray(a)).astype(dtype) for a in jax.tree.leaves(function(*given))]
        return jnp.concatenate(parts) if len(parts) > 1 else parts[0]

    return jax.make_jaxpr(flat)(*(jax.ShapeDtypeStruct((k,), dtype) for k in sizes))


class Verdict(NamedTuple):
    """What became of a function.

    Attributes:
        refused: why it is left to XLA, or nothing.
        wrong: what is wrong in it, or nothing.
        judged: share of the numbers that could be judged.
    """

    refused: str = ""
    wrong: str = ""
    judged: float = 0.0


def verdicts(functions: Sequence[Any], rows: np.ndarray) -> list[Verdict]:
    """Traced functions of the same vectors lowered, compiled together, and compared with JAX at rows of them all."""
    found = [Verdict()] * len(functions)
    if not functions:
        return found
    sizes, dtype = [v.shape[0] for v in functions[0].in_avals], np.dtype(functions[0].in_avals[0].dtype)
    bounds, kept = np.cumsum(sizes)[:-1], {}
    graph, rows = Graph(dtype), np.ascontiguousarray(rows, dtype)
    arguments = np.split(graph.inputs("given", (sum(sizes),)), bounds)
    for i, closed in enumerate(functions):
        graph.label = ""
        try:
            with np.errstate(all="ignore"):
                (kept[i],) = evaluate(graph, closed, arguments)
        except Refused as error:
            found[i] = Verdict(refused=str(error))
        except Exception as error:
            # Nothing else may be raised, whatever the function is.
            found[i] = Verdict(wrong=f"{type(error).__name__}: {error}")
    made = _in_c(graph, [node for out in kept.values() for node in out.flat], rows)
    parts = np.split(made, np.cumsum([out.size for out in kept.values()])[:-1], axis=1) if kept else []
    for i, values in zip(kept, parts, strict=True):
        given = np.split(rows, bounds, axis=1)
        found[i] = compared(values, reference(functions[i], given), rows)
        if found[i].wrong:
            # Six samples may all fall on one side of a jump; what is wrong stays so with many.
            again = [reference(functions[i], given, seed) for seed in range(1, 1 + AGAIN)]
            found[i] = compared(values, Judged(again[0].value, *_widest(again)), rows)
    return found


def _widest(judged: list[Judged]) -> tuple[np.ndarray, np.ndarray]:
    """Twice the largest tolerance, as many roundings seldom add up in some fifty samples, and what is sure in all."""
    return 2 * np.max([j.tolerance for j in judged], axis=0), np.all([j.sure for j in judged], axis=0)


def _in_c(graph: Graph, nodes: list[Any], rows: np.ndarray) -> np.ndarray:
    """The nodes at rows of the inputs, compiled."""
    single = rows.dtype == np.float32
    program = Program(graph, ("given",), {"made": nodes, "told": [graph.constant(0.0)]})
    (step,) = steps([(None, lambda: program)], single=single)
    constants, made = step.setup(np.zeros(1)), np.empty((len(rows), len(nodes)), rows.dtype)
    job = RowsJob(step.address, pointer(constants), series(rows, 1, True, False), made.shape[1], pointer(made))
    over_cores(driver(single)["rows"], job, len(rows), single)
    return made


def compared(made: np.ndarray, wanted: Judged, rows: np.ndarray) -> Verdict:
    """Whether what was made is what was wanted."""
    with np.errstate(all="ignore"):
        close = np.abs(made - wanted.value) <= wanted.tolerance
    right = close | (made == wanted.value) | (np.isnan(made) & np.isnan(wanted.value)) | ~wanted.sure
    judged = float(wanted.sure.mean()) if wanted.sure.size else 1.0
    if right.all():
        return Verdict(judged=judged)
    i, j = np.argwhere(~right)[0]
    return Verdict(
        wrong=f"component {j} at {rows[i].tolist()} is {made[i, j]!r}, JAX has {wanted.value[i, j]!r} "
        f"± {wanted.tolerance[i, j]:.2g}; {np.sum(~right)} of {right.size} numbers differ",
        judged=judged,
    )


def points(columns: int, seed: int = 0) -> np.ndarray:
    """Rows to compare at: ordinary ones, zeros of both signs, whole numbers, equal ones, huge and tiny ones."""
    rng = np.random.default_rng(seed)
    plain = 1.5 * rng.standard_normal((6, columns))
    whole = rng.integers(-3, 4, (2, columns)).astype(float)
    mixed = 1.5 * rng.standard_normal((3, columns))
    mixed[0, ::2], mixed[1, 1::2], mixed[2, ::3] = 0.0, -0.0, 1e5
    alike = [np.full((1, columns), value) for value in (0.7, 0.0, -0.0)]
    return np.concatenate([plain, whole, mixed, *alike, 1e8 * plain[:1], 1e-8 * plain[1:2]])
