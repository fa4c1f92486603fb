"""The models of all parameters as one model that reads them from its inputs, behind its own."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Literal

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.fitting.search import Parameters, Search
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of
from sigmax.modelling.switching import SwitchingModel
from sigmax.native import Refused
from sigmax.native.refusal import user_line
from sigmax.rewriting.augment import augment

Build = Callable[[Parameters], tuple[Model, Gaussian]]


def model_and_prior(build: Build, parameters: Parameters) -> tuple[Model, Gaussian]:
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


def parametric_model(
    build: Build, search: Search, filter: Filter, given: Model, own: int, noises: tuple[str, ...]
) -> Model:
    """The parametric model of a build.

    Args:
        build: parameters -> (model, prior); a function of `current`.
        search: the p parameters.
        filter: whose form says where a bias stands in the state.
        given: the model at the start, ready to run, its bias in the state; it reads `own` inputs.
        own: how many; the parameters are behind them.
        noises: sensors whose R stands among these inputs, row by row.

    Raises:
        Refused: where something depends on the parameters that does not read inputs.
    """
    first = filter.form.bias_first

    def of(theta: Any) -> Model:
        return augment(model_and_prior(build, search.named(theta))[0], first)

    return _parametric(of, given, own, noises, search.size)


def _parametric(of: Callable[[Any], Model], given: Model, own: int, noises: tuple[str, ...], p: int) -> Model:
    if given.inside or given.fusion is not None:
        raise Refused("noises inside functions, and fused sensors, take their parameters from XLA alone")
    still = given.domain is not None or given.constraints or isinstance(given, SwitchingModel)
    if still and depends(lambda theta: _fixed(of(theta)), p):
        raise Refused("domain, constraints, modes and transitions take their parameters from XLA alone")
    if isinstance(given, SwitchingModel):
        models = [_parametric(_mode(of, i), m, own, noises, p) for i, m in enumerate(given.models)]
        return given.with_models(models).with_parts(
            motion_inputs=True, sensor_inputs=dict.fromkeys(given.sensors, True), inputs=None
        )

    def moved(x: Any, dt: Any, u: Any) -> Any:
        model = of(u[own:])
        return model.motion(x, dt, *((u[:own],) if model.motion_inputs else ()))

    def noise(x: Any, dt: Any, u: Any) -> Any:
        Q = of(u[own:]).Q
        if callable(Q):
            return Q(*arguments_of(Q, "Q", OF_MOTION, x, dt, (u[:own],) if own else ()))
        return jnp.asarray(Q.entries if isinstance(Q, Diagonal) else Q) * dt

    sensors = {s: _sensor(of, s, own) for s in given.sensors}
    R = {s: _read(given.R[s], own) if s in noises else _noise_of_sensor(of, s, own) for s in given.sensors}
    return given.with_parts(
        motion=moved, motion_inputs=True, sensors=sensors, sensor_inputs=dict.fromkeys(sensors, True), Q=noise, R=R,
        inputs=None,
    )  # fmt: skip


def _mode(of: Callable[[Any], Any], i: int) -> Callable[[Any], Model]:
    def mode(theta: Any) -> Model:
        found: Model = of(theta).models[i]
        return found

    return mode


def _sensor(of: Callable[[Any], Model], s: str, own: int) -> Callable[..., Any]:
    def seen(x: Any, u: Any) -> Any:
        model = of(u[own:])
        return model.sensors[s](x, *((u[:own],) if model.sensor_inputs[s] else ()))

    return seen


def _noise_of_sensor(of: Callable[[Any], Model], s: str, own: int) -> Callable[..., Any]:
    def noise(x: Any, u: Any) -> Any:
        R = of(u[own:]).R[s]
        if callable(R):
            return R(*arguments_of(R, "R", OF_SENSOR, x, None, (u[:own],) if own else ()))
        return jnp.asarray(R.entries if isinstance(R, Diagonal) else R)

    return noise


def _read(R: Callable[..., Any], own: int) -> Callable[..., Any]:
    """A noise of each row from inputs that end before the parameters."""

    def noise(x: Any, u: Any) -> Any:
        return R(x, u[:own])

    return noise


def _fixed(model: Model) -> list[Any]:
    """What of a model reads no inputs, at some place."""
    x = jnp.ones(model.size)
    found = [] if model.domain is None else [model.domain(x)]
    found += [c.function(x) for c in model.constraints]
    if isinstance(model, SwitchingModel):
        found += [jnp.asarray(model.initial), model.transitions(jnp.ones(()))]
        found += [jnp.asarray(v) for e in model.entry for v in e[1:]]
    return found


def depends(function: Callable[[Any], list[Any]], p: int) -> bool:
    """Whether what a function of p parameters gives depends on any of them."""
    closed = jax.make_jaxpr(function)(jnp.ones(p))
    reached = set(closed.jaxpr.invars)
    for equation in closed.jaxpr.eqns:
        if any(not isinstance(v, Literal) and v in reached for v in equation.invars):
            reached |= set(equation.outvars)
    return any(not isinstance(v, Literal) and v in reached for v in closed.jaxpr.outvars)


@dataclass(frozen=True)
class _Asked:
    """What a parametric model is made of; the model at the start follows from the build."""

    build: Build
    known: str | None
    search: Search
    filter: Filter
    own: int
    noises: tuple[str, ...]
    given: Model = field(compare=False)


def parametric_model_of(
    build: Build, known: str | None, search: Search, filter: Filter, given: Model, own: int, noises: tuple[str, ...]
) -> Model:
    """The parametric model, the same one for a build of which it is known that it has not changed."""
    asked = _Asked(build, known, search, filter, own, noises, given)
    made: Model = (_remembered if known is not None else _remembered.__wrapped__)(asked)
    return made


@lru_cache(maxsize=64)
def _remembered(asked: _Asked) -> Model:
    return parametric_model(asked.build, asked.search, asked.filter, asked.given, asked.own, asked.noises)
