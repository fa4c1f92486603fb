"""Places where a function reads: how to look there again, and whether it is all still the very same."""

import functools
import types
from collections.abc import Callable, Iterable, Sequence
from operator import is_
from typing import Any, NamedTuple

import numpy as np

_SMALL = 4096  # bytes
_NOTHING = object()


class Place(NamedTuple):
    """Where something was read.

    Attributes:
        look: what gives what is there: a tuple of things, or what an array contains, in one plain value.
        at: what it looks at.
        seen: what was there.
    """

    look: Callable[[Any], Any]
    at: Any
    seen: Any


def unchanged(places: Iterable[Place]) -> bool:
    """Whether each place holds the very things that were seen there; equal ones may have changed, too."""
    try:
        for look, at, seen in places:
            now = look(at)
            if type(seen) is not tuple:
                if now != seen:
                    return False
            elif len(now) != len(seen) or not all(map(is_, now, seen)):
                return False
    except Exception:  # what cannot be looked at any more is no longer the same
        return False
    return True


def seen_now(look: Callable[[Any], Any], at: Any) -> Place:
    """A place with what is there."""
    return Place(look, at, look(at))


def named(names: Sequence[str], there: Any) -> tuple[Any, ...]:
    """What a namespace has under these names; those that it does not have stand for themselves."""
    return tuple([there.get(name, _NOTHING) for name in names])


def of_function(function: Any) -> tuple[Any, ...]:
    """Its code, defaults, what it closes over and its attributes."""
    parts = function.__code__, function.__closure__, *(function.__defaults__ or ())
    return *parts, *of_dict(function.__kwdefaults__ or {}), *of_dict(function.__dict__)


def of_cell(cell: types.CellType) -> tuple[Any, ...]:
    """What a cell of a closure holds, if anything."""
    try:
        return (cell.cell_contents,)
    except ValueError:
        return ()


def of_dict(there: Any) -> tuple[Any, ...]:
    """The keys and values of a mapping."""
    return *there, *there.values()


def of_object(thing: Any) -> tuple[Any, ...]:
    """Its class, and its attributes if it has any."""
    attributes = getattr(thing, "__dict__", None)
    return (type(thing), *of_dict(attributes)) if type(attributes) is dict else (type(thing),)


def of_class(kind: type) -> tuple[Any, ...]:
    """What is defined in a class itself."""
    return of_dict(vars(kind))


def bases(kind: type) -> tuple[Any, ...]:
    """A class and those that it inherits from."""
    return kind.__mro__


def of_partial(thing: functools.partial[Any]) -> tuple[Any, ...]:
    """A function of some arguments, and these."""
    return thing.func, thing.args, thing.keywords


def wrapped(thing: Any) -> tuple[Any, ...]:
    """The function within one that was compiled."""
    return (thing.__wrapped__,)


def items(array: np.ndarray) -> tuple[Any, ...]:
    """The things in an array of objects."""
    return tuple(array.ravel().tolist())


def of_slots(members: Sequence[Any], thing: Any) -> tuple[Any, ...]:
    """What stands in the slots of an object; an empty one stands for itself."""
    found = []
    for member in members:
        try:
            found.append(member.__get__(thing, type(thing)))
        except AttributeError:
            found.append(_NOTHING)
    return tuple(found)


def flags(array: np.ndarray) -> tuple[Any, ...]:
    """Whether an array can be written to, and the array whose numbers it has."""
    return array.flags.writeable, array.base


def content(array: np.ndarray) -> Any:
    """What an array holds, of large ones a hash; of one that nobody can write to, how it is laid out."""
    about = array.dtype.str, array.shape
    if not array.flags.writeable and array.base is None:
        return f"{about}"
    held = array.tobytes()
    if isinstance(array, np.ma.MaskedArray):
        held += np.ma.getmaskarray(array).tobytes()
    return f"{about}".encode() + held if len(held) <= _SMALL else hash((about, held))
