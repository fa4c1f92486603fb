"""Parameters of a model from a record, by maximum likelihood."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.running.edge import as_filter
from sigmax.running.run import run

Parameters = dict[str, Any]


class Fit(NamedTuple):
    """What `fit` found.

    Attributes:
        parameters: the values of greatest likelihood, by name.
        std: their standard deviations from the curvature of the log-likelihood; NaN where it has none.
        log_likelihood: at these values.
        converged: whether the optimiser ended at a maximum.
        message: what it says of its end.
        evaluations: how often the filter was run over the record, derivatives included.
    """

    parameters: Parameters
    std: Parameters
    log_likelihood: float
    converged: bool
    message: str
    evaluations: int


def fit(
    filter: Filter | str,
    build: Callable[[Parameters], tuple[Model, Gaussian]],
    start: Mapping[str, Any],
    z: Any,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    update_first: bool = False,
    positive: Collection[str] = (),
) -> Fit:
    """Fit parameters by the likelihood that a filter gives a record, its gradient exact.

    Args:
        filter: whose likelihood; it differentiates through every filter.
        build: parameters by name -> (model, prior); written with `jax.numpy` where it computes with them.
        start: where to start, numbers or arrays by name.
        z: the record, as in `run`; the likelihoods of a batch are added.
        dt: as in `run`.
        inputs: as in `run`.
        update_first: as in `run`.
        positive: names of parameters that must stay positive (deviations, densities): they are
            searched by their logarithm.

    Returns:
        The fit. L-BFGS of SciPy; the first evaluation compiles for some seconds.

    Raises:
        InputError: where a name is not known, or the likelihood at the start is not finite.
    """
    chosen = as_filter(filter)
    values = {name: np.asarray(value, float) for name, value in start.items()}
    for name in positive:
        if name not in values:
            raise unknown("parameter", name, values)
        if not (values[name] > 0).all():
            raise InputError(f"{name} is to stay positive and starts at {values[name]}")
    inside = {k: np.log(v) if k in positive else v for k, v in values.items()}
    flat, unravel = ravel_pytree(inside)
    unit = np.where(np.asarray(flat) == 0, 1.0, np.maximum(np.abs(flat), 1e-3))
    unit = np.concatenate([np.ones(v.size) if k in positive else u for (k, v), u in _split(inside, unit)])

    def outside(vector: Any) -> Parameters:
        named = unravel(vector * unit)
        return {k: jnp.exp(v) if k in positive else v for k, v in named.items()}

    @jax.jit
    def objective(vector: Any) -> Any:
        def negative(v: Any) -> Any:
            model, prior = build(outside(v))
            done = run(chosen, model, prior, z, dt=dt, inputs=inputs, keep=("fault",))
            return jnp.where(done.ok.all(), -jnp.sum(done.log_likelihood), jnp.inf)

        return jax.value_and_grad(negative)(vector)

    evaluations = 0

    def evaluate(vector: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal evaluations
        evaluations += 1
        value, gradient = objective(vector)
        return float(value), np.nan_to_num(np.asarray(gradient), posinf=0.0, neginf=0.0)

    begin = np.asarray(flat) / unit
    value, _ = evaluate(begin)
    if not np.isfinite(value):
        model, prior = build({k: jnp.asarray(v) for k, v in values.items()})
        faults = run(chosen, model, prior, z, dt=dt, inputs=inputs).faults(1)
        raise InputError(
            f"the log-likelihood at the start is not finite ({'; '.join(faults) or value}); start elsewhere"
        )
    from scipy.optimize import minimize  # as long to import as all of this package

    found = minimize(evaluate, begin, jac=True, method="L-BFGS-B")
    best = outside(found.x)
    deviation = _deviations(evaluate, found.x) * unit
    named = unravel(jnp.asarray(deviation))
    std = {k: np.asarray(best[k] * v if k in positive else v) for k, v in named.items()}
    return Fit(
        {k: np.asarray(v) for k, v in best.items()},
        std,
        -float(found.fun),
        bool(found.success),
        str(found.message),
        evaluations,
    )


def _split(named: Mapping[str, np.ndarray], flat: np.ndarray) -> list[tuple[tuple[str, np.ndarray], np.ndarray]]:
    """The parts of a flat vector that belong to each name, in the order of the flat vector."""
    parts, at = [], 0
    for name in sorted(named):
        size = named[name].size
        parts.append(((name, named[name]), flat[at : at + size]))
        at += size
    return parts


def _deviations(evaluate: Callable[[np.ndarray], tuple[float, np.ndarray]], best: np.ndarray) -> np.ndarray:
    """Standard deviations from the inverse of the curvature, by differences of the exact gradient."""
    step = 1e-4
    rows = [(evaluate(best + step * e)[1] - evaluate(best - step * e)[1]) / (2 * step) for e in np.eye(len(best))]
    curvature = (np.array(rows) + np.array(rows).T) / 2
    try:
        variances = np.diag(np.linalg.inv(curvature))
    except np.linalg.LinAlgError:
        return np.full(len(best), np.nan)
    return np.sqrt(np.where(variances > 0, variances, np.nan))
