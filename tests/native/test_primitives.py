"""Every primitive with its parameters and types, lowered to C, gives what JAX gives bit for bit, or is refused."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from sigmax.native import Graph, Program, Refused, evaluate
from sigmax.native.driver import RowsJob, driver, over_cores, pointer, series, steps

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


def both(cases, dtype=np.float64, rows=None, whole=True):
    """What the compiled C and JAX give for the cases that are not refused, and why the others are.

    All cases are one program, in JAX too unless `whole` is false: (native, JAX) by name, and the refusals by name.
    """
    rows = np.ascontiguousarray(given(dtype) if rows is None else rows)
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
    job = RowsJob(step.address, pointer(constants), series(rows, 1, True, False), len(made), pointer(native))
    over_cores(driver(single)["rows"], job, len(rows), single)
    each = jax.vmap(lambda x: tuple(flat(x) for flat, _ in lowered.values()))
    by_jax = jax.jit(each)(rows) if whole else each(rows)
    wanted = {name: np.asarray(w) for name, w in zip(lowered, by_jax, strict=True)}
    return {name: (native[:, where], wanted[name]) for name, (_, where) in lowered.items()}, refused


def assert_equal(cases, refusing=(), dtype=np.float64, rtol=0.0, rows=None, zeros=True, whole=True):
    """Bit for bit with `rtol` 0, the signs of zeros included; `refusing` are the names that must be refused."""
    compared, refused = both(cases, dtype, rows, whole)
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
    "from zero": lambda x: 1 / (0.0 - x),
    "minus a difference": lambda x: -(x - x[0]),
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
    "sum": lambda a, b: lax.reduce_sum(jnp.stack([a, b, a]), (0,)),
    "product": lambda a, b: lax.reduce_prod(jnp.stack([a, b]), (0,)),
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
@pytest.mark.one_in(2)
def test_small_integers(t):
    beyond = ("neg", "not", "minus", "sub", "div", "floor div") if t == "uint64" else ()
    assert_equal(integers_of(t, 300.0), [f"{t} {n}" for n in beyond])


def test_integers_as_another_type():
    """JAX goes from type to type one at a time: by two in one program XLA takes uint32(int32(-2)) for -2."""
    cases = {
        f"{a} as {b}": lambda x, a=a, b=b: jnp.clip(x[:1], -300.0, 300.0).astype(a).astype(b)
        for a in INTEGERS
        for b in INTEGERS
    }
    assert_equal(cases, [f"{a} as uint64" for a in INTEGERS if a.startswith("int")], whole=False)


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


def grid(x):
    """The numbers as a matrix."""
    return x.reshape(2, 4)


def windows(x, mode, **about):
    numbers = lax.GatherDimensionNumbers(offset_dims=(1,), collapsed_slice_dims=(0,), start_index_map=(0, 1))
    at = jnp.array([[0, 1], [1, 3], [-1, 0], [5, 2]])
    return lax.gather(grid(x), at, numbers, (1, 2), mode=mode, **about)


def scattered(function, mode, x):
    numbers = lax.ScatterDimensionNumbers(
        update_window_dims=(), inserted_window_dims=(0,), scatter_dims_to_operand_dims=(0,)
    )
    at = jnp.array([[0], [0], [7], [9], [-1]])
    return function(x, at, x[:5], numbers, mode=mode)


def computed(x, most):
    return jnp.clip(jnp.abs(x).astype(int), 0, most)


MODES = [lax.GatherScatterMode.CLIP, lax.GatherScatterMode.FILL_OR_DROP]
PADS = ((1, 0, 1), (0, 2, 0)), ((-1, 0, 0), (2, -3, 2))
MOVING = {
    **{f"reshape {d}": lambda x, d=d: lax.reshape(grid(x), (8,), dimensions=d) for d in (None, (0, 1), (1, 0))},
    **{f"ravel {o}": lambda x, o=o: x.reshape(2, 2, 2).ravel(order=o) for o in "CF"},
    **{f"transpose {p}": lambda x, p=p: lax.transpose(x.reshape(2, 2, 2), p) for p in ((2, 0, 1), (1, 0, 2))},
    **{f"rev {d}": lambda x, d=d: lax.rev(grid(x), d) for d in ((), (0,), (1,), (0, 1))},
    **{
        f"pad {c}": lambda x, c=c: lax.pad(grid(x), x[0], c) for c in (((1, 0, 1), (0, 2, 0)), ((-1, 0, 0), (2, -3, 2)))
    },
    **{f"slice {s}": lambda x, s=s: lax.slice(grid(x), (0, 1), (2, 4), s) for s in (None, (1, 2), (2, 3))},
    **{f"concatenate {a}": lambda x, a=a: lax.concatenate([grid(x), jnp.ones((2, 4)), grid(-x)], a) for a in (0, 1)},
    "broadcast": lambda x: lax.broadcast_in_dim(x, (2, 8, 3), (1,)),
    "tile": lambda x: jnp.tile(grid(x), (2, 3)),
    "squeeze": lambda x: lax.squeeze(x.reshape(1, 8, 1), (0, 2)),
    "split": lambda x: jnp.concatenate(jnp.split(x, [1, 5])[::-1]),
    "of truth": lambda x: jnp.pad(grid(x > 0), 1, constant_values=True)[::-1, ::2],
    "known": lambda x: x + jnp.concatenate([jnp.arange(3.0), jnp.pad(jnp.ones(2), (2, 1))])[::-1],
    "known integers": lambda x: x * jnp.array(np.arange(1, 9, dtype=np.int32) * 2**30),
    **{
        f"iota {t}": lambda x, t=t: lax.broadcasted_iota(t, (8,), 0).astype(float) * 300 + x
        for t in ("int8", "float32", "uint64")
    },
    "roll": lambda x: jnp.roll(grid(x), (1, -1), (0, 1)),
}
INDEXED = {
    **{f"gather {m.name}": lambda x, m=m: windows(x, m) for m in MODES},
    "gather filled": lambda x: windows(x, lax.GatherScatterMode.FILL_OR_DROP, fill_value=-3.0),
    "gather truth": lambda x: (
        jnp.array([True, False]).at[jnp.array([0, 5])].get(mode="fill", fill_value=False) & (x[:2] > 0)
    ),
    "gather batched": lambda x: jax.vmap(lambda row, i: row[i])(grid(x), computed(x[:2], 3)),
    "take along": lambda x: jnp.take_along_axis(grid(x), computed(grid(x[::-1])[:, :1], 3), axis=1),
    "dynamic slice": lambda x: lax.dynamic_slice(grid(x), (computed(x[0], 9) - 4, computed(x[1], 9) - 4), (1, 2)),
    "dynamic update": lambda x: lax.dynamic_update_slice(grid(x), -grid(x)[:1, :2], (computed(x[0], 9) - 4, 3)),
    **{
        f"{f.__name__} {m.name}": lambda x, f=f, m=m: scattered(f, m, x)
        for m in MODES
        for f in (lax.scatter, lax.scatter_add, lax.scatter_mul, lax.scatter_min, lax.scatter_max)
        if not (f is lax.scatter and m == MODES[0])
    },
    "scatter computed": lambda x: x.at[computed(x[:3], 9)].add(x[3:6]),
    "scatter truth": lambda x: (x > 0).at[computed(x[0], 7)].set(x[1] > 0),
    "switch": lambda x: lax.switch(x[0].astype(int), [lambda y: y, lambda y: -y, lambda y: y + 1], x),
    "select of many": lambda x: lax.select_n(computed(x, 2), x, -x, x + 1),
    "cond": lambda x: lax.cond(x[0] > x[1], lambda y: (y, y > 0), lambda y: (-y, y < 0), x)[0],
    "apply": lambda x: x.at[jnp.array([0, 2])].apply(lambda y: y * y),
}
LOOPS = {
    **{
        f"scan reverse={r} unroll={u}": lambda x, r=r, u=u: jnp.stack(
            lax.scan(lambda c, a: (c * 0.5 + a, (c, -a)), x[0], x, reverse=r, unroll=u)[1]
        )
        for r in (False, True)
        for u in (1, 3)
    },
    "scan of nothing": lambda x: lax.scan(lambda c, _: (c * 0.5, c), x, None, length=3)[1],
    "scan of length 0": lambda x: lax.scan(lambda c, a: (c, a), x, jnp.zeros((0, 2)))[0],
    "scan with integers": lambda x: lax.scan(lambda i, a: (i + 1, a * i), 1, x)[1],
    "while known": lambda x: lax.while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, s[1] * 2), (0, x))[1],
    "for": lambda x: lax.fori_loop(0, 5, lambda i, y: y.at[i].set(y[i + 1] * 2), x),
    "map": lambda x: lax.map(lambda a: a * 2, x),
    "jit": lambda x: jax.jit(lambda y, k: y * k, static_argnums=1)(x, 3),
    "remat": lambda x: jax.checkpoint(lambda y: y * y)(x),
    "vmap": lambda x: jax.vmap(lambda a, b: a * b, in_axes=(1, 1))(grid(x), grid(x[::-1])),
}


def without_infinities():
    """Rows of which sums do not depend on the order."""
    return np.round(given(np.float64)[:60, 2:] * 8)[:, [0, 1, 2, 3, 4, 5, 0, 3]]


# Axes that are summed over, and axes side by side.
PRODUCTS = (
    (((2,), (1,)), ((0,), (0,))),
    (((0, 1), (2, 0)), ((), ())),
    (((), ()), ((1,), (2,))),
    (((0, 1, 2), (0, 1, 2)), ((), ())),
)
SUMS = {
    **{f"sum {a}": lambda x, a=a: grid(x).sum(a) for a in (None, 0, 1, (0, 1), ())},
    **{f"prod {a}": lambda x, a=a: grid(jnp.clip(x, -3, 3)).prod(a) for a in (0, 1)},
    **{f"max {a}": lambda x, a=a: jnp.stack([grid(x).max(a), grid(x).min(a)]) for a in (0, 1)},
    **{
        f"truth {a}": lambda x, a=a: jnp.stack([grid(x > 0).all(a), grid(x > 0).any(a), jnp.max(grid(x > 0), a)])
        for a in (0, 1)
    },
    **{f"argmax {a}": lambda x, a=a: jnp.stack([jnp.argmax(grid(x), a), jnp.argmin(grid(x), a)]) for a in (0, 1)},
    **{f"argmax as {t}": lambda x, t=t: lax.argmax(x, 0, t) for t in ("int32", "int64", "uint8")},
    **{
        f"{f.__name__} {a} {r}": lambda x, f=f, a=a, r=r: f(grid(jnp.clip(x, -3, 3)), axis=a, reverse=r)
        for f in (lax.cumsum, lax.cumprod, lax.cummax, lax.cummin)
        for a in (0, 1)
        for r in (False, True)
    },
    **{
        f"dot {d}": lambda x, d=d: lax.dot_general(x.reshape(2, 2, 2), -x.reshape(2, 2, 2), d)
        for d in (
            (((2,), (1,)), ((0,), (0,))),
            (((0, 1), (2, 0)), ((), ())),
            (((), ()), ((1,), (2,))),
            (((0, 1, 2), (0, 1, 2)), ((), ())),
        )
    },
    "scalar products": lambda x: jnp.stack(
        [x @ x, jnp.vdot(x, x), jnp.inner(x, x), jnp.tensordot(x, x, 1), jnp.einsum("i,i->", x, x)]
    ),
    "product with a number": lambda x: lax.dot_general(x, x[0], (((), ()), ((), ()))),
    "truth times integers": lambda x: (x > 0) @ jnp.arange(8),
    "counted": lambda x: jnp.stack([(x > 0).sum(), jnp.count_nonzero(x), jnp.cumsum(x > 0)[3]]),
    "preferred": lambda x: lax.dot_general(x, x, (((0,), (0,)), ((), ())), preferred_element_type=jnp.float64),
    "preferred narrow": lambda x: lax.dot_general(x, x, (((0,), (0,)), ((), ())), preferred_element_type=jnp.float32),
    "mean of integers": lambda x: jnp.mean(jnp.clip(x, -9, 9).astype(int)),
}
NARROW = {
    **{f"as {t}": lambda x, t=t: x.astype(t) for t in ("float32", "float16", "bfloat16", "complex64")},
    "reduced": lambda x: lax.reduce_precision(x, 8, 23),
    "complex": lambda x: (x + 1j * x).imag,
    "sort": jnp.sort,
    "bits": lambda x: lax.bitcast_convert_type(x, jnp.int64),
    "next": lambda x: lax.nextafter(x, x + 1),
    "while": lambda x: lax.while_loop(lambda y: y.sum() < 5, lambda y: y + 1, x),
    "while of each": jax.vmap(lambda a: lax.while_loop(lambda y: y < 5, lambda y: y + 1, a)),
    "fft": lambda x: jnp.fft.fft(x).real,
    "random": lambda x: x + jax.random.normal(jax.random.key(x[0].astype(int)), (8,)),
    "top": lambda x: lax.top_k(x, 2)[0],
    "applied": lambda x: lax.scatter_apply(
        x, jnp.array([[0]]), jnp.sin, lax.ScatterDimensionNumbers((), (0,), (0,)), update_shape=(1,)
    ),
}
FIXED = {
    "random": lambda x: x + jax.random.normal(jax.random.key(3), (8,)),
    "single": lambda x: x + jnp.asarray(np.linspace(0, 1, 8), jnp.float32),
    "half": lambda x: x + jnp.bfloat16(0.1),
    "sorted": lambda x: x * jnp.sort(jnp.array([3.0, 1.0, 2.0])[jnp.arange(8) % 3]),
    "bits": lambda x: x * (jnp.array([5, 6]) & 3)[0] + (jnp.uint8(200) + jnp.uint8(100)),
    "fft": lambda x: x * jnp.abs(jnp.fft.fft(jnp.arange(8.0))),
    "inverse": lambda x: jnp.linalg.inv(jnp.diag(jnp.arange(1.0, 9))) @ x,
    "choice in single": lambda x: jnp.where(x > 0, jnp.float32(0.1), jnp.float32(0.2)) * x,
    "large map": lambda x: x + jnp.zeros((60, 60)).at[:8, 0].set(x)[:8, 0] + jnp.concatenate([jnp.ones(5000), x])[-8:],
}


@pytest.mark.parametrize("cases", [MOVING, INDEXED, LOOPS], ids=["moving", "indexed", "loops"])
def test_what_moves_elements_and_calls_functions(cases):
    assert_equal(cases, ["apply"] if cases is INDEXED else (), rtol=1e-14)


def test_sums_and_products_of_whole_numbers():
    assert_equal(SUMS, ["preferred narrow"], rows=without_infinities(), zeros=False)


def test_what_is_narrower_or_has_no_rule_is_refused():
    assert_equal(NARROW | {"fine": lambda x: x}, NARROW)


def test_known_numbers_are_computed_in_their_own_type():
    assert_equal(FIXED, rtol=1e-14, rows=without_infinities())


def positive(x):
    return jnp.outer(x[:3], x[:3]) + 9 * jnp.eye(3)


MATRICES = {
    "cholesky": lambda x: lax.linalg.cholesky(positive(x), symmetrize_input=False),
    "not positive": lambda x: lax.linalg.cholesky(jnp.outer(x[:2], x[:2]) - jnp.eye(2)),
    "batch": lambda x: jax.vmap(lambda a: jnp.linalg.cholesky(positive(a)))(grid(x)),
    **{
        f"solve {f}": lambda x, f=f: lax.linalg.triangular_solve(
            positive(x),
            x[:6].reshape(3, 2) if f[0] else x[:6].reshape(2, 3),
            left_side=f[0],
            lower=f[1],
            transpose_a=f[2],
            unit_diagonal=f[3],
        )
        for f in product((False, True), repeat=4)
    },
    "solve batch": lambda x: jax.vmap(lambda a: jax.scipy.linalg.solve_triangular(positive(a), a[:3], lower=True))(
        grid(x)
    ),
}


def test_factors_and_triangles():
    assert_equal(MATRICES, rtol=1e-9, rows=without_infinities() / 8)
