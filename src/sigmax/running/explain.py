"""What the rules of a filter find in a model: its parts, how often each is evaluated, what another order saves."""

from collections.abc import Callable, Sequence
from math import comb
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.dependence import Plan, complexity, permutation, reading, total_cost, weight_matrix
from sigmax.engine.linearizing import seconds_of
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model, check_flat
from sigmax.modelling.switching import SwitchingModel
from sigmax.preparation.joining import modes_of
from sigmax.preparation.prepare import as_filter
from sigmax.rewriting.augment import with_bias
from sigmax.rules import Marginal, Rule, SigmaPoints
from sigmax.rules.taylor import order_of

# Points of a set up to which a linearisation is compiled to be timed.
LONGEST = 100


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
    """What a rule does with one function of a model.

    Attributes:
        function: "motion" or the sensor, of several modes with the name of the mode before it.
        rule: the rule, without the permutation.
        points: of its set; of a Taylor rule the value and the derivatives that it takes.
        straight: results that are not sampled, of `results`.
        results: how many there are.
        held: components that are not sampled: they enter as straight lines or not at all.
        parts: what is sampled.
        order: components as their points are drawn in the best order; as in the state where nothing is saved.
        estimated: the part of the cost of all evaluations that the permutation saves.
        W: what it costs to compute the function again when a component changes, by component (Belov, (6), its sum
            over the results).
        Q: the paper's estimate in the order of the state and in the paper's; None of a rule without points.
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
    W: dict[str, float]
    Q: tuple[float, float] | None
    seconds: tuple[float, float] | None

    @property
    def measured(self) -> float | None:
        """The part of the time that the permutation saves."""
        return None if self.seconds is None else 1 - self.seconds[1] / self.seconds[0]


class _Task(NamedTuple):
    """A function of a model with the rule that is applied to it and the arguments besides the state."""

    what: str
    rule: Rule
    function: Callable[..., Any]
    rest: list[Any]
    angular: Sequence[bool]


def explain(
    filter: Filter | str, model: Model, prior: Gaussian, *, dt: float = 1.0, inputs: Any = None, measure: bool = True
) -> list[Explained]:
    """What the rules of a filter find in a model's motion and sensors, its bias standing behind the state.

    Args:
        filter: a filter; that of each mode which names none, where the model has several.
        model: the model.
        prior: where the time is measured.
        dt: seconds of one step.
        inputs: u (k,) where the model takes inputs.
        measure: compile the linearisations of sigma points and take their time, a second or two each; not of
            sets of more than `LONGEST` points, which take minutes to compile.

    Raises:
        InputError: where a rule is one of the user's own, or the filter draws a bias before the state.
    """
    if isinstance(model, SwitchingModel):
        found = []
        for (own, part), mode in zip(modes_of(as_filter(filter, model), model), model.names, strict=True):
            at = [model.state.index(name) for name in part.state]
            rows = [model.deviations.index(name) for name in part.deviations]
            begun = Gaussian(prior.mean[..., at], prior.cov[..., rows, :][..., rows])
            each = explain(own, part, begun, dt=dt, inputs=inputs, measure=measure)
            found += [one._replace(function=f"{mode}: {one.function}") for one in each]
        return found
    chosen = as_filter(filter)
    if model.bias is not None and chosen.form.bias_first:
        raise InputError(f"{chosen.name} draws a bias first, and every point of it moves the whole state; explain CKF")
    check_flat(model, "explain")
    model, prior = with_bias(model, prior)
    u = [] if inputs is None else [jnp.asarray(inputs, float)]
    moved = [jnp.asarray(dt, float), *(u if model.motion_inputs else [])]
    tasks = [_Task("motion", chosen.predict, model.motion, moved, model.angular)]
    for name, sensor in model.sensors.items():
        rest = list(u) if model.sensor_inputs[name] else []
        m = jax.eval_shape(sensor, jnp.zeros(model.size), *rest).shape[0]
        angular = model.measured_angular(name, m)
        tasks.append(_Task(f"sensor {name}".strip(), chosen.correct, sensor, rest, angular))
    return [_explained(task, model, prior, measure) for task in tasks]


def _explained(task: _Task, model: Model, prior: Gaussian, measure: bool) -> Explained:
    n = model.size
    rule = task.rule.rule if isinstance(task.rule, Marginal) else task.rule
    read = reading(task.function, n, task.rest)
    names = [str(name) for name in model.state]
    W = weight_matrix(task.function, n, *task.rest)
    weights = dict(zip(names, W.sum(0).tolist(), strict=True))
    if not isinstance(rule, SigmaPoints):
        order = order_of(rule)
        if order is None:
            raise InputError(f"{rule} is a rule of your own, of which it is not known what it evaluates")
        rows = tuple(i for i, node in enumerate(read.results) if read.masks[node.index].nonlinear)
        times = comb(n + order, order)
        parts = tuple(
            PartFound(tuple(names[c] for c in p.reads), p.what, p.cost, times, times) for p in read.parts(rows)
        )
        said = len(read.results) - len(rows), len(read.results)
        return Explained(task.what, str(rule), times, *said, (), parts, tuple(names), 0.0, weights, None, None)
    unit = rule.points(n)
    rules = [SigmaPoints(rule.family, permute=p, **dict(rule.parameters)) for p in (False, True)]
    plans = [r.plan(read, task.angular) for r in rules]

    def times_of(plan: Plan, reads: Sequence[int]) -> int:
        return unit.counts[plan.level(reads)]

    found = tuple(
        PartFound(tuple(names[c] for c in p.reads), p.what, p.cost, *(times_of(plan, p.reads) for plan in plans))
        for p in plans[0].parts
    )
    costs = [
        total_cost(plan.parts, [*plan.order, *(c for c in range(n) if c not in plan.order)], unit.counts)
        for plan in plans
    ]
    timed = measure and found and unit.evaluations <= LONGEST
    return Explained(
        task.what,
        str(rules[0]),
        unit.evaluations,
        len(read.results) - len(plans[0].rows),
        len(read.results),
        tuple(names[c] for c in range(n) if not plans[0].levels[c]),
        found,
        tuple(names[c] for c in plans[1].order if plans[1].levels[c]),
        1 - costs[1] / costs[0] if costs[0] else 0.0,
        weights,
        (complexity(W, unit.elements), complexity(W, unit.elements, permutation(W))),
        seconds_of(rules, task.function, task.rest, task.angular, prior) if timed else None,
    )
