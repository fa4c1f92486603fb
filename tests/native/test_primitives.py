"""Every primitive with its parameters and types, lowered to C, gives what JAX gives bit for bit, or is refused."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from sigmax.native import Graph, Program, Refused, evaluate
from sigmax.native.driver import Rows, driver, over_cores, pointer, series, steps

jax.config.update("jax_enable_x64", True)
SPECIAL = (0.0, -0.0, 0.5, -0.5, 1.5, 2.5, -2.5, 0.49999999999999994, -0.49999999999999994, 1.0, -1.0, 3.0, -7.0)
BEYOND = (np.nan, np.inf, -np.inf, 1e300, -1e300, 2.0**53, 2.0**63, -(2.0**63), 2.0**32 + 3, -129.0, 255.0, 256.0)
COLUMNS = 8
INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")


def given(dtype):
    """Rows whose first two columns are all pairs of special numbers, the others drawn."""
    values = [v for v in (*SPECIAL, *BEYOND) if dtype == np.float64 or abs(v) < 1e38 or not np.isfinite(v)]
    pairs = np.array(list(product(values, values)))
    drawn = 3 * np.random.default_rng(0).standard_normal((len(pairs), COLUMNS - 2))
    return np.concatenate([pairs, drawn], axis=1).astype(dtype)


def numbers(made):
    """Any result as numbers of the run: truth values and integers exactly."""
    return jnp.ravel(jnp.asarray(made))


def both(cases, dtype=np.float64, rows=None):
    """What the compiled C and JAX give for the cases that are not refused, and why the others are.

    All cases are one program: (native, JAX) by name, and the refusals by name.
    """
    rows = given(dtype) if rows is None else rows
    spec = jax.ShapeDtypeStruct((rows.shape[1],), dtype)
    g = Graph(dtype)
    x = g.inputs("given", (rows.shape[1],))
    made, refused, lowered = [], {}, {}
    for name, function in cases.items():

        def flat(x, function=function):
            return numbers(function(x)).astype(dtype)

        try:
            (out,) = evaluate(g, jax.make_jaxpr(flat)(spec), [x])
        except Refused as error:
            refused[name] = str(error)
            continue
        lowered[name] = flat, slice(len(made), len(made) + out.size)
        made += list(out.flat)
    program = Program(g, ("given",), {"made": made, "told": [g.constant(0.0)]})
    single = dtype == np.float32
    (step,) = steps([(None, lambda: program)], single=single)
    constants, native = step.setup(np.zeros(1)), np.empty((len(rows), len(made)), dtype)
    job = Rows(step.address, pointer(constants), series(rows, 1, True, False), len(made), pointer(native))
    over_cores(driver(single)["rows"], job, len(rows), single)
    by_jax = jax.jit(jax.vmap(lambda x: tuple(flat(x) for flat, _ in lowered.values())))(rows)
    wanted = {name: np.asarray(w) for name, w in zip(lowered, by_jax, strict=True)}
    return {name: (native[:, where], wanted[name]) for name, (_, where) in lowered.items()}, refused


def assert_equal(cases, refusing=(), dtype=np.float64, rtol=0.0, rows=None, zeros=True):
    """Bit for bit with `rtol` 0, the signs of zeros included; `refusing` are the names that must be refused."""
    compared, refused = both(cases, dtype, rows)
    assert set(refused) == set(refusing), {k: v for k, v in refused.items() if k not in refusing} or (
        set(refusing) - set(refused)
    )
    assert all("cannot be lowered" in why for why in refused.values())
    rows = given(dtype) if rows is None else rows
    for name, (native, wanted) in compared.items():
        fits = np.isclose(native, wanted, rtol=rtol, atol=rtol * 1e-3, equal_nan=True)
        if zeros and not rtol:
            fits &= (np.signbit(native) == np.signbit(wanted)) | np.isnan(wanted)
        if not fits.all():
            row, place = np.argwhere(~fits)[0]
            pytest.fail(f"{name}: {native[row, place]!r} for {wanted[row, place]!r} of {rows[row]!r} ({(~fits).sum()})")


FLOAT_UNARY = {
    **{f"lax.{n}": getattr(lax, n) for n in ("neg", "abs", "sign", "floor", "ceil", "square", "sqrt", "is_finite")},
    "round": lax.round,
    "round to even": lambda x: lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN),
    "jnp.round": jnp.round,
    "jnp.trunc": jnp.trunc,
    "isnan": jnp.isnan,
    "not": lambda x: ~(x > 0.5),
    **{f"power {k}": lambda x, k=k: lax.integer_pow(x, k) for k in (0, 1, 2, -1)},
    "reduce_precision": lambda x: lax.reduce_precision(x, 11, 52),
    "stop": lax.stop_gradient,
    "barrier": lax.optimization_barrier,
    "copy": lambda x: jnp.array(x, copy=True),
    "from one half": lambda x: 0.5 - x,
}
FLOAT_BINARY = {
    **{n: getattr(lax, n) for n in ("add", "sub", "mul", "div", "rem", "max", "min")},
    **{n: getattr(lax, n) for n in ("lt", "le", "gt", "ge", "eq", "ne")},
    "clamp": lambda a, b: lax.clamp(a, b, jnp.float64(2).astype(a.dtype)),
    "and": lambda a, b: (a > 0) & (b > 0),
    "or": lambda a, b: (a > 0) | (b > 0),
    "xor": lambda a, b: (a > 0) ^ (b > 0),
    "order of truth": lambda a, b: jnp.stack(
        [(a > 0) < (b > 0), (a > 0) == (b > 0), (a > 0) != (b > 0), (a > 0) >= (b > 0)]
    ),
    "extremes of truth": lambda a, b: jnp.stack([jnp.maximum(a > 0, b > 0), jnp.minimum(a > 0, b > 0)]),
    "select": lambda a, b: lax.select_n(a > b, a, b),
    "where truth": lambda a, b: jnp.where(a > b, a > 0, b > 0),
    "argmax": lambda a, b: jnp.stack([jnp.argmax(jnp.stack([a, b, a])), jnp.argmin(jnp.stack([a, b, a]))]),
    "sorted pair": lambda a, b: jnp.stack([lax.max(a, b), lax.min(a, b)]),
}


def on_floats():
    cases = {name: lambda x, f=f: f(x) for name, f in FLOAT_UNARY.items()}
    return cases | {name: lambda x, f=f: f(x[0], x[1]) for name, f in FLOAT_BINARY.items()}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_arithmetic_of_floats(dtype):
    assert_equal(on_floats(), (), dtype)


INTEGER_UNARY = {
    "neg": lax.neg,
    "abs": abs,
    "sign": lax.sign,
    "square": lax.square,
    "cube": lambda a: a * a * a,
    "not": lax.bitwise_not,
    **{f"add {k}": lambda a, k=k: a + k for k in (1, 100)},
    "minus": lambda a: a - jnp.ones_like(a),
    **{f"mul {k}": lambda a, k=k: a * k for k in (0, 1, 2, 100)},
    **{f"div {k}": lambda a, k=k: lax.div(a, jnp.full_like(a, k)) for k in (1, 3, 49)},
    **{f"floor div {k}": lambda a, k=k: a // k for k in (1, 3, 49)},
    **{f"rem {k}": lambda a, k=k: lax.rem(a, jnp.full_like(a, k)) for k in (1, 3, 49)},
    **{f"mod {k}": lambda a, k=k: a % k for k in (3, 7)},
    **{f"compare {k}": lambda a, k=k: jnp.stack([a < k, a <= k, a > k, a >= k, a == k, a != k]) for k in (0, 3, 100)},
    "clip": lambda a: jnp.clip(a, 1, 5),
    "as truth": lambda a: a.astype(bool),
    "power": lambda a: lax.integer_pow(a, 3),
    "where": lambda a: jnp.where(a > 3, a, a + 1),
    **{f"as {t}": lambda a, t=t: a.astype(t) for t in INTEGERS},
}
INTEGER_BINARY = {
    **{
        n: getattr(lax, n)
        for n in ("add", "sub", "mul", "div", "rem", "max", "min", "lt", "le", "gt", "ge", "eq", "ne")
    },
    "floor div": lambda a, b: a // b,
    "mod": lambda a, b: a % b,
    "dot": lambda a, b: jnp.stack([a, b]) @ jnp.stack([b, a]),
    "reductions": lambda a, b: jnp.stack([r(jnp.stack([a, b])) for r in (jnp.max, jnp.min)]),
    "sum": lambda a, b: lax.reduce_sum(jnp.stack([a, b, a]), (0,)) if hasattr(lax, "reduce_sum") else a + b + a,
    "product": lambda a, b: lax.reduce_prod(jnp.stack([a, b]), (0,)) if hasattr(lax, "reduce_prod") else a * b,
    "running": lambda a, b: jnp.stack(
        [lax.cumsum(jnp.stack([a, b])), lax.cumsum(jnp.stack([a, b]), reverse=True), lax.cummax(jnp.stack([a, b]))]
    ),
    "argmax": lambda a, b: jnp.argmax(jnp.stack([a, b, a])),
    "scatter add": lambda a, b: jnp.stack([a, b, a]).at[jnp.array([0, 0, 2])].add(b),
    "scatter max": lambda a, b: jnp.stack([a, b, a]).at[jnp.array([0, 0, 2])].max(b),
    "table": lambda a, b: jnp.array([1.0, 5.0, -3.0, 2.0])[a] + jnp.array([3, 1, 7])[b],
    "filled": lambda a, b: jnp.array([1, 5, 3, 2], a.dtype).at[a].get(mode="fill", fill_value=9) * (b > 0),
}


def integers_of(t, limit):
    """Operations on integers of a type, from floats within a limit (None: from any float)."""

    def cast(x):
        return (x if limit is None else jnp.clip(x, -limit, limit)).astype(t)

    cases = {f"{t} {n}": lambda x, f=f: f(cast(x[:1])) for n, f in INTEGER_UNARY.items()}
    return cases | {f"{t} {n}": lambda x, f=f: f(cast(x[0]), cast(x[1])) for n, f in INTEGER_BINARY.items()}


@pytest.mark.parametrize("t", INTEGERS)
def test_small_integers(t):
    beyond = ("neg", "not", "minus", "sub", "div", "floor div") if t == "uint64" else ()
    refusing = [f"{t} {n}" for n in (*beyond, *(("as uint64",) if t.startswith("int") else ()))]
    assert_equal(integers_of(t, 300.0), refusing)


LARGE = {
    "add": lambda a: a + 3,
    "sub": lambda a: a - 3,
    "index": lambda a: jnp.array([1.0, 2.0, 7.0])[a],
    "next": lambda a: jnp.array([1.0, 2.0, 7.0])[a + 1],
    "before": lambda a: jnp.array([1.0, 2.0, 7.0])[a - 1],
    "filled": lambda a: jnp.array([1.0, 2.0, 7.0]).at[a].get(mode="fill", fill_value=-1),
    "clipped": lambda a: jnp.array([1.0, 2.0, 7.0]).at[a].get(mode="clip"),
    "written": lambda a: jnp.array([1.0, 2.0, 7.0]).at[a[0]].set(9.0),
    "dropped": lambda a: jnp.array([1.0, 2.0, 7.0]).at[a].add(9.0, mode="drop"),
    "slice": lambda a: lax.dynamic_slice(jnp.arange(9.0), (a[0],), (4,)),
    "update": lambda a: lax.dynamic_update_slice(jnp.arange(9.0), jnp.ones(2), (a[0],)),
    "mod": lambda a: a % 7,
    "rem": lambda a: lax.rem(a, jnp.full_like(a, 7)),
    "clip": lambda a: jnp.clip(a, 1, 100),
    "compare": lambda a: jnp.stack([a < 3, a <= 3, a > 3, a >= 3, a == 3, a != 3]),
    "sign": lax.sign,
    "as truth": lambda a: a.astype(bool),
    "extremes": lambda a: jnp.stack([jnp.maximum(a, 3), jnp.minimum(a, 3)]),
    "same": lambda a: a,
    "switch": lambda a: lax.switch(a[0], [jnp.sin, jnp.cos, lambda x: x], jnp.float64(2.0)),
    **{f"as {t}": lambda a, t=t: a.astype(t) for t in INTEGERS},
}
MIXED = {
    "square": lambda a: a * a,
    "half": lambda a: a // 2,
    "sum": lambda a: a[:1] + a[1:2],
    "difference": lambda a: a[0] - a[1],
    "equal": lambda a: a[0] == a[1],
    "moved twice": lambda a: (a + 1) + 1,
    "other sign": lambda a: -a,
    "size": abs,
    "shifted": lambda a: a >> 1,
    "bits": lambda a: a & 3,
    "count": lax.population_count,
}


@pytest.mark.parametrize("t", ["int32", "uint32", "int64", "uint64"])
def test_integers_from_floats_of_any_size(t):
    """A float beyond the integers becomes the nearest one; what cannot be told then is refused."""
    cases = {n: lambda x, f=f: f(x.astype(t)) for n, f in (LARGE | MIXED).items()}
    refusing = {
        "int32": ["as uint64", "square", "shifted", "bits", "count"],
        "uint32": ["square", "shifted", "bits", "count"],
        "int64": ["as uint64", *MIXED],
        "uint64": ["add", "sub", "before", "as int64", *(n for n in MIXED if n != "size")],
    }
    # Of one compiled in company with others XLA makes a negative number of an unsigned one.
    if t == "int32":
        cases.pop("as uint32")
    assert_equal(cases, refusing[t])
