"""What a sigma rule finds in a model: its parts, how often each is evaluated, what the order of the state saves."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import Lifted
from sigmax.algebra.factor import cholesky
from sigmax.dependence import Plan, complexity, permutation, reading, total_cost, weight_matrix
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.native import Graph, Program, Refused, Unavailable, compiler, evaluate
from sigmax.native.driver import Rows, driver, over_cores, pointer, series, steps
from sigmax.rules import Rule, SigmaPoints
from sigmax.running.edge import as_filter

_TRACKS = 1024
_ROUNDS = 25


class PartFound(NamedTuple):
    """A part of a function that has to be sampled.

    Attributes:
        reads: names of the components of the state.
        what: its operations in words.
        cost: of one evaluation, in multiplications.
        given: evaluations in the order of the state.
        permuted: evaluations in the best order.
    """

    reads: tuple[str, ...]
    what: str
    cost: float
    given: int
    permuted: int


class Explained(NamedTuple):
    """What a sigma rule does with one function of a model.

    Attributes:
        function: "motion" or the sensor.
        rule: the rule, without the permutation.
        points: of its set.
        straight: results that are not sampled, of `results`.
        results: how many there are.
        held: components that are not sampled: they enter as straight lines or not at all.
        parts: what is sampled.
        order: components as their points are drawn in the best order; as in the state where nothing is saved.
        estimated: the part of the cost of all evaluations that the permutation saves.
        Q: the paper's estimate in the order of the state and in the paper's.
        seconds: for one linearisation of one track, in the order of the state and permuted; None if not measured.
    """

    function: str
    rule: str
    points: int
    straight: int
    results: int
    held: tuple[str, ...]
    parts: tuple[PartFound, ...]
    order: tuple[str, ...]
    estimated: float
    Q: tuple[float, float]
    seconds: tuple[float, float] | None

    @property
    def measured(self) -> float | None:
        """The part of the time that the permutation saves."""
        return None if self.seconds is None else 1 - self.seconds[1] / self.seconds[0]


def explain(
    filter: Filter | str, model: Model, prior: Gaussian, *, dt: float = 1.0, inputs: Any = None, measure: bool = True
) -> list[Explained]:
    """What the sigma rules of a filter find in a model's motion and sensors.

    Args:
        filter: a filter; rules that are no sigma points are left out.
        model: the model.
        prior: where the time is measured.
        dt: seconds of one step.
        inputs: u (k,) where the model takes inputs.
        measure: compile the linearisations and take their time.

    Raises:
        InputError: where no rule of the filter uses sigma points.
    """
    chosen = as_filter(filter)
    u = [] if inputs is None else [jnp.asarray(inputs, float)]
    tasks: list[tuple[str, SigmaPoints, Callable[..., Any], list[Any], Sequence[bool]]] = []
    if isinstance(chosen.predict, SigmaPoints):
        rest = [jnp.asarray(dt, float), *(u if model.motion_inputs else [])]
        tasks.append(("motion", chosen.predict, model.motion, rest, model.angular))
    if isinstance(chosen.correct, SigmaPoints):
        for name, sensor in model.sensors.items():
            rest = list(u) if model.sensor_inputs[name] else []
            m = jax.eval_shape(sensor, jnp.zeros(model.size), *rest).shape[0]
            angular = model.measured_angular(name, m)
            tasks.append((f"sensor {name}".strip(), chosen.correct, sensor, rest, angular))
    if not tasks:
        raise InputError(f"{chosen} uses derivatives, not sigma points: explain one such as SRCKFB, UKF or SKF")
    return [_explained(*task, model, prior, measure) for task in tasks]


def _explained(
    what: str,
    rule: SigmaPoints,
    function: Callable[..., Any],
    rest: list[Any],
    angular: Sequence[bool],
    model: Model,
    prior: Gaussian,
    measure: bool,
) -> Explained:
    n = model.size
    unit = rule.points(n)
    rules = [SigmaPoints(rule.family, permute=p, **dict(rule.parameters)) for p in (False, True)]
    read = reading(function, n, rest)
    plans = [r.plan(read) for r in rules]
    names = [str(name) for name in model.state]

    def times(plan: Plan, reads: Sequence[int]) -> int:
        return unit.counts[plan.level(reads)]

    parts = tuple(
        PartFound(tuple(names[c] for c in p.reads), p.what, p.cost, *(times(plan, p.reads) for plan in plans))
        for p in plans[0].parts
    )
    costs = [
        total_cost(plan.parts, [*plan.order, *(c for c in range(n) if c not in plan.order)], unit.counts)
        for plan in plans
    ]
    W = weight_matrix(function, n, *rest)
    seconds = _measured(rules, function, rest, angular, prior) if measure and parts else None
    return Explained(
        what,
        str(rules[0]),
        unit.evaluations,
        len(read.results) - len(plans[0].bent),
        len(read.results),
        tuple(names[c] for c in range(n) if not plans[0].levels[c]),
        parts,
        tuple(names[c] for c in plans[1].order if plans[1].levels[c]),
        1 - costs[1] / costs[0] if costs[0] else 0.0,
        (complexity(W, unit.elements), complexity(W, unit.elements, permutation(W))),
        seconds,
    )


def _measured(
    rules: Sequence[Rule], function: Callable[..., Any], rest: Sequence[Any], angular: Sequence[bool], prior: Gaussian
) -> tuple[float, float]:
    """Seconds for each of two linearisations of one track, the fastest of several rounds in turn.

    On the native engine less the time of a program that reads and writes the same rows and computes nothing.
    """
    mean = np.asarray(prior.mean if prior.mean.ndim == 1 else prior.mean[0], float)
    cov = np.asarray(prior.cov if prior.cov.ndim == 2 else prior.cov[0], float)
    factor = np.asarray(cholesky(jnp.asarray(cov))[0])
    rng = np.random.default_rng(0)
    x = mean + rng.standard_normal((_TRACKS, len(mean))) @ factor.T
    # A factor as a filter has it: all components correlated.
    mixing = np.tril(rng.uniform(-0.3, 0.3, (_TRACKS, *factor.shape)), -1) + np.eye(len(mean))
    S = np.diagonal(factor)[:, None] * mixing + (factor - np.diag(np.diagonal(factor)))
    runs: Sequence[tuple[Callable[[], None], Callable[[], None] | None]]
    try:
        if compiler() is None:
            raise Unavailable("there is no C compiler")
        runs = _native(rules, function, rest, angular, x, S)
    except (Refused, Unavailable):
        runs = [(_on_xla(rule, function, rest, angular, x, S), None) for rule in rules]

    def taken(run: Callable[[], None] | None) -> float:
        start = time.perf_counter()
        if run is not None:
            run()
        return time.perf_counter() - start

    rounds = [[[taken(run) for run in pair] for pair in runs] for _ in range(_ROUNDS)]
    (whole, idle), (less, idle_too) = np.min(rounds, axis=0) / _TRACKS
    return float(whole - idle), float(less - idle_too)


def _native(
    rules: Sequence[Rule], function: Any, rest: Sequence[Any], angular: Sequence[bool], x: np.ndarray, S: np.ndarray
) -> list[tuple[Callable[[], None], Callable[[], None]]]:
    """Each linearisation, and a program of the same rows that computes nothing."""
    n = x.shape[1]
    lower = np.tril_indices(n)
    shared = [np.broadcast_to(np.ravel(r), (len(x), np.size(r))) for r in rest]
    rows = np.ascontiguousarray(np.concatenate([x, S[:, lower[0], lower[1]], *shared], axis=1))
    programs = [_program(rule, function, rest, angular, n, rows.shape[1]) for rule in rules]
    g = Graph()
    idle = [
        p._replace(graph=g, outputs={k: [g.constant(0.0)] * len(v) for k, v in p.outputs.items()}) for p in programs
    ]
    made = steps([(None, partial(_itself, p)) for p in (*programs, *idle)], False)

    def runner(step: Any, program: Program) -> Callable[[], None]:
        out = np.empty((len(rows), len(program.outputs["made"])))
        constants = step.setup(np.zeros(1))
        job = Rows(step.address, pointer(constants), series(rows, 1, True, False), out.shape[1], pointer(out))

        def run(kept: Any = (constants, out)) -> None:
            over_cores(driver(False)["rows"], job, len(rows), False)

        return run

    each = [runner(*pair) for pair in zip(made, (*programs, *idle), strict=True)]
    return list(zip(each[: len(rules)], each[len(rules) :], strict=True))


def _itself(program: Program) -> Program:
    return program


def _program(rule: Rule, function: Any, rest: Sequence[Any], angular: Sequence[bool], n: int, size: int) -> Program:
    """The linearisation of one track as scalar operations: mean, lower factor and the other arguments in a row."""
    g = Graph()
    flat = g.inputs("given", (size,))
    factor = g.constants(np.zeros((n, n)))
    below = n + n * (n + 1) // 2
    factor[np.tril_indices(n)] = flat[n:below]
    bounds = np.cumsum([np.size(r) for r in rest])[:-1]
    others = [a.reshape(np.shape(r)) for a, r in zip(np.split(flat[below:], bounds), rest, strict=True)] if rest else []

    def line(x: Any, S: Any, *given: Any) -> Any:
        return tuple(rule(Lifted(function, [(r, r.ndim) for r in given], False), x, S, angular))

    arrays = [flat[:n], factor, *others]
    traced = jax.make_jaxpr(line)(*(jax.ShapeDtypeStruct(a.shape, jnp.float64) for a in arrays))
    made = [node for a in evaluate(g, traced, arrays) for node in a.flat]
    return Program(g, ("given",), {"made": made, "told": [g.constant(0.0)]})


def _on_xla(
    rule: Rule, function: Any, rest: Sequence[Any], angular: Sequence[bool], x: np.ndarray, S: np.ndarray
) -> Callable[[], None]:
    given = jnp.asarray(x.T), jnp.asarray(np.moveaxis(S, 0, -1))

    @jax.jit
    def line(x: Any, S: Any) -> Any:
        return tuple(rule(Lifted(function, [(r, r.ndim) for r in rest], True), x, S, angular))

    jax.block_until_ready(line(*given))

    def run() -> None:
        jax.block_until_ready(line(*given))

    return run
