"""Half-steps as loops: what JAX, NumPy and straight lines compute, and alone the bits of a batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sigmax
from sigmax.algebra import arrays, factor
from sigmax.algebra.kernel import kernels
from sigmax.engine import half_step_trace
from sigmax.filters import names
from sigmax.native import Graph, Refused
from sigmax.native.driver import RowsJob, driver, over_cores, pointer, series, steps
from sigmax.native.loops import flat, operations, written
from sigmax.native.loops.views import Memory, fused, walk
from sigmax.native.machine import vector_functions
from tests.native.test_lowering import FUNCTIONS, ROWS

N, M = 6, 3
Q = np.diag(np.full(N, 0.01)) + 0.001
rng = np.random.default_rng(0)
Z = rng.normal(1.0, 0.3, (3, 5, M))
Z[1, 2, 1] = np.nan
PRIOR = sigmax.Gaussian(np.ones(N), np.eye(N))


def motion(x, dt):
    return x + dt * 0.1 * jnp.sin(jnp.roll(x, -1)) * jnp.cos(x) - 0.05 * dt * x


def sensor(x):
    return jnp.stack([jnp.sqrt(1 + x[0] ** 2 + x[1] ** 2), jnp.arctan2(x[2], x[3] + 3), x[4]])


MODEL = sigmax.Model(motion=motion, sensor=sensor, Q=Q, R=np.full(M, 0.1))


def loops(function, size):
    """A function of a vector as loops, and how many numbers it gives."""
    g = Graph()
    with kernels():
        closed = jax.make_jaxpr(function)(jax.ShapeDtypeStruct((size,), jnp.float64))

    def made(out):
        return {"made": list(out[0].flat), "told": [g.constant(0.0)]}

    arguments = [g.inputs("given", (size,))]
    return written(flat(closed), arguments, ("given",), made, np.float64, vector_functions(False)), closed.out_avals[
        0
    ].size


def compiled(function, size, alone=False):
    program, count = loops(function, size)
    (step,) = steps([(None, lambda: program)], single=False, alone=alone)
    constants = step.setup(np.zeros(1))

    def call(rows):
        rows = np.ascontiguousarray(rows)
        made = np.empty((len(rows), count))
        job = RowsJob(
            *(step.address, pointer(constants), series(rows, 1, True, False), count, pointer(made), step.workspace)
        )
        over_cores(driver(False, alone)["rows"], job, len(rows), False)
        return made

    return call


def test_every_kind_of_operation_is_written_as_jax_computes_it():
    def together(x):
        return jnp.concatenate([jnp.ravel(f(x)).astype(float) for f in FUNCTIONS.values()])

    rows = 2 * np.random.default_rng(1).standard_normal((ROWS, 4))
    made, wanted = compiled(together, 4)(rows), np.asarray(jax.jit(jax.vmap(together))(rows))
    at = 0
    for name, function in FUNCTIONS.items():
        size = jax.eval_shape(lambda x, f=function: jnp.ravel(f(x)), rows[0]).size
        np.testing.assert_allclose(
            made[:, at : at + size], wanted[:, at : at + size], rtol=1e-12, atol=1e-300, err_msg=name
        )
        at += size
    alone = compiled(together, 4, alone=True)
    assert all(np.array_equal(alone(rows[k : k + 1])[0], made[k], equal_nan=True) for k in range(0, ROWS, 5))


@pytest.mark.parametrize(("n", "k"), [(5, 9), (11, 19)])
def test_the_algebra_is_what_numpy_computes(n, k):
    """Sizes beside every block and tile; the judge is LAPACK."""
    m = n - 2
    sizes = (n, n), (n, k), (m, k), (k, m)
    bounds = np.cumsum([a * b for a, b in sizes])

    def parts(x):
        return [p.reshape(s) for p, s in zip(jnp.split(x, bounds[:-1]), sizes, strict=True)]

    def function(x):
        L, A, B, C = parts(x)
        L = jnp.where(np.tri(n, dtype=bool), L, 0) + 3 * jnp.eye(n)
        whole = factor.absorb(L, A, B)
        plain = factor.absorb(factor.Diagonal(jnp.abs(A[:, 0])), A, B[:0]).factor
        less, sound = factor.downdate(whole.factor, A)
        one, _ = factor.downdate(whole.factor, A[:, :1])
        root, definite = factor.cholesky(arrays.outer(A, A))
        results = [*whole, plain, less, one, root, factor.tria(A), factor.solve_lower(L, A), factor.inverse_lower(L)]
        results += [arrays.product(A, C), arrays.inner(A, L), arrays.times(A, C[:, 0]), sound, definite]
        return jnp.concatenate([jnp.ravel(r).astype(float) for r in results])

    def judged(x):
        L, A, B, C = (np.asarray(p) for p in parts(x))
        L = np.tril(L) + 3 * np.eye(n)
        P = L @ L.T + A @ A.T
        S = np.linalg.cholesky(P)
        cross = B @ A.T @ np.linalg.inv(S).T
        squares = [
            S,
            cross,
            B @ B.T - cross @ cross.T,
            np.diag(A[:, 0] ** 2) + A @ A.T,
            L,
            P - np.outer(A[:, 0], A[:, 0]),
        ]
        squares += [A @ A.T, A @ A.T, np.linalg.solve(L, A), np.linalg.inv(L), A @ C, A.T @ L, A @ C[:, 0], 1.0, 1.0]
        return squares

    rows = np.random.default_rng(2).standard_normal((ROWS, int(bounds[-1])))
    shapes = [
        (n, n),
        (m, n),
        (m, k),
        (n, n),
        (n, n),
        (n, n),
        (n, n),
        (n, n),
        (n, k),
        (n, n),
        (n, m),
        (k, n),
        (n,),
        (),
        (),
    ]
    for row, made in zip(rows, compiled(function, int(bounds[-1]))(rows), strict=True):
        pieces = np.split(made, np.cumsum([int(np.prod(s)) for s in shapes])[:-1])
        found = [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]
        # The rest, and factors that are not given by a Cholesky factor themselves, are compared by their squares.
        for place in (2, 3, 5, 6, 7):
            if place != 2:
                assert not found[place][np.triu_indices(n, 1)].any()
            found[place] = found[place] @ found[place].T
        for got, wanted in zip(found, judged(row), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)


def both(monkeypatch, compute):
    """What is computed by loops, and by straight lines."""
    with monkeypatch.context() as patch:
        patch.setattr(half_step_trace, "LONGEST", 0)
        patch.setattr(half_step_trace.HalfStepTrace, "straight", None)
        looped = compute()
    with monkeypatch.context() as patch:
        patch.setattr(half_step_trace, "LONGEST", np.inf)
        patch.setattr(half_step_trace.HalfStepTrace, "loops", None)
        return looped, compute()


def apart(a, b):
    return max(np.nanmax(np.abs(x - y)) for x, y in ((a.mean, b.mean), (a.cov, b.cov)))


@pytest.mark.parametrize("name", ["SRUKFB", pytest.param("IEKF", marks=pytest.mark.slow)])
def test_a_filter_is_the_same_as_loops_alone_and_in_a_batch(monkeypatch, name):
    def compute():
        result = sigmax.run(name, MODEL, PRIOR, Z, backend="native")
        live = sigmax.Live(name, MODEL, PRIOR, backend="native")
        for z in Z[1]:
            live.step(z, dt=1.0)
        assert np.array_equal(live.mean, result.mean[1, -1])
        assert np.array_equal(live.cov, result.cov[1, -1])
        return result

    a, b = both(monkeypatch, compute)
    assert apart(a, b) < 1e-12
    assert np.array_equal(a.fault, b.fault)
    np.testing.assert_allclose(a.log_likelihood, b.log_likelihood, rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in names() if n != "KF"])
def test_the_catalogue_is_the_same_as_loops(monkeypatch, name):
    a, b = both(monkeypatch, lambda: sigmax.run(name, MODEL, PRIOR, Z, backend="native"))
    assert apart(a, b) < 1e-11
    assert np.array_equal(a.fault, b.fault)


@pytest.mark.slow
def test_inputs_several_sensors_and_smoothers_are_the_same_as_loops(monkeypatch):
    def driven(x, dt, u):
        return motion(x, dt) + dt * jnp.concatenate([u, jnp.zeros(N - 2)])

    model = sigmax.Model(
        motion=driven, sensor={"a": sensor, "b": lambda x: x[4:]}, Q=Q, R={"a": [0.1] * 3, "b": [0.2] * 2}
    )
    z = {"a": Z, "b": Z[:, :, :2]}

    def compute():
        u = np.nan_to_num(Z[:, :, :2])
        result = sigmax.run("SRCKFB", model, PRIOR, z, inputs=u, backend="native")
        return result, sigmax.smooth("SRCKFB", model, result, inputs=u, backend="native")

    (a, smooth_a), (b, smooth_b) = both(monkeypatch, compute)
    assert apart(a, b) < 1e-12
    assert apart(smooth_a, smooth_b) < 1e-11


@pytest.mark.slow
def test_float32_is_as_accurate_as_loops(monkeypatch):
    def compute():
        return sigmax.run("SRCKFB", MODEL, PRIOR, Z, dtype=np.float32, backend="native")

    a, b = both(monkeypatch, compute)
    assert apart(a, b) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("n", [46, 60])
def test_a_large_model_runs_live_as_in_a_batch(n):
    def large(x):
        return jnp.sqrt(1 + x[: n // 3] ** 2 + x[-(n // 3) :] ** 2)

    model = sigmax.Model(motion=motion, sensor=large, Q=np.full(n, 0.01), R=np.full(n // 3, 0.1))
    z = np.random.default_rng(3).normal(1.5, 0.3, (9, 4, n // 3))
    prior = sigmax.Gaussian(np.ones(n), np.eye(n))
    result = sigmax.run("SRCKFB", model, prior, z, backend="native")
    assert result.ok.all()
    live = sigmax.Live("SRCKFB", model, prior, backend="native")
    for row in z[2]:
        live.step(row, dt=1.0)
    assert np.array_equal(live.mean, result.mean[2, -1])
    assert np.array_equal(live.cov, result.cov[2, -1])


def test_what_loops_do_not_cover_is_a_straight_line(monkeypatch):
    monkeypatch.setattr(half_step_trace, "written", lambda *_: (_ for _ in ()).throw(Refused("not covered")))
    g = Graph()
    closed = jax.make_jaxpr(lambda x: jnp.cumsum(x))(jax.ShapeDtypeStruct((4,), jnp.float64))
    made = half_step_trace.HalfStepTrace(
        g, ("given",), closed, [g.inputs("given", (4,))], lambda out: {"made": list(out[0])}
    )
    assert made.chosen(0).operations == 3


def test_what_depends_on_parameters_alone_is_computed_once():
    g = Graph()
    P, x = g.inputs("parameters", (3, 3), fixed=True), g.inputs("given", (3,))

    def function(P, x):
        return arrays.times(factor.cholesky(P)[0], x)

    with kernels():
        closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(s, jnp.float64) for s in ((3, 3), (3,))))
    program = written(
        flat(closed),
        [P, x],
        ("given",),
        lambda out: {"made": list(out[0]), "told": []},
        np.float64,
        vector_functions(False),
    )
    setup, step = program.source.split("void setup")[1].split("void step")
    assert "k_cholesky" in setup
    assert "k_cholesky" not in step


def test_the_estimate_is_of_what_is_computed():
    def count(function, *shapes):
        with kernels():
            return operations(jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(s, jnp.float64) for s in shapes)))

    assert count(lambda x: jnp.sin(x) * 2 + x, (5,)) == 15
    assert count(lambda x: x[::-1].reshape(5, 1).T, (5,)) == 0
    assert count(lambda a, b: a @ b, (3, 4), (4, 5)) == 2 * 3 * 4 * 5
    assert count(arrays.product, (3, 4), (4, 5)) == 2 * 3 * 4 * 5
    assert count(lambda x: x + jnp.cos(jnp.arange(5.0)), (5,)) == 5
    assert count(lambda x: jax.lax.fori_loop(0, 7, lambda i, y: y * x, x), (5,)) >= 7 * 5


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(1, 9)), max_size=40))
def test_memory_is_nobody_elses(wishes):
    memory, held = Memory(), {}
    for free, size in wishes:
        if free and held:
            at = next(iter(held))
            memory.give_back(at, held.pop(at))
        else:
            at = memory.take(size)
            assert all(at + size <= other or other + n <= at for other, n in held.items())
            held[at] = size
        assert all(at + n <= memory.size for at, n in held.items())
    for at, size in held.items():
        memory.give_back(at, size)
    before = memory.size
    assert before == 0 or memory.take(before) == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=3), st.integers(0, 99), st.data())
def test_walks_visit_the_places_of_an_array_in_order(shape, seed, data):
    at = np.random.default_rng(seed).permutation(int(np.prod(shape))).reshape(shape)
    if data.draw(st.booleans()):
        at = np.arange(at.size).reshape(shape[::-1]).transpose()
    sizes, (steps_,) = fused(at.shape, [walk(at)])
    visited = []
    for index in np.ndindex(*sizes):
        moved = [s[i] if isinstance(s, tuple) else s * i for s, i in zip(steps_.axes, index, strict=True)]
        place = steps_.start + sum(moved)
        visited.append(place if steps_.table is None else steps_.table[place])
    assert visited == at.ravel().tolist()
