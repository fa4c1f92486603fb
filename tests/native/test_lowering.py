"""Functions lowered to C give what JAX gives, and what cannot be lowered is refused by name."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sigmax.native import Graph, Program, Refused, evaluate
from sigmax.native.driver import RowsJob, driver, over_cores, pointer, series, steps
from sigmax.native.emit import lanes_source

jax.config.update("jax_enable_x64", True)
ROWS = 21  # not a multiple of any number of lanes


def lowered(function, *sizes):
    g = Graph()
    flat = g.inputs("given", (sum(sizes),))
    parts = np.split(flat, np.cumsum(sizes)[:-1])
    traced = jax.make_jaxpr(function)(*[jax.ShapeDtypeStruct((k,), jnp.float64) for k in sizes])
    (out,) = evaluate(g, traced, parts)
    return Program(g, ("given",), {"made": list(np.ravel(out)), "told": [g.constant(0.0)]})


def compiled(function, *sizes, alone=False):
    """A function of vectors, as a function of rows that hold them one after the other; of one row if `alone`."""
    program = lowered(function, *sizes)
    (step,) = steps([(None, lambda: program)], single=False, alone=alone)
    constants = step.setup(np.zeros(1))

    def call(rows):
        rows = np.ascontiguousarray(rows)
        made = np.empty((len(rows), len(program.outputs["made"])))
        job = RowsJob(step.address, pointer(constants), series(rows, 1, True, False), made.shape[1], pointer(made))
        over_cores(driver(False, alone)["rows"], job, len(rows), False)
        return made

    return call


def agree(function, rows, rtol=1e-13):
    made = compiled(function, rows.shape[1])(rows)
    wanted = np.asarray(jax.jit(jax.vmap(function))(rows), float).reshape(len(rows), -1)
    np.testing.assert_allclose(made, wanted, rtol=rtol, atol=1e-300, equal_nan=True)
    one = compiled(function, rows.shape[1], alone=True)
    for k in range(0, len(rows), 5):
        assert np.array_equal(one(rows[k : k + 1])[0], made[k], equal_nan=True)


def rows(seed=0, columns=4, scale=2.0):
    return scale * np.random.default_rng(seed).standard_normal((ROWS, columns))


TABLE = np.sin(np.arange(17.0))


def smoothed_table(x):
    at = jnp.clip(jnp.floor(jnp.abs(x) * 3).astype(int), 0, 15)
    part = jnp.abs(x) * 3 - at
    return jnp.asarray(TABLE)[at] * (1 - part) + jnp.asarray(TABLE)[at + 1] * part


def terrain(x):
    grid = jnp.asarray(np.outer(np.cos(np.arange(6.0)), np.arange(5.0)))
    row, column = (jnp.clip(jnp.abs(x[i]).astype(int), 0, most) for i, most in ((0, 4), (1, 3)))
    return grid[row, column] + grid[row + 1, column] * x[2] + jax.lax.dynamic_slice(grid, (row, column), (2, 2)).sum()


def looped(x):
    def body(i, state):
        total, power = state
        return total + power / (i + 1.0), power * x

    return jax.lax.fori_loop(0, 6, body, (jnp.zeros_like(x), x))[0]


FUNCTIONS = {
    "arithmetic": lambda x: jnp.stack([x[0] + x[1], x[0] - x[1], x[0] * x[1], x[0] / x[1], -x[2], x[3] / 3]),
    "powers": lambda x: jnp.stack([x[0] ** 3, x[1] ** -2, jnp.abs(x[2]) ** 1.7, jnp.square(x[3]), x[0] ** 0]),
    "roots": lambda x: jnp.concatenate([jnp.sqrt(jnp.abs(x)), jax.lax.rsqrt(jnp.abs(x)), jnp.cbrt(x)]),
    "trigonometry": lambda x: jnp.concatenate([jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan(x)]),
    "inverse": lambda x: jnp.concatenate([jnp.arcsin(x / 9), jnp.arccos(x / 9), jnp.arctan2(x, x[::-1])]),
    "hyperbolic": lambda x: jnp.concatenate(
        [jnp.sinh(x), jnp.cosh(x), jnp.tanh(x), jnp.arcsinh(x), jnp.arccosh(2 + x**2), jnp.arctanh(x / 9)]
    ),
    "exponentials": lambda x: jnp.concatenate([jnp.exp(x), jnp.exp2(x), jnp.expm1(x), jnp.log(jnp.abs(x))]),
    "logarithms": lambda x: jnp.concatenate([jnp.log1p(jnp.abs(x)), jnp.log10(jnp.abs(x)), jnp.logaddexp(x, x[::-1])]),
    "special": lambda x: jnp.concatenate(
        [jax.scipy.special.erf(x), jax.scipy.special.erfc(x), jax.scipy.special.gammaln(jnp.abs(x) + 0.1)]
    ),
    "logistic": lambda x: jnp.concatenate([jax.nn.sigmoid(x), jax.nn.softplus(x), jax.nn.relu(x)]),
    "rounding": lambda x: jnp.concatenate([jnp.floor(x), jnp.ceil(x), jnp.round(x), jnp.trunc(x), jnp.sign(x)]),
    "away from zero": lambda x: jax.lax.round(4 * x) / 4,
    "remainders": lambda x: jnp.concatenate([x % 1.3, jnp.fmod(x, 0.7), jnp.floor_divide(x, 0.6), jnp.mod(x, -2.0)]),
    "comparisons": lambda x: jnp.where((x > x[::-1]) & ~(x < 0) | (x == x[0]), x, x**2),
    "exclusive": lambda x: jnp.where((x > 0) ^ (x[::-1] > 0), x, -x),
    "choices": lambda x: jnp.select([x < -1, x < 0, x < 1], [x, 2 * x, 3 * x], 4 * x),
    "pieces": lambda x: jnp.piecewise(x, [x < 0, x >= 0], [jnp.sin, jnp.cos]),
    "extremes": lambda x: jnp.concatenate([jnp.maximum(x, 0.3), jnp.minimum(x, x[0]), jnp.clip(x, -1, 1)]),
    "reductions": lambda x: jnp.stack([x.sum(), x.prod(), x.max(), x.min(), x.mean(), x.var(), jnp.linalg.norm(x)]),
    "truth": lambda x: jnp.stack([(x > 0).all(), (x > 0).any(), (x > 0).sum() > 2]).astype(float),
    "places": lambda x: jnp.stack([jnp.argmax(x), jnp.argmin(x)]).astype(float),
    "running": lambda x: jnp.concatenate([jnp.cumsum(x), jnp.cumprod(x), jax.lax.cummax(x), jnp.diff(x)]),
    "products": lambda x: x.reshape(2, 2) @ x.reshape(2, 2).T @ jnp.ones(2),
    "einsum": lambda x: jnp.einsum("ij,jk,ik->i", x.reshape(2, 2), x.reshape(2, 2), x.reshape(2, 2)),
    "shapes": lambda x: jnp.roll(jnp.pad(x, (1, 2), constant_values=5), 2)[::-1].reshape(7, 1).T.ravel(),
    "indexing": lambda x: x[jnp.array([3, 0, 0])] * x.at[1].set(7.0).at[jnp.array([0, 2])].add(1.0)[:3],
    "computed index": lambda x: x[jnp.clip(jnp.abs(x[0]).astype(int), 0, 3)] * jnp.ones(2),
    "computed write": lambda x: x.at[jnp.clip(jnp.abs(x[0]).astype(int), 0, 3)].set(9.0),
    "outside": lambda x: jnp.asarray(TABLE).at[(10 * jnp.abs(x)).astype(int)].get(mode="fill", fill_value=-1.0),
    "table": smoothed_table,
    "terrain": terrain,
    "interpolation": lambda x: jnp.interp(x, jnp.linspace(-3, 3, 9), jnp.asarray(TABLE[:9])),
    "loop": looped,
    "scan": lambda x: jax.lax.scan(lambda c, a: (c * 0.5 + a, c - a), 1.0, x)[1],
    "reversed scan": lambda x: jax.lax.scan(lambda c, a: (c * 0.5 + a, c - a), 1.0, x, reverse=True)[1],
    "branches": lambda x: jax.lax.cond(x[0] > 0, jnp.sin, lambda y: y * y, x),
    "switch": lambda x: jax.lax.switch(jnp.abs(x[0]).astype(int), [jnp.sin, jnp.cos, jnp.exp], x),
    "map": lambda x: jax.lax.map(lambda a: a * jnp.abs(a), x),
    "derivative": lambda x: jax.jacfwd(lambda y: jnp.sin(y) * y.sum())(x).ravel(),
    "reverse derivative": lambda x: jax.grad(lambda y: (jnp.arctan2(y[0], y[1]) * jnp.exp(y[2] / 5)).sum())(x),
    "second derivative": lambda x: jax.hessian(lambda y: jnp.sqrt(1 + (y * y).sum()))(x).ravel(),
    "factorisation": lambda x: jnp.linalg.cholesky(jnp.outer(x, x) + 9 * jnp.eye(4)).ravel(),
    "triangles": lambda x: jax.scipy.linalg.solve_triangular(jnp.tril(jnp.outer(x, x)) + 9 * jnp.eye(4), x, lower=True),
    "positive solution": lambda x: jax.scipy.linalg.cho_solve(
        (jnp.linalg.cholesky(jnp.outer(x, x) + 9 * jnp.eye(4)), True), x
    ),
    "hypot": lambda x: jnp.hypot(x, x[::-1]),
    "quaternion": lambda x: x / jnp.linalg.norm(x) * jnp.sign(x[3]),
    "checkpoint": lambda x: jax.checkpoint(lambda y: jnp.sin(y) ** 2)(x),
    "custom derivative": lambda x: jax.nn.silu(x) + jax.numpy.sinc(x),
    "sums of rounded numbers": lambda x: jnp.floor(jnp.clip(x, 0, 3)).sum().astype(int)[None] * 2,
    "integers": lambda x: (jnp.arange(4) * 2 // 3 + jnp.floor(x).astype(int) % 3).astype(float),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.one_in(4)
def test_every_kind_of_operation_is_lowered(name):
    agree(FUNCTIONS[name], rows(), rtol=1e-12)


def test_not_a_number_is_carried_through_as_jax_does():
    special = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1.0, -1.0])
    pairs = np.array([(a, b) for a in special for b in special])

    def function(x):
        a, b = x
        values = [a + b, a * b, a / b, jnp.maximum(a, b), jnp.minimum(a, b), jnp.sign(a), jnp.where(a > b, a, b)]
        flags = [jnp.isnan(a), jnp.isfinite(a), a == b, a != b, a < b, a >= b]
        return jnp.stack([*values, jnp.sqrt(a), jnp.abs(b), *(jnp.where(f, 1.0, 0.0) for f in flags)])

    agree(function, pairs)


UNARY = (jnp.sin, jnp.tanh, jnp.abs, jnp.floor, lambda x: x**2, lambda x: jnp.sqrt(1 + x * x), lambda x: -x)
BINARY = (jnp.add, jnp.subtract, jnp.multiply, jnp.arctan2, jnp.maximum, lambda a, b: jnp.where(a > b, a, b / 3))


@st.composite
def expressions(draw):
    """A random straight line of operations on four numbers."""
    line = st.tuples(st.integers(0, 12), st.integers(0, 99), st.integers(0, 99))
    lines = draw(st.lists(line, min_size=3, max_size=25))

    def function(x):
        values = [*x, jnp.float64(0.5)]
        for operation, i, j in lines:
            a, b = values[i % len(values)], values[j % len(values)]
            values.append(UNARY[operation](a) if operation < len(UNARY) else BINARY[operation - len(UNARY)](a, b))
        # Bounded, so that nothing overflows on its way.
        return jnp.stack([jnp.tanh(v / 8) for v in values[-6:]])

    return function


@settings(max_examples=12, deadline=None)
@given(expressions(), st.integers(0, 1000))
def test_random_functions_are_lowered(function, seed):
    made = compiled(function, 4)(rows(seed))
    wanted = np.asarray(jax.jit(jax.vmap(function))(rows(seed)))
    # Where a comparison or a step hangs on the last bit the two may differ: then JAX differs from itself too.
    nudged = np.asarray(jax.jit(jax.vmap(function))(rows(seed) * (1 + 1e-15)))
    sure = np.abs(nudged - wanted) < 1e-9
    np.testing.assert_allclose(made[sure], wanted[sure], rtol=1e-9, atol=1e-9)


def test_equal_expressions_are_made_once_and_zeros_cost_nothing():
    g = Graph()
    x, y = g.inputs("given", (2,))
    zero, one = g.constant(0.0), g.constant(1.0)
    assert g.apply("+", x, y) is g.apply("+", y, x)
    assert g.apply("*", x, zero) is zero
    assert g.apply("*", one, g.apply("+", x, zero)) is x
    assert g.apply("-", y, g.apply("negative", x)) is g.apply("+", x, y)
    assert g.apply("sqrt", g.constant(4.0)).value == 2.0
    first, second = g.apply("/", x, y), g.apply("/", one, y)
    assert g.apply("/", x, y) is first
    assert g.apply("/", g.constant(3.0), y) is g.apply("*", second, g.constant(3.0))
    p = g.apply("<", x, y)
    assert g.apply(">", g.apply("select", p, one, zero), g.constant(0.5)) is p
    assert g.apply("select", g.apply("not", p), x, y) is g.apply("select", p, y, x)


def test_a_diagonal_matrix_costs_what_its_diagonal_costs():
    def product(x):
        return jnp.diag(x) @ x

    assert lowered(product, 4).operations == 4


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (jnp.sort, "'sort' cannot be lowered"),
        (lambda x: jnp.fft.fft(x).real, "complex128 cannot be lowered"),
        (lambda x: jax.lax.while_loop(lambda y: y.sum() < 5, lambda y: y + 1, x), "length depends on the data"),
        (lambda x: jnp.linalg.eigh(jnp.outer(x, x))[0], "cannot be lowered"),
    ],
)
def test_what_is_not_covered_is_refused_by_name_and_line(function, says):
    def model(x):
        return function(x)

    with pytest.raises(Refused, match=says) as caught:
        lowered(model, 4)
    assert "test_lowering.py, line" in str(caught.value)


def test_lanes_do_not_depend_on_their_neighbours():
    call = compiled(lambda x: jnp.stack([jnp.sin(x[0]) * jnp.arctan2(x[1], x[2]), jnp.exp(x[3]) / x[0]]), 4)
    many = rows(3)
    together = call(many)
    assert np.array_equal(together, np.concatenate([call(many[i : i + 1]) for i in range(ROWS)]))


@pytest.mark.parametrize("above", [-1e9, 0.0, 1e9])
def test_sides_of_choices_that_nobody_takes_are_left_out_and_change_nothing(above):
    def longer(x):
        for k in range(30):
            x = jnp.sqrt(x * x + k)
        return x

    def function(x):
        first = jax.lax.cond(x[0] > above, lambda: longer(x), lambda: x)
        second = jax.lax.cond(x[1] > above, lambda: longer(first) + longer(2 * x), lambda: longer(3 * first))
        return jax.lax.cond(
            (x[0] > above) & (x[2] > 0),
            lambda: jax.lax.cond(x[3] > 0, lambda: longer(second + 1), lambda: longer(second + 2)),
            lambda: second,
        )

    agree(function, rows(5))
    source = lanes_source(lowered(function, 4), {})
    assert source.count("if (v_any(") >= 5
    assert source.count("&&") >= 2


def test_the_driver_is_laid_out_as_its_c(tmp_path):
    # A size that differs would show as garbage much later.
    assert ctypes.sizeof(RowsJob) == 9 * 8
