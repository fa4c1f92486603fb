"""Parameters of a model from a record, by maximum likelihood."""

from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from sigmax.algebra.compiling import compiled
from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.models.checks import finite, numbers, strings
from sigmax.models.gaussian import Gaussian
from sigmax.models.model import Model
from sigmax.native.fingerprint import fingerprint
from sigmax.native.refusal import user_line
from sigmax.running.current import current
from sigmax.running.prepare import as_filter, prepare
from sigmax.running.run import run
from sigmax.views import words

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

    def __repr__(self) -> str:
        rows = []
        for name, value in self.parameters.items():
            best, std = np.ravel(value), np.ravel(self.std[name])
            said = [words.measured(float(v), float(s)) for v, s in zip(best, std, strict=True)]
            rows.append((name, ", ".join(said)))
        rows += [("log-likelihood", f"{self.log_likelihood:,.6g}"), ("evaluations", f"{self.evaluations:,}")]
        return words.text("Fit" if self.converged else f"Fit that did not converge: {self.message}", rows)


def fit(
    filter: Filter | str,
    build: Callable[[Parameters], tuple[Model, Gaussian]],
    start: Mapping[str, Any],
    z: Any,
    *,
    dt: Any = 1.0,
    inputs: Any = None,
    R: Any = None,
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
        R: as in `run`.
        update_first: as in `run`.
        positive: names of parameters that must stay positive (deviations, densities): they are
            searched by their logarithm.

    Returns:
        The fit. L-BFGS of SciPy; the first evaluation compiles for some seconds, and no later one of the same filter,
        `build` and sizes.

    Raises:
        InputError: where a name is not known, or the likelihood at the start is not finite.
    """
    chosen, values, kept_positive = as_filter(filter), _values(start), _positive(positive, start)
    for name in kept_positive:
        if not (values[name] > 0).all():
            raise InputError(f"{name} is to stay positive and starts at {values[name]}")
    model, prior = _built(build, {k: jnp.asarray(v) for k, v in values.items()})
    checked = prepare(chosen, model, prior, z, dt, inputs, "float64", update_first, R=R)
    inside = {k: np.log(v) if k in kept_positive else v for k, v in values.items()}
    flat, unravel = ravel_pytree(inside)
    unit = np.where(np.asarray(flat) == 0, 1.0, np.maximum(np.abs(flat), 1e-3))
    unit = np.concatenate([np.ones(v.size) if k in kept_positive else u for (k, v), u in _split(inside, unit)])
    shapes = tuple((k, v.shape) for k, v in sorted(values.items()))
    # Where it can be seen that `build` and all that it reads is as it was, what was compiled is found again.
    known = fingerprint(build)
    remembered = _objective if known is not None else _objective.__wrapped__
    objective = remembered(chosen, current(build), known, shapes, kept_positive, update_first)
    record = jax.tree.map(
        jnp.asarray,
        (
            _by_sensor("z", z),
            checked.dt,
            None if inputs is None else numbers("inputs", inputs),
            None if R is None else _by_sensor("R", R),
        ),
    )

    evaluations = 0

    def evaluate(vector: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal evaluations
        evaluations += 1
        value, gradient = objective(jnp.asarray(vector * unit), *record)
        return float(value), np.nan_to_num(np.asarray(gradient) * unit, posinf=0.0, neginf=0.0)

    begin = np.asarray(flat) / unit
    value, _ = evaluate(begin)
    if not np.isfinite(value):
        faults = run(chosen, model, prior, z, dt=dt, inputs=inputs, R=R, update_first=update_first).faults(1)
        raise InputError(
            f"the log-likelihood at the start is not finite ({'; '.join(faults) or value}); start elsewhere"
        )
    from scipy.optimize import minimize  # as long to import as all of this package

    found = minimize(evaluate, begin, jac=True, method="L-BFGS-B")
    best = _outside(unravel(jnp.asarray(found.x * unit)), kept_positive)
    deviation = _deviations(evaluate, found.x) * unit
    named = unravel(jnp.asarray(deviation))
    std = {k: np.asarray(best[k] * v if k in kept_positive else v) for k, v in named.items()}
    return Fit(
        {k: np.asarray(v) for k, v in best.items()},
        std,
        -float(found.fun),
        bool(found.success),
        str(found.message),
        evaluations,
    )


@lru_cache(maxsize=32)
def _objective(
    filter: Filter,
    build: Callable[[Parameters], tuple[Model, Gaussian]],
    known: str | None,
    shapes: tuple[tuple[str, tuple[int, ...]], ...],
    positive: frozenset[str],
    update_first: bool,
) -> Callable[..., Any]:
    """The negative log-likelihood of a record and its gradient, compiled once: numbers are arguments."""
    _, unravel = ravel_pytree({name: np.zeros(shape) for name, shape in shapes})

    def negative(vector: Any, z: Any, dt: Any, inputs: Any, R: Any) -> Any:
        model, prior = _built(build, _outside(unravel(vector), positive))
        done = run(filter, model, prior, z, dt=dt, inputs=inputs, R=R, update_first=update_first, keep=("fault",))
        return jnp.where(done.ok.all(), -jnp.sum(done.log_likelihood), jnp.inf)

    return compiled(jax.value_and_grad(negative))


def _built(build: Callable[[Parameters], tuple[Model, Gaussian]], parameters: Parameters) -> tuple[Model, Gaussian]:
    """The model and the prior of parameters.

    Raises:
        InputError: where it gives something else, or needs numbers that are not known while it is compiled.
    """
    if not callable(build) or isinstance(build, type):
        raise InputError(f"build must be a function of parameters by name; it is {type(build).__name__}")
    try:
        made = build(parameters)
    except jax.errors.JAXTypeError as error:
        where = user_line(error)
        raise InputError(
            f"build needs its numbers to be known while it is compiled{f' ({where})' if where else ''}: compute with "
            "jax.numpy, without float() or NumPy"
        ) from error
    if not (
        isinstance(made, tuple) and len(made) == 2 and isinstance(made[0], Model) and isinstance(made[1], Gaussian)
    ):
        raise InputError(f"build must return a pair (sigmax.Model, sigmax.Gaussian); it returns {type(made).__name__}")
    return made


def _outside(inside: Parameters, positive: Collection[str]) -> Parameters:
    """Parameters from what is searched: the logarithms of those that stay positive."""
    return {k: jnp.exp(v) if k in positive else v for k, v in inside.items()}


def _by_sensor(what: str, given: Any) -> Any:
    if isinstance(given, Mapping):
        return {s: numbers(f"{what}[{s!r}]", v, missing=True) for s, v in given.items()}
    return numbers(what, given, missing=True)


def _values(start: Mapping[str, Any]) -> dict[str, np.ndarray]:
    if not isinstance(start, Mapping) or not start:
        raise InputError(
            f"start must name the parameters and where they start, such as {{'sigma': 1.0}}; it is {start!r}"
        )
    values = {name: np.asarray(numbers(name, value), float) for name, value in start.items()}
    for name, value in values.items():
        finite(f"{name} at the start", value)
    return values


def _positive(positive: Collection[str], start: Mapping[str, Any]) -> frozenset[str]:
    names = frozenset(strings("positive", positive, ordered=False))
    for name in names:
        if name not in start:
            raise unknown("parameter", name, start)
    return names


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
