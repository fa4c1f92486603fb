"""Functions as they are now: what was traced from them is found again as long as what they read stays the same.

Everything that is remembered of a function (steps, checks, compilations) is remembered of the function that
`current` gives, which is another one as soon as something that the user's own reads has changed. So no user's object
is ever hashed or compared.
"""

import inspect
import types
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any

import jax

from sigmax.errors import InputError
from sigmax.models.model import Model
from sigmax.models.noise import signature
from sigmax.models.switching import SwitchingModel
from sigmax.running.places import unchanged
from sigmax.running.reading import Reading, read

_MOST = 512


@dataclass
class _Known:
    """A user's function, the one that stands for it, and what it read when that was made."""

    function: Any
    stand_in: Callable[..., Any]
    read: Reading


_known: OrderedDict[tuple[int, ...], _Known] = OrderedDict()
# Functions that JAX itself remembers, and what they read.
_inner: OrderedDict[int, tuple[Any, list[Any]]] = OrderedDict()
_lock = RLock()


def current(function: Any) -> Callable[..., Any]:
    """The function that stands for a user's: the same one as long as nothing that it reads has changed."""
    if getattr(function, "__code__", None) is _CODE:
        return function
    key = _key(function)
    known = _known.get(key)
    if known is not None and _as_it_was(known.read):
        return known.stand_in
    now = read(function)
    with _lock:
        _forget(now.within)
        known = _known.get(key)
        if known is None or known.read.values != now.values:
            known = _known[key] = _Known(function, _standing_for(function), now)
            while len(_known) > _MOST:
                _known.popitem(last=False)
        known.read = now
        _known.move_to_end(key)
        return known.stand_in


def _as_it_was(then: Reading) -> bool:
    """Whether all that was read is still there, and JAX remembers nothing else of what it remembers by itself."""
    return unchanged(then.places) and all(_inner.get(key) is known for key, known in then.within.items())


def check_model(model: Any) -> None:
    """Refuse what is no model."""
    if not isinstance(model, Model):
        raise InputError(f"model must be a sigmax.Model, it is {type(model).__name__}")


def current_model(model: Model) -> Model:
    """The model with its functions as they are now.

    Raises:
        InputError: where it is something else.
    """
    check_model(model)
    if isinstance(model, SwitchingModel):
        switching = model.with_models([current_model(m) for m in model.models])
        switching.transition = _if_function(model.transition)
        return switching
    made = object.__new__(Model)
    made.__dict__.update(
        model.__dict__,
        motion=current(model.motion),
        sensors={s: current(h) for s, h in model.sensors.items()},
        domain=None if model.domain is None else current(model.domain),
        constraints=tuple(replace(c, function=current(c.function)) for c in model.constraints),
        Q=_if_function(model.Q),
        R={s: _if_function(R) for s, R in model.R.items()},
    )
    if model.bias is not None:
        made.bias = bias = object.__new__(type(model.bias))
        bias.__dict__.update(
            model.bias.__dict__,
            motion=_if_function(model.bias.motion),
            sensor={s: _if_function(F) for s, F in model.bias.sensor.items()},
            Q=_if_function(model.bias.Q),
        )
    return made


def _if_function(noise: Any) -> Any:
    return current(noise) if callable(noise) else noise


def _key(function: Any) -> tuple[int, ...]:
    # A method is another object whenever it is asked for.
    return (id(function.__self__), id(function.__func__)) if type(function) is types.MethodType else (id(function),)


def _standing_for(function: Any) -> Callable[..., Any]:
    def stand_in(*arguments: Any) -> Any:
        return _called(function, arguments)

    stand_in.__wrapped__ = function  # type: ignore[attr-defined]
    for name in ("__name__", "__qualname__", "__doc__"):
        value = getattr(function, name, None)
        if isinstance(value, str):
            setattr(stand_in, name, value)
    try:
        stand_in.__signature__ = signature(function)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        stand_in.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [inspect.Parameter("x", inspect.Parameter.POSITIONAL_ONLY)]
        )
    return stand_in


_CODE = _standing_for(len).__code__


def _called(function: Any, arguments: tuple[Any, ...]) -> Any:
    """What a function gives, while it is traced.

    Where it reads something else by now than when its stand-in was made, that one is not to be found again; what it
    changes itself, a count of its calls or an import, is no such change.
    """
    key = _key(function)
    known = _known.get(key)
    if known is None:
        return function(*arguments)
    if read(function).values != known.read.values:
        with _lock:
            if _known.get(key) is known:
                del _known[key]
        return function(*arguments)
    made = function(*arguments)
    known.read = read(function)
    return made


def _forget(within: dict[int, tuple[Any, list[Any]]]) -> None:
    """Make JAX forget what it traced, where a function that it remembers reads something else by now."""
    changed = False
    for key, (thing, values) in within.items():
        before = _inner.get(key)
        changed |= before is not None and before[0] is thing and before[1] != values
        _inner[key] = within[key]
        _inner.move_to_end(key)
    while len(_inner) > _MOST:
        _inner.popitem(last=False)
    if changed:
        jax.clear_caches()
