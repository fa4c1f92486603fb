"""A step at a covariance that has settled: what is left of it is the mean."""

from collections.abc import Callable
from functools import partial, reduce
from typing import Any

import numpy as np

from sigmax.engine.half_steps import half_steps
from sigmax.engine.packing import Packing
from sigmax.filters import Filter
from sigmax.modelling.model import Model
from sigmax.native import Graph, Refused
from sigmax.native.graph import Array, boxed
from sigmax.native.steady import SteadyGraph
from sigmax.steps.step import Belief


def steady_step(
    filter: Filter, packing: Packing, dtype: Any, count: int, sensor: str, size: int
) -> tuple[Callable[..., Any], dict[str, list[Array]], Graph, Callable[..., Any]]:
    """A whole step, (mean, z) -> mean, at a factor and an interval that stay; in the parts of `Lowered`'s programs.

    Args:
        filter: of one belief.
        packing: of its rows.
        dtype: of its numbers.
        count: numbers of the model, behind which factor and interval are told as parameters.
        sensor: what is measured.
        size: numbers of a measurement.

    Raises:
        Refused: when the results are taken up, where the factor depends on the mean or the measurement.
    """
    g, n = SteadyGraph(dtype), packing.n
    *lower, dt = (g.input("parameters", count + i, True) for i in range(n * (n + 1) // 2 + 1))
    factor = g.constants(np.zeros((n, n)))
    factor[np.tril_indices(n)] = lower

    def function(model: Model, mean: Any, factor: Any, dt: Any, z: Any) -> Any:
        steps = half_steps(filter, model)
        moved, fault = steps.predict(Belief(mean, factor), dt, None)
        new, told, then = steps.correct(sensor, None, moved, z, None)
        return [*new, told.factor, fault, then, told.nis, told.log_likelihood, told.residual]

    def made(out: list[Array]) -> dict[str, Any]:
        mean, *fixed, nis, likelihood, residual = out
        if not all(node.fixed for a in fixed for node in g.opened(a).flat):
            raise Refused("a covariance that depends on the mean or on what is measured")
        sound = [g.apply("==", g.opened(a)[()], g.constant(0.0)) for a in fixed[2:]]
        told = [nis[()], likelihood[()], reduce(partial(g.apply, "and"), [*sound, *g.supposed]), *residual]
        return {"next": [*mean], "told": told}

    mean, z = g.inputs("state", (packing.points,)), g.inputs("given", (size,))
    return function, {"state": [mean], "fixed": [factor, boxed(dt)], "given": [z]}, g, made
