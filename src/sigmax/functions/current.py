"""Functions as they are now: what was traced from them is found again as long as what they read stays the same.

Everything that is remembered of a function (steps, checks, compilations) is remembered of the function that
`current` gives, which is another one as soon as something that the user's own reads has changed. So no user's object
is ever hashed or compared.
"""

import inspect
import types
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, update_wrapper
from threading import RLock
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar
from weakref import WeakSet

import jax
import numpy as np

from sigmax.errors import InputError
from sigmax.functions.environment import Environment, read
from sigmax.functions.places import Place, flags, of_dict, of_object, seen_now, unchanged
from sigmax.modelling.bias import Bias
from sigmax.modelling.checks import is_traced
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import signature
from sigmax.modelling.switching import SwitchingModel

_MOST = 512
T = TypeVar("T")
About = ParamSpec("About")


@dataclass
class _Known:
    """A user's function, the one that stands for it, and what it read when that was made."""

    function: Any
    stand_in: Callable[..., Any]
    read: Environment


class _Current(NamedTuple):
    """A user's model, the one that stands for it, and what it consisted of when that was made."""

    model: Model
    made: Model
    own: list[Place]
    functions: list[tuple[Any, _Known]]


_known: OrderedDict[tuple[int, ...], _Known] = OrderedDict()
# Functions that JAX itself remembers, and what they read.
_inner: OrderedDict[int, tuple[Any, list[Any]]] = OrderedDict()
# Models as they were given, and models of which nothing changes any more.
_models: OrderedDict[int, _Current] = OrderedDict()
_fixed: WeakSet[Model] = WeakSet()
_lock = RLock()


def current(function: Any) -> Callable[..., Any]:
    """The function that stands for a user's: the same one as long as nothing that it reads has changed."""
    return function if getattr(function, "__code__", None) is _CODE else _found(function).stand_in


def _found(function: Any) -> _Known:
    """What is known of a user's function as it is now."""
    key = _key(function)
    known = _known.get(key)
    if known is not None and _as_it_was(known.read):
        return known
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
        return known


def _as_it_was(then: Environment) -> bool:
    """Whether all that was read is still there, and JAX remembers nothing else of what it remembers by itself."""
    return unchanged(then.places) and all(_inner.get(key) is known for key, known in then.within.items())


def check_model(model: Any) -> None:
    """Refuse what is no model."""
    if not isinstance(model, Model):
        raise InputError(f"model must be a sigmax.Model, it is {type(model).__name__}")


def current_model(model: Model) -> Model:
    """The model with its functions as they are now: the same one as long as they and all its numbers are.

    Raises:
        InputError: where it is something else.
    """
    check_model(model)
    if model in _fixed:
        return model
    with _lock:
        known = _models.get(id(model))
        if known is not None and unchanged(known.own) and all(_found(f) is was for f, was in known.functions):
            return known.made
        functions: list[tuple[Any, _Known]] = []
        made = _made_current(model, functions)
        own = list(_places_of(model))
        if any(place.look is flags and not _is_fixed(place.seen) for place in own) or is_traced(model):
            return made
        _models[id(model)] = _Current(model, made, own, functions)
        _fixed.add(made)
        while len(_models) > _MOST:
            _models.popitem(last=False)
        return made


def found_once(find: Callable[Concatenate[Model, About], T]) -> Callable[Concatenate[Model, About], T]:
    """What follows from a model and hashable arguments, found once where nothing of the model changes any more."""
    found: Any = lru_cache(maxsize=_MOST)(find)

    def once(model: Model, /, *about: About.args, **named: About.kwargs) -> T:
        if model not in _fixed:
            return find(model, *about, **named)
        made: T = found(model, *about, **named)
        if isinstance(made, Model):
            _fixed.add(made)
        return made

    update_wrapper(once, find)
    return once


def _places_of(part: Any) -> Iterator[Place]:
    """What a model, or a part of it, consists of; of functions it is remembered elsewhere."""
    if isinstance(part, Model | Bias | Gaussian):
        yield seen_now(of_object, part)
        part = vars(part)
    if isinstance(part, dict):
        yield seen_now(of_dict, part)
        part = tuple(part.values())
    if isinstance(part, tuple):
        for one in part:
            yield from _places_of(one)
    elif isinstance(part, np.ndarray):
        yield seen_now(flags, part)


def _is_fixed(seen: tuple[Any, ...]) -> bool:
    """Whether nobody can write to an array."""
    writeable, base = seen
    return not writeable and base is None


def _made_current(model: Model, functions: list[tuple[Any, _Known]]) -> Model:
    """A model of the functions that stand for its own, which are added to `functions`."""

    def now(function: Any) -> Any:
        if not callable(function) or getattr(function, "__code__", None) is _CODE:
            return function
        functions.append((function, _found(function)))
        return functions[-1][1].stand_in

    if isinstance(model, SwitchingModel):
        switching = model.with_models([_made_current(m, functions) for m in model.models])
        switching.transition = now(model.transition)
        return switching
    made = model.with_parts(
        motion=now(model.motion),
        sensors={s: now(h) for s, h in model.sensors.items()},
        domain=now(model.domain),
        inside=tuple((name, now(joint), size) for name, joint, size in model.inside),
        constraints=tuple(replace(c, function=now(c.function)) for c in model.constraints),
        Q=now(model.Q),
        R={s: now(R) for s, R in model.R.items()},
    )
    if model.bias is not None:
        made.bias = bias = object.__new__(type(model.bias))
        bias.__dict__.update(
            model.bias.__dict__,
            motion=now(model.bias.motion),
            sensor={s: now(F) for s, F in model.bias.sensor.items()},
            Q=now(model.bias.Q),
        )
    return made


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
