"""Every registered space: its axioms, and its Jacobians against exponentials of matrices and exact differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation as Judge

from sigmax.algebra.factor import cholesky
from sigmax.native import Graph, Program, evaluate
from sigmax.native.driver import RowsJob, driver, over_cores, pointer, series, steps
from sigmax.spaces import (
    SPACES,
    Direction,
    Flat,
    Pose2,
    Pose3,
    Rotation,
    exponential,
    logarithm,
    product,
    reset,
    rotate,
)

EACH = pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
# The same with the largest left to the slow suite: for what compiles once for each.
MOST = pytest.mark.parametrize(
    "space", [pytest.param(s, id=k, marks=[pytest.mark.slow] * (s.dim > 3)) for k, s in SPACES.items()]
)
GROUPS = {k: s for k, s in SPACES.items() if isinstance(s, Rotation | Pose2 | Pose3)}
ANGLES = (0.0, 1e-12, 1e-9, 1e-6, 0.999e-3, 1.001e-3, 1e-2, 0.499, 0.501, 1.0, 2.0, 3.1)


def points(space, count, seed=0):
    """Points (size, count) of any space, drawn by this test's own means."""
    rng = np.random.default_rng(seed)
    rows = []
    for p, _, _ in space.parts():
        drawn = rng.standard_normal((p.size, count))
        if isinstance(p, Rotation | Direction):
            drawn /= np.linalg.norm(drawn, axis=0)
        elif isinstance(p, Pose3):
            drawn[:4] /= np.linalg.norm(drawn[:4], axis=0)
        rows.append(drawn)
    return np.concatenate(rows)


def differences(space, length, count, seed=1):
    """Differences (dim, count) of which every part has this length."""
    rng = np.random.default_rng(seed)
    rows = [rng.standard_normal((p.dim, count)) for p, _, _ in space.parts()]
    return np.concatenate([length * d / np.linalg.norm(d, axis=0) for d in rows])


def matrix(space, x):
    """A point of a group as a matrix."""
    if isinstance(space, Pose2):
        c, s = np.cos(x[0]), np.sin(x[0])
        return np.array([[c, -s, x[1]], [s, c, x[2]], [0, 0, 1]])
    R = Judge.from_quat(x[:4], scalar_first=True).as_matrix()
    vectors = x[4:].reshape(-1, 3)
    made = np.eye(3 + len(vectors))
    made[:3, :3], made[:3, 3:] = R, vectors.T
    return made


def algebra(space, d):
    """A difference of a group as a matrix of its Lie algebra."""
    if isinstance(space, Pose2):
        return np.array([[0, -d[0], d[1]], [d[0], 0, d[2]], [0, 0, 0]])
    vectors = d[3:].reshape(-1, 3)
    made = np.zeros((3 + len(vectors),) * 2)
    made[:3, :3] = [[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]
    made[:3, 3:] = vectors.T
    return made


def coordinates(space, A):
    """The opposite of `algebra`."""
    if isinstance(space, Pose2):
        return np.array([A[1, 0], A[0, 2], A[1, 2]])
    return np.concatenate([[A[2, 1], A[0, 2], A[1, 0]], A[:3, 3:].T.ravel()])


@EACH
@pytest.mark.parametrize("length", ANGLES)
def test_a_difference_is_what_was_added(space, length):
    x, d = points(space, 50), differences(space, length, 50)
    np.testing.assert_allclose(space.difference(space.add(x, d), x), d, atol=1e-14)


@EACH
def test_adding_a_difference_reaches_the_other_point(space):
    x, y = points(space, 200), points(space, 200, 5)
    reached = space.add(x, space.difference(y, x))
    np.testing.assert_allclose(space.difference(reached, y), 0, atol=1e-14)
    np.testing.assert_allclose(space.difference(space.add(x, np.zeros((space.dim, 200))), x), 0, atol=1e-15)
    np.testing.assert_allclose(space.nearest(reached), reached, atol=4e-16)


@MOST
@pytest.mark.one_in(2)
def test_about_its_base_a_difference_is_the_identity_and_straight(space):
    """To second order too: what a rule of second order sees of a chart is no bend."""
    x = points(space, 1)[:, 0]

    def moved(d):
        return space.difference(space.add(jnp.asarray(x), d), jnp.asarray(x))

    at = jnp.zeros(space.dim)
    np.testing.assert_allclose(jax.jacfwd(moved)(at), np.eye(space.dim), atol=5e-16)
    np.testing.assert_allclose(jax.jit(jax.hessian(moved))(at), 0, atol=1e-15)


@EACH
@pytest.mark.parametrize("length", ANGLES)
@pytest.mark.one_in(5)
def test_jacobians_are_the_derivatives(space, length):
    """By Richardson's differences of ⊞ and ⊟ alone, which know nothing of Jacobians; and J⁻¹ J = 1."""
    x, d = points(space, 1), differences(space, length, 1)
    M = np.random.default_rng(2).standard_normal((space.dim, 3, 1))
    there = space.add(x, d)

    def slope(h):
        ahead, behind = (space.difference(space.add(x, d + s * h * M[:, k]), there) for k in (0,) for s in (1, -1))
        return (ahead - behind) / (2 * h)

    step = 1e-3
    found = (64 * slope(step / 4) - 20 * slope(step / 2) + slope(step)) / 45
    J = space.turned(x, d, M)
    np.testing.assert_allclose(J[:, 0], found, atol=1e-11)
    np.testing.assert_allclose(space.turned_back(x, d, J), M, atol=2e-13)
    np.testing.assert_allclose(space.turned_back(x, d, space.turned(x, d, M)), M, atol=2e-13)


@pytest.mark.parametrize("space", GROUPS.values(), ids=GROUPS)
@pytest.mark.parametrize("length", ANGLES)
@pytest.mark.one_in(2)
def test_a_group_is_its_matrices(space, length):
    """⊞ is a product with SciPy's exponential, ⊟ its logarithm; J the series Σ (−ad)ᵏ / (k + 1)!."""
    x, y, d = points(space, 1)[:, 0], points(space, 1, 3)[:, 0], differences(space, length, 1)[:, 0]
    moved = space.add(x, d)
    np.testing.assert_allclose(matrix(space, moved), matrix(space, x) @ expm(algebra(space, d)), atol=3e-15)
    apart = space.difference(y, x)
    np.testing.assert_allclose(
        apart, coordinates(space, logm(np.linalg.solve(matrix(space, x), matrix(space, y))).real), atol=1e-13
    )
    A = algebra(space, d)
    ad = np.column_stack([coordinates(space, A @ E - E @ A) for E in (algebra(space, e) for e in np.eye(space.dim))])
    J, term = np.eye(space.dim), np.eye(space.dim)
    for k in range(1, 60):
        term = -term @ ad / (k + 1)
        J = J + term
    given = np.eye(space.dim)
    np.testing.assert_allclose(space.turned(x, d, given), J, atol=3e-15)
    np.testing.assert_allclose(space.turned_back(x, d, given), np.linalg.inv(J), atol=1e-13)


def test_quaternions_are_scipys():
    rng = np.random.default_rng(4)
    r, v = rng.standard_normal((3, 100)), rng.standard_normal((3, 100))
    q = exponential(r)
    judged = Judge.from_rotvec(r.T)
    np.testing.assert_allclose(rotate(q, v), judged.apply(v.T).T, atol=2e-15)
    np.testing.assert_allclose(logarithm(q), judged.as_rotvec().T, atol=1e-14)


def test_both_signs_of_a_quaternion_are_the_same_turn():
    space = Rotation()
    a, b = points(space, 100), points(space, 100, 6)
    np.testing.assert_array_equal(space.difference(-a, b), space.difference(a, b))
    np.testing.assert_array_equal(space.difference(a, -b), space.difference(a, b))


@EACH
def test_turning_everything_changes_no_difference(space):
    """A group from the left; the sphere keeps its arcs."""
    if isinstance(space, Flat):
        moved = [space.add(p, np.full((space.dim, 50), 0.7)) for p in (points(space, 50), points(space, 50, 7))]
    elif space in GROUPS.values():
        unit = points(space, 1, 8)
        zero = np.zeros(space.size)
        if not isinstance(space, Pose2):
            zero[0] = 1.0
        as_difference = [
            space.difference(p, np.repeat(zero[:, None], 50, 1)) for p in (points(space, 50), points(space, 50, 7))
        ]
        moved = [space.add(np.repeat(unit, 50, 1), d) for d in as_difference]
    else:
        pytest.skip("no group of its own")
    before = space.difference(points(space, 50), points(space, 50, 7))
    np.testing.assert_allclose(space.difference(*moved), before, atol=1e-13)


def test_the_arc_between_directions_is_their_angle():
    space = Direction()
    a, b = points(space, 100), points(space, 100, 9)
    arc = np.linalg.norm(space.difference(a, b), axis=0)
    np.testing.assert_allclose(arc, np.arccos(np.clip((a * b).sum(0), -1, 1)), atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(space.difference(-a, a), axis=0), np.pi, atol=1e-7)


@EACH
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_lengths_stay_one(space, dtype):
    """However many differences are added, in both types, compiled."""
    x = jnp.asarray(points(space, 1)[:, 0], dtype)
    d = jnp.asarray(differences(space, 0.37, 1)[:, 0], dtype)
    last, _ = jax.jit(lambda x: jax.lax.scan(lambda x, _: (space.add(x, d), None), x, length=1_000_000))(x)
    assert last.dtype == dtype
    for p, at, _ in space.parts():
        part = np.asarray(last[at])
        np.testing.assert_allclose(p.nearest(part), part, rtol=0, atol=3 * np.finfo(dtype).eps)


@EACH
def test_single_precision_is_precise(space):
    x, d = points(space, 50), differences(space, 1.3, 50)
    single = space.difference(space.add(x.astype(np.float32), d.astype(np.float32)), x.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, d, atol=3e-6)


@EACH
@pytest.mark.one_in(4)
def test_a_factor_is_seen_from_the_other_point(space):
    """S⁺ S⁺ᵀ = J S Sᵀ Jᵀ, lower, its diagonal not negative."""
    rng = np.random.default_rng(10)
    x, d = points(space, 1)[:, 0], differences(space, 0.8, 1)[:, 0]
    P = np.cov(rng.standard_normal((space.dim, 40))).reshape(space.dim, -1)
    S, _ = cholesky(jnp.asarray(P))
    made = np.asarray(reset(space, x, d, S).factor)
    J = np.asarray(space.turned(x, d, np.eye(space.dim)))
    np.testing.assert_allclose(made @ made.T, J @ P @ J.T, atol=1e-14)
    np.testing.assert_array_equal(np.triu(made, 1), 0)
    assert (np.diag(made) >= 0).all()


@MOST
@pytest.mark.one_in(2)
def test_numpy_jax_and_c_agree(space):
    """What is computed in C is what JAX computes, with no number that is not finite, also where nothing moves."""
    rng = np.random.default_rng(11)
    x, y = points(space, 40), points(space, 40, 12)
    d, M = differences(space, 1.1, 40), rng.standard_normal((space.dim, 2, 40))
    d[:, :3], y[:, 3:6] = 0.0, x[:, 3:6]
    s, n = space.size, space.dim

    def each(x, y, d, M):
        return [space.add(x, d), space.difference(y, x), space.turned(x, d, M), space.turned_back(x, d, M)]

    def flat(row):
        x, y, d, M = jnp.split(row, [s, 2 * s, 2 * s + n])
        return jnp.concatenate([jnp.ravel(a) for a in each(x, y, d, M.reshape(n, 2))])

    rows = np.ascontiguousarray(np.concatenate([x, y, d, M.reshape(2 * n, -1)]).T)
    g = Graph(np.float64)
    given = g.inputs("given", (rows.shape[1],))
    (out,) = evaluate(g, jax.make_jaxpr(flat)(jax.ShapeDtypeStruct(rows.shape[1:], float)), [given])
    program = Program(g, ("given",), {"made": list(out.flat), "told": [g.constant(0.0)]})
    (step,) = steps([(None, lambda: program)], single=False)
    constants, native = step.setup(np.zeros(1)), np.empty((len(rows), out.size))
    job = RowsJob(step.address, pointer(constants), series(rows, 1, True, False), out.size, pointer(native))
    over_cores(driver(False)["rows"], job, len(rows), False)
    by_jax = np.asarray(jax.jit(jax.vmap(flat))(jnp.asarray(rows)))
    by_numpy = np.concatenate([a.reshape(-1, 40) for a in each(x, y, d, M)]).T
    assert np.isfinite(native).all()
    np.testing.assert_allclose(native, by_jax, atol=2e-14)
    np.testing.assert_allclose(by_numpy, by_jax, atol=2e-14)


def test_flat_neighbours_are_one_space_and_spaces_are_values():
    made = product(Flat((True,)), Flat((False, False)), Rotation(), Flat(), product(Flat((True,)), Direction()))
    assert [type(p) for p, _, _ in made.parts()] == [Flat, Rotation, Flat, Direction]
    assert made == product(Flat((True, False, False)), Rotation(), Flat((False, True)), Direction())
    assert hash(made) == hash(product(made))
    assert product(Flat(), Flat((True,))) == Flat((False, True))
    assert (made.size, made.dim) == (3 + 4 + 2 + 3, 3 + 3 + 2 + 2)
