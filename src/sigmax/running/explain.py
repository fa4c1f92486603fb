"""What a sigma rule finds in a model: its parts, how often each is evaluated, what the order of the state saves."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.dependence import Plan, complexity, permutation, reading, total_cost, weight_matrix
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.models.augment import with_bias
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model, check_flat
from sigmax.models.switching import check_one_mode
from sigmax.rules import SigmaPoints
from sigmax.running.linearizing import seconds_of
from sigmax.running.prepare import as_filter


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
    """What the sigma rules of a filter find in a model's motion and sensors, its bias standing behind the state.

    Args:
        filter: a filter; rules that are no sigma points are left out.
        model: the model.
        prior: where the time is measured.
        dt: seconds of one step.
        inputs: u (k,) where the model takes inputs.
        measure: compile the linearisations and take their time.

    Raises:
        InputError: where no rule of the filter uses sigma points, or it draws a bias before the state.
    """
    chosen = as_filter(filter)
    if model.bias is not None and chosen.form.bias_first:
        raise InputError(f"{chosen.name} draws a bias first, and every point of it moves the whole state; explain CKF")
    check_flat(model, "explain")
    check_one_mode(model, "explain")
    model, prior = with_bias(model, prior)
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
        raise InputError(f"{chosen} has no sigma points on the whole state: explain one such as SRCKFB, UKF or SKF")
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
    plans = [r.plan(read, angular) for r in rules]
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
    seconds = seconds_of(rules, function, rest, angular, prior) if measure and parts else None
    return Explained(
        what,
        str(rules[0]),
        unit.evaluations,
        len(read.results) - len(plans[0].rows),
        len(read.results),
        tuple(names[c] for c in range(n) if not plans[0].levels[c]),
        parts,
        tuple(names[c] for c in plans[1].order if plans[1].levels[c]),
        1 - costs[1] / costs[0] if costs[0] else 0.0,
        (complexity(W, unit.elements), complexity(W, unit.elements, permutation(W))),
        seconds,
    )
