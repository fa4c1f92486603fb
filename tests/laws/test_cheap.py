"""The cheap transform: counts as in Belov et al. (corrected), the best order, values equal to the plain rule's."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sigmax
from sigmax.algebra.arrays import Lifted
from sigmax.dependence import Part, best_order, complexity, permutation, reading, total_cost, weight_matrix
from sigmax.native import Graph, Refused, evaluate
from sigmax.rules import SigmaPoints, cubature, gauss_hermite, scaled, sigma_set, simplex, unscented
from sigmax.rules.regression import regressed

# Belov et al., (10)-(16): heights, velocities, positions; the map reads the last two, the equation the first too.
W = np.array([1, 0, 0, 0, 0, 2, 2])
P = (5, 6, 0, 1, 2, 3, 4)
MAP, EQUATION = (5, 6), (0, 5, 6)
SETS = {"2n": cubature(7), "2n+1": scaled(7), "n+1": simplex(7, moireau=True), "n+1 reversed": simplex(7)}


@pytest.mark.parametrize(
    ("name", "elements", "before", "after", "look_ups", "equations"),
    [
        ("2n", [3, 5, 7, 9, 11, 13, 14], 57, 23, 5, 7),
        ("2n+1", [3, 5, 7, 9, 11, 13, 15], 59, 23, 5, 7),
        ("n+1", [3, 4, 5, 6, 7, 8, 8], 35, 19, 4, 5),
        ("n+1 reversed", [2, 3, 4, 5, 6, 7, 8], 32, 14, 3, 4),
    ],
)
def test_counts_and_costs_are_those_of_the_paper_corrected(name, elements, before, after, look_ups, equations):
    unit = SETS[name]
    assert list(unit.elements) == elements
    assert complexity(W, unit.elements) == before
    assert complexity(W, unit.elements, P) == after
    assert permutation(W) == P
    assert min(complexity(W, unit.elements, p) for p in itertools.permutations(range(7))) == after
    assert [unit.counts[max(P.index(c) for c in reads) + 1] for reads in (MAP, EQUATION)] == [look_ups, equations]
    assert [unit.counts[max(reads) + 1] for reads in (MAP, EQUATION)] == [unit.evaluations] * 2


def test_the_element_counts_that_the_paper_prints_for_the_simplex_are_not_those_of_its_points():
    assert complexity(W, [2, 3, 4, 5, 6, 7, 7]) == 30
    assert complexity(W, [2, 3, 4, 5, 6, 7, 7], P) == 14
    with pytest.raises(sigmax.InputError, match="7 element counts, not 6"):
        complexity(W, [2, 3, 4, 5, 6, 7])


def test_the_papers_example_of_two_components():
    # g1(x1, x2) + g2(x2): 11 elements as they stand, 10 the other way round.
    xi = cubature(2).elements
    assert complexity([[1, 1], [0, 1]], xi) == 11
    assert complexity([[1, 1], [0, 1]], xi, permutation([[1, 1], [0, 1]])) == 10


def test_sorting_by_weight_is_not_always_best():
    parts = [Part((3,), 8), Part((0, 2), 6), Part((0, 1), 3)]
    counts = scaled(4).counts
    weights = [sum(p.cost for p in parts if c in p.reads) for c in range(4)]
    assert total_cost(parts, permutation(weights), counts) == 109
    assert total_cost(parts, best_order(parts, counts), counts) == 93


subsets = st.frozensets(st.integers(0, 6), min_size=1, max_size=4)
graphs = st.lists(st.tuples(subsets, st.integers(1, 50)), min_size=1, max_size=6)


@given(graphs, st.sampled_from([cubature, simplex, scaled]))
@settings(max_examples=25)
def test_the_best_order_is_that_of_brute_force(graph, family):
    names = sorted(frozenset().union(*(reads for reads, _ in graph)))
    parts = [Part(tuple(names.index(c) for c in reads), cost) for reads, cost in graph]
    counts = family(7).counts
    every = itertools.permutations(range(len(names)))
    assert total_cost(parts, best_order(parts, counts), counts) == min(total_cost(parts, p, counts) for p in every)


def moments(points, weights):
    return weights.sum(), weights @ points, np.einsum("i,ij,ik->jk", weights, points, points)


@pytest.mark.parametrize(
    "unit",
    [*SETS.values(), unscented(5, w0=-0.4), cubature(5, degree=5), cubature(4, degree=5), gauss_hermite(4, order=4)],
    ids=lambda unit: str(unit.evaluations),
)
def test_a_projected_set_is_a_set_with_no_point_twice(unit):
    for size in range(1, unit.dimension + 1):
        less = unit.projected(size)
        weights = np.concatenate([less.pair_weights, less.pair_weights, less.single_weights, [less.centre or 0.0]])
        weights = weights[: less.evaluations] if less.centre is None else weights
        one, mean, spread = moments(less.points, weights)
        assert abs(one - 1) < 1e-12
        assert np.abs(mean).max() < 1e-12
        assert np.abs(spread - np.eye(size)).max() < 1e-12
        assert len(np.unique(np.round(less.points, 9), axis=0)) == less.evaluations <= unit.counts[size]


def mixed(x, dt, u):
    """A bit of everything: straight rows, dear parts of few components, products, a table, a choice, loops, angles."""
    a, b, c, d, e, f = x
    table = jnp.asarray(np.cos(np.arange(9.0)))
    looked = table[jnp.clip(jnp.floor(e + 4.0).astype(int), 0, 8)]
    dear = looked * jnp.exp(0.2 * e) + jnp.arctan2(e, 2.0) * 1.5**e * jnp.tanh(e) * jnp.cos(e)
    dear += sum(jnp.arctan2(e, 2.0 + k) for k in range(6))
    looped = jax.lax.fori_loop(0, 2, lambda i, s: s * jnp.sin(f) + 1, 1.0)
    return jnp.stack(
        [
            a + dt * b - 2 * f,
            b + jnp.where(u[0] > 0, 3.0, 1.0) * c,
            2.0 + a + dear,
            d + looped * jnp.sin(e),
            jnp.where(c > 0, c, 0.5 * c) + a,
            jnp.hypot(d, f) + 3 * b,
            u[0],
        ]
    )


SUBSETS = [s for k in (1, 2, 3) for s in itertools.combinations((2, 3, 4, 5), k)]
ANGULAR = (False, True, False, True, False, False, False)
RULES = [
    (cubature, {}),
    (scaled, {"alpha": 0.9, "beta": 0.0, "kappa": -0.5}),
    (simplex, {}),
    (simplex, {"moireau": True}),
]


def spread(line):
    P = [np.einsum("mk...,nk...->mn...", a, a) for a in line[1:]]
    return P[0] + P[1] - P[2]


def same(line, plain, root, plain_root):
    np.testing.assert_allclose(line.mean, plain.mean, atol=1e-13, rtol=0)
    np.testing.assert_allclose(spread(line), spread(plain), atol=1e-13, rtol=0)
    cross, wanted = (np.einsum("nk...,mk...->nm...", S, v.slope) for S, v in ((root, line), (plain_root, plain)))
    np.testing.assert_allclose(cross, wanted, atol=1e-13, rtol=0)


@pytest.mark.parametrize("permute", [False, True])
@pytest.mark.parametrize(("family", "parameters"), RULES)
@pytest.mark.one_in(2)
def test_moments_are_those_of_the_plain_rule_with_the_same_root(family, parameters, permute):
    batch = (3,) if permute else ()
    rng = np.random.default_rng(0)
    x = 0.3 * rng.standard_normal((6, *batch))
    S = np.tril(0.1 * np.ones((6, 6))) + 0.2 * np.eye(6)
    S = (S[..., None] * rng.uniform(0.5, 1, (6, 6, *batch))) if batch else S * rng.uniform(0.5, 1, (6, 6))
    u = rng.uniform(0, 1, (1, *batch))
    g = Lifted(mixed, [(jnp.asarray(0.3), 0), (jnp.asarray(u), 1)], bool(batch))
    rule = SigmaPoints(family, permute=permute, **parameters)
    plan = rule.plan(reading(mixed, 6, g.single), ANGULAR)
    assert plan.turned == permute
    # The angle of row 1 is straight in what bends row 4.
    assert plan.rows == (1, 2, 3, 4, 5)
    assert plan.size == (6 if parameters == {"moireau": True} or not permute else 4)
    order = [*plan.order, *(c for c in range(6) if c not in plan.order)]
    root = np.empty_like(S)
    for k in np.ndindex(batch):
        upper = np.linalg.qr(S[(..., *k)][order].T)[1]
        root[(order, slice(None), *k)] = (upper * np.sign(np.diag(upper))[:, None]).T
    unit = rule.points(6)
    line, plain = (
        jax.jit(f)(jnp.asarray(x), jnp.asarray(s))
        for f, s in (
            (lambda x, S: rule(g, x, S, ANGULAR), S),
            (lambda x, S: regressed(unit, lambda points, _: g(points), x, S, ANGULAR), root),
        )
    )
    same(line, plain, S, root)


@pytest.mark.slow
def test_an_angle_spread_over_turns_counts_as_its_set_sees_it():
    """A course known to 426 degrees is straight in the course and is sampled all the same, as the motion needs it."""
    motion = sigmax.motions.coordinated_turn()
    angular = tuple(isinstance(name, sigmax.angle) for name in motion.state)
    x = np.array([0.0, 0.0, 100.0, 0.5, 0.01])
    S = np.diag([1.0, 1.0, 3.0, np.deg2rad(426), 0.02]) + np.tril(0.01 * np.ones((5, 5)), -1)
    rule = SigmaPoints(cubature, degree=3)
    g = Lifted(motion.function, [(jnp.asarray(1.0), 0)], False)
    line = rule(g, jnp.asarray(x), jnp.asarray(S), angular)
    plain = regressed(rule.points(5), lambda points, _: g(points), jnp.asarray(x), jnp.asarray(S), angular)
    for own, wanted in ((line.mean, plain.mean), (spread(line), spread(plain)), (line.slope, plain.slope)):
        np.testing.assert_allclose(own, wanted, atol=1e-11, rtol=1e-12)
    assert spread(line)[3, 3] < 0.2 * S[3, 3] ** 2


def test_what_enters_straight_is_not_sampled():
    read = reading(mixed, 6, (jnp.asarray(0.3), jnp.ones(1)))
    assert read.sampled_rows([False] * 7) == (2, 3, 4, 5)
    parts = read.parts((2, 3, 4, 5))
    assert {(2,), (4,), (5,), (3, 5), (4, 5)} <= {part.reads for part in parts} <= set(SUBSETS)
    assert "sin" in {w for part in parts if part.reads == (5,) for w in part.what.replace(",", "").split()}


def test_a_loop_of_unknown_length_and_a_tracer_are_taken_as_they_are():
    def stubborn(x):
        return jnp.stack([x[0] + x[1], jax.lax.while_loop(lambda s: s < 10, lambda s: s * 2, x[2]) + x[3]])

    read = reading(stubborn, 4)
    assert read.sampled_rows((False, False)) == (1,)
    assert [part.reads for part in read.parts((1,))] == [(2,)]

    @jax.jit
    def likelihood(theta):
        g = Lifted(lambda x: jnp.stack([theta * x[0], jnp.sin(theta * x[1])]), [], False)
        return SigmaPoints(cubature)(g, jnp.ones(2), 0.3 * jnp.eye(2), (False, False)).mean.sum()

    step = 1e-6
    numeric = (likelihood(0.7 + step) - likelihood(0.7 - step)) / (2 * step)
    assert jax.grad(likelihood)(0.7) == pytest.approx(float(numeric), rel=1e-8)


def test_the_weight_matrix_counts_what_must_be_computed_again():
    made = weight_matrix(lambda x: jnp.stack([x[0] + 2 * x[1], jnp.sin(x[2]) * x[1]]), 4)
    assert made.tolist() == [[1, 2, 0, 0], [0, 1, 21, 0]]


def test_a_component_known_exactly_costs_no_digits():
    def g(x):
        return jnp.stack([jnp.sin(x[2]) + x[0], x[1] * x[2]])

    S = np.array([[0.3, 0, 0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    line = SigmaPoints(cubature, permute=True)(Lifted(g, [], False), jnp.ones(3), jnp.asarray(S), (False, False))
    np.testing.assert_allclose(spread(line), [[0.09, 0.03], [0.03, 0.01]], atol=1e-15)


def test_rules_with_and_without_the_permutation_are_two():
    assert SigmaPoints(cubature) != SigmaPoints(cubature, permute=True)
    assert str(sigmax.get("CKF", permute=True).correct) == "SigmaPoints(cubature, degree=3, permute=True)"
    assert sigma_set(simplex(3, moireau=True).points, np.full(4, 0.25)).evaluations == 4


@pytest.mark.parametrize("permute", [False, True])
@pytest.mark.parametrize(("family", "parameters"), [(cubature, {}), (scaled, {}), (simplex, {})])
@pytest.mark.parametrize("reads", [(1,), (1, 2, 3)])
def test_the_evaluations_told_are_those_made(family, parameters, permute, reads):
    points = []

    def counted(x):
        points.append(len(x))
        return np.arctan2(x[:, 0], 2 + x.sum(1) ** 2)

    dear = sigmax.models.opaque(counted, reads=reads)
    g = Lifted(lambda x: jnp.stack([x[0], dear(x)]), [], False)
    rule = SigmaPoints(family, permute=permute, **parameters)
    for angular in ((False, False), (True, True)):
        points.clear()
        jax.jit(lambda x, S, a=angular: rule(g, x, S, a))(jnp.arange(4.0), jnp.tril(jnp.ones((4, 4))))
        assert sum(points) == rule.evaluations(g, 4, angular)
    straight = Lifted(lambda x: jnp.stack([x[0] - x[2]]), [], False)
    assert rule.evaluations(straight, 4, (False,)) == 5


def test_an_angle_is_sampled_where_it_reads_what_bends_others():
    read = reading(lambda x: jnp.stack([x[0] ** 2, x[0] + x[3], 2 * x[3]]), 4)
    assert read.sampled_rows((False, False, False)) == (0,)
    assert read.sampled_rows((False, True, True)) == (0, 1)


def test_a_map_of_millions_is_read_and_looked_up_without_a_node_for_each_height():
    heights = np.arange(3_000_000.0)

    def looked(x):
        return jnp.stack([jnp.asarray(heights).reshape(1500, 2000)[3, 7 + x[0].astype(int)] + x[1]])

    read = reading(looked, 2)
    assert len(read.masks) < 500
    assert [part.reads for part in read.parts((0,))] == [(0,)]
    g = Graph()
    (made,) = evaluate(g, jax.make_jaxpr(looked)(jnp.zeros(2)), [g.inputs("x", (2,))])
    assert len(g.nodes) < 500
    assert [t.size for t in g.tables] == [heights.size]
    assert [n.operation for n in made.flat[0].inputs] == ["input", "table"]
    with pytest.raises(Refused, match="3,000,000"):
        evaluate(g, jax.make_jaxpr(lambda x: jnp.asarray(heights).sum() * x)(jnp.zeros(2)), [g.inputs("x", (2,))])


def test_a_bias_is_not_sampled():
    """Its components enter straight: the points of an augmented filter are those of the state that bends."""
    made = sigmax.builtin("radar-offset")
    (motion, sensor) = sigmax.explain("HCKF", made.model, made.prior, dt=made.dt, measure=False)
    assert motion.parts == ()
    assert set(sensor.held) >= set(made.model.bias.names)
    assert max(part.given for part in sensor.parts) < sensor.points / 3
    with pytest.raises(sigmax.InputError, match="draws a bias first"):
        sigmax.explain("TSCKF", made.model, made.prior)
