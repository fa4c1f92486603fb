"""Truth and measurements of a target whose models take turns."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from sigmax.models import SwitchingModel

Move = Callable[[Any, Any, Any, Any], Any]


def first_mode(model: SwitchingModel) -> Callable[..., Any]:
    """(x, e (n,), r) -> the mode at the start and the state in it, by a uniform number r."""

    def start(x: Any, e: Any, r: Any) -> Any:
        mode = _which(jnp.asarray(model.initial), r)
        return _outside(model, x, mode, e), mode

    return start


def moving_in_turn(model: SwitchingModel, movers: Sequence[Callable[..., Any]]) -> Callable[..., Any]:
    """(x, mode, w (d,), e (n,), r, dt, u) -> the state dt later and its mode, by a uniform number r.

    `movers` move each mode's own components. What a mode does not have is drawn anew by its entry, as a filter of all
    modes supposes.
    """

    def move(x: Any, mode: Any, w: Any, e: Any, r: Any, dt: Any, u: Any) -> Any:
        P = model.transitions(dt)
        new = _which(_of_mode(mode, list(P)), r)
        ways = []
        for own, mover in zip(model.models, movers, strict=True):
            at = jnp.array([model.state.index(name) for name in own.state])
            rows = jnp.array([model.deviations.index(name) for name in own.deviations])
            ways.append(x.at[at].set(mover(x[at], w[rows], dt, u)))
        return _outside(model, _of_mode(new, ways), new, e), new

    return move


def sensing_in_turn(model: SwitchingModel, senses: Sequence[Callable[..., Any]]) -> Callable[..., Any]:
    """(x, mode, v, u) -> what a sensor measures of a target in a mode; `senses` measure each mode's own components."""

    def sense(x: Any, mode: Any, v: Any, u: Any) -> Any:
        places = [jnp.array([model.state.index(name) for name in own.state]) for own in model.models]
        return _of_mode(mode, [sense(x[at], v, u) for at, sense in zip(places, senses, strict=True)])

    return sense


def _outside(model: SwitchingModel, x: Any, mode: Any, e: Any) -> Any:
    """The state with what a mode does not have drawn by its entry, of normal numbers e."""
    ways = []
    for own in model.models:
        new = x
        for name, mean, variance in model.entry:
            if name not in own.state:
                k = model.state.index(name)
                new = new.at[k].set(mean + jnp.sqrt(variance) * e[k])
        ways.append(new)
    return _of_mode(mode, ways)


def _which(p: Any, r: Any) -> Any:
    """The mode of probabilities p (M,) that a uniform number falls on."""
    return (r >= jnp.cumsum(p)[:-1]).sum().astype(r.dtype)


def _of_mode(mode: Any, ways: Sequence[Any]) -> Any:
    found = ways[0]
    for k, way in enumerate(ways[1:], 1):
        found = jax.tree.map(lambda a, b, k=k: jnp.where(mode == k, a, b), way, found)
    return found
