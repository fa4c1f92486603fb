"""What each filter costs, measured side by side."""

from collections.abc import Callable, Mapping, Sequence
from math import comb
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.engine.timing import seconds
from sigmax.filters import Filter
from sigmax.modelling.evaluate import moving, sensing
from sigmax.models import Model, SwitchingModel
from sigmax.preparation.prepare import as_filter, prepare
from sigmax.rewriting.augment import augment
from sigmax.rules import Marginal, SigmaPoints
from sigmax.rules.linearization import Function, Rule
from sigmax.rules.taylor import order_of
from sigmax.steps.updating import update_on
from sigmax.studies.simulate import draw
from sigmax.studies.study import Study

_ROUNDS, _STEPS = 15, 50


class Cost(NamedTuple):
    """What a step of a filter costs in a batch of this study.

    Attributes:
        predict: seconds for a prediction.
        update: seconds for a correction.
        relative: (3,), prediction, correction and both divided by the EKF's.
        evaluations: of the motion and of the sensors in a step; those of the most often evaluated part;
            derivatives in a direction count as one.
    """

    predict: float
    update: float
    relative: np.ndarray
    evaluations: tuple[int | None, int | None]


def costs(
    study: Study,
    filters: Mapping[str, Filter],
    yardstick: Filter,
    seed: int,
    backend: str | None,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, Cost]:
    """The cost of each filter relative to `yardstick`.

    In every round each filter has its turn, so that a noisy machine favours none; the fastest of its turns counts,
    for everything that disturbs a measurement makes it longer.
    """
    drawn = draw(study, seed, 0, backend)
    T = min(study.steps, _STEPS)
    model, prior = study.model_and_prior(drawn.mean)
    z: Any = {s: v[:, :T] for s, v in drawn.z.items()}
    inputs = None if study.inputs is None else np.asarray(study.inputs)[:T]
    taking_turns = [as_filter(f, study.model) for f in (yardstick, *filters.values())]
    ready = [
        prepare(f, model, prior, z if study.model.several else z[""], study.elapsed[:T], inputs, "float64")
        for f in taking_turns
    ]

    def turn() -> list[tuple[float, float]]:
        return [seconds(laid, backend) for laid in ready]

    turn()  # compiles
    rounds = []
    for _ in range(_ROUNDS):
        rounds.append(turn())
        tick()
    alone, whole = np.min(rounds, axis=0).T
    parts = np.stack([alone, np.maximum(whole - alone, 1e-9), whole], axis=-1)
    relative, each = parts / parts[0], parts / (T * study.block)
    return {
        name: Cost(each[i, 0], each[i, 1], relative[i], _evaluations(f.on(model.biases), model, inputs))
        for i, (name, f) in enumerate(filters.items(), start=1)
    }


def _evaluations(filter: Filter, model: Model, inputs: np.ndarray | None) -> tuple[int | None, int | None]:
    """How often motion and sensors are evaluated in a step, None for a rule of the user's."""
    if model.curved or isinstance(model, SwitchingModel):
        return None, None
    model, n = augment(model, filter.form.bias_first), model.size + model.biases
    x, dt, u = jnp.zeros(n), jnp.ones(()), None if inputs is None else jnp.asarray(inputs[0], float)
    sensors = []
    for name in model.sensors:
        h = sensing(model, name, x, u)
        angular = model.measured_angular(name, jax.eval_shape(h, x).shape[0])
        each = 1 + update_on(filter, model, name).iterations
        times = _times(filter.correct, h, n, angular)
        sensors.append(None if times is None else each * times)
    motion = _times(filter.predict, moving(model, x, dt, u), n, model.angular)
    return motion, None if None in sensors else sum(k for k in sensors if k is not None)


def _times(rule: Rule, g: Function, size: int, angular: Sequence[bool], biases: int = 0) -> int | None:
    if isinstance(rule, Marginal):
        return _times(rule.rule, g, size, angular, rule.biases)
    n = size - biases
    if isinstance(rule, SigmaPoints):
        return rule.evaluations(g, size, angular, n)
    order = order_of(rule)
    return None if order is None else comb(n + order, order)
