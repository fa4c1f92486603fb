"""Predictions and corrections with the user's functions in them, to be compiled whole."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.filterpy.compiled import corrected, predicted
from sigmax.filterpy.compiled_calls import CompiledCall
from sigmax.filterpy.points import plain
from sigmax.modelling.noise import signature
from sigmax.tracing import traceable


class Moved(NamedTuple):
    """A prediction; what FilterPy keeps twice is there twice."""

    mean: Any
    factor: Any
    cov: Any
    prior: Any
    prior_cov: Any
    points: Any
    sound: Any


class Seen(NamedTuple):
    """A correction; see `compiled.Corrected`."""

    mean: Any
    factor: Any
    cov: Any
    post: Any
    post_cov: Any
    z: Any
    residual: Any
    gain: Any
    whitened: Any
    innovation_factor: Any
    innovation: Any
    points: Any
    seen: Any
    sound: Any


class Hooks(NamedTuple):
    """How points are averaged and subtracted, and what is added to a state: FilterPy's hooks, None for sums."""

    mean: Any = None
    residual: Any = None
    add: Any = None


def of_points(now: tuple[Any, ...], moving: bool, names: tuple[str, ...]) -> CompiledCall:
    """The half-step of a function with points, weights and hooks."""
    function, points, Wm, Wc, mean, residual, add = now
    own = plain(points) and points.sqrt is None and points.subtract is np.subtract
    sums = None if residual is np.subtract else residual, None if moving or add is np.add else add
    hooks, build = Hooks(mean, *sums), prediction if moving else correction
    watching = [part for part in (function, *hooks, Wm, Wc) if part is not None]

    def made() -> Any:
        if not own:
            raise InputError("its points are drawn by a function of their own")
        return build(function, points.unit, np.array(Wm), np.array(Wc), hooks, names)

    def calls(x: Any, S: Any, L: Any, first: Any, *rest: Any) -> Any:
        yield function, (np.ravel(x), *((first,) if moving else ()), *ordered(function, 1 + moving, names)(rest))

    return CompiledCall(made, watching, Moved if moving else Seen, len(Wm), calls)


def prediction(fx: Any, unit: np.ndarray, Wm: np.ndarray, Wc: np.ndarray, hooks: Hooks, names: Sequence[str]) -> Any:
    """X (n,), S (n, n), L_q, dt, further arguments -> `Moved`, with the points x + S ξ for the rows ξ of `unit`."""
    move, places = traceable(fx), ordered(fx, 2, names)

    def step(x: Any, S: Any, Lq: Any, dt: Any, *rest: Any) -> Moved:
        drawn = jnp.ravel(x) + unit @ S.T
        moved = jax.vmap(lambda p: _flat(move(p, dt, *places(rest))))(drawn)
        mean = _mean(hooks, moved, Wm)
        slope, missed, taken = _line(_away(hooks, moved, mean), unit, Wc)
        made = predicted(slope, missed, taken, Lq)
        return _moved(x, mean, made, mean + unit @ made.factor.T)

    return step


def correction(hx: Any, unit: np.ndarray, Wm: np.ndarray, Wc: np.ndarray, hooks: Hooks, names: Sequence[str]) -> Any:
    """X (n,), S, L_r, z (m,), further arguments -> `Seen`."""
    see, places = traceable(hx), ordered(hx, 1, names)

    def step(x: Any, S: Any, Lr: Any, z: Any, *rest: Any) -> Seen:
        drawn = jnp.ravel(x) + unit @ S.T
        seen = jax.vmap(lambda p: _flat(see(p, *places(rest))))(drawn)
        mean = _mean(hooks, seen, Wm)
        y = _off(z, mean, hooks.residual)
        slope, missed, taken = _line(_away(hooks, seen, mean), unit, Wc)
        return _seen(x, z, y, corrected(S, slope, missed, taken, Lr, y), hooks.add, drawn, seen)

    return step


def linear_prediction() -> Any:
    """x, S, L_q, F -> `Moved`."""

    def step(x: Any, S: Any, Lq: Any, F: Any) -> Moved:
        none = jnp.zeros((len(F), 0))
        return _moved(x, jnp.ravel(F @ x), predicted(F @ S, none, none, Lq), jnp.zeros(0))

    return step


def linear_correction() -> Any:
    """x, S, L_r, z, H -> `Seen`."""

    def step(x: Any, S: Any, Lr: Any, z: Any, H: Any) -> Seen:
        y, none = _off(z, jnp.ravel(H @ x), None), jnp.zeros((len(H), 0))
        return _seen(x, z, y, corrected(S, H @ S, none, none, Lr, y), None, jnp.zeros(0), jnp.zeros(0))

    return step


def extended_correction(jacobian: Any, hx: Any) -> Any:
    """x, S, L_r, z -> `Seen`, with a line by its Jacobian; both functions take x as it is, also a column."""
    slope, see = traceable(jacobian), traceable(hx)

    def step(x: Any, S: Any, Lr: Any, z: Any) -> Seen:
        H, y = jnp.atleast_2d(jnp.asarray(slope(x))), _off(z, _flat(see(x)), None)
        none = jnp.zeros((len(H), 0))
        return _seen(x, z, y, corrected(S, H @ S, none, none, Lr, y), None, jnp.zeros(0), jnp.zeros(0))

    return step


def _off(z: Any, mean: Any, residual: Any) -> Any:
    """What z is off the expected.

    Raises:
        ValueError: where it has another size.
    """
    if z.size != mean.size:
        raise ValueError("sizes differ")
    flat = jnp.ravel(z)
    return flat - mean if residual is None else _flat(traceable(residual)(flat, mean))


def _moved(x: Any, mean: Any, made: Any, points: Any) -> Moved:
    if mean.size != x.size:
        raise ValueError("sizes differ")
    sound, mean = jnp.where(jnp.isfinite(mean.sum()), made.sound, 0.0), mean.reshape(x.shape)
    return Moved(mean, made.factor, made.cov, mean, made.cov, points, sound)


def _seen(x: Any, z: Any, y: Any, made: Any, add: Any, drawn: Any, seen: Any) -> Seen:
    at = jnp.ravel(x)
    mean = (_flat(traceable(add)(at, made.shift)) if add else at + made.shift).reshape(x.shape)
    sound = jnp.where(jnp.isfinite(mean.sum() + y.sum()), made.sound, 0.0)
    y = y[:, None] if x.ndim == 2 else y
    parts = made.gain, made.whitened, made.innovation_factor, made.innovation
    return Seen(mean, made.factor, made.cov, mean, made.cov, z, y, *parts, drawn, seen, sound)


def ordered(function: Any, before: int, names: Sequence[str]) -> Callable[[Sequence[Any]], Sequence[Any]]:
    """What puts arguments that are given by name where they stand behind the first ones.

    Raises:
        InputError: where they cannot stand there.
    """
    if not names:
        return lambda rest: rest
    try:
        made = signature(function).bind(*[None] * before, **{name: k for k, name in enumerate(names)})
    except TypeError as error:
        raise InputError(str(error)) from error
    order = list(made.args[before:])
    if made.kwargs or sorted(order) != list(range(len(names))):
        raise InputError("arguments by name alone stand in no order")
    return lambda rest: [rest[k] for k in order]


def _flat(value: Any) -> Any:
    return jnp.ravel(jnp.asarray(value))


def _mean(hooks: Hooks, points: Any, weights: np.ndarray) -> Any:
    if hooks.mean is not None:
        return _flat(traceable(hooks.mean)(points, jnp.asarray(weights)))
    return points[0] + weights @ (points - points[0])


def _away(hooks: Hooks, points: Any, mean: Any) -> Any:
    if hooks.residual is None:
        return points - mean
    return jnp.stack([_flat(traceable(hooks.residual)(p, mean)) for p in points])


def _line(away: Any, unit: np.ndarray, w: np.ndarray) -> Any:
    slope = (away.T * w) @ unit
    missed = (away.T - slope @ unit.T) * np.sqrt(np.abs(w))
    return slope, missed[:, w > 0], missed[:, w < 0]


# What holds no function of the user's is the same for all filters.
MOVING, SEEING = CompiledCall(linear_prediction, (), Moved), CompiledCall(linear_correction, (), Seen)
