"""Numbers that are not known yet, in arrays of NumPy: what a function written in NumPy is called with to be traced.

An array is a real array of NumPy whose elements are objects. So whatever only moves elements about (slices, views,
assignments, stacking) is NumPy's own and means what it always means. What computes goes to JAX, array by array.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.tracing import operations
from sigmax.tracing.gather import gathered
from sigmax.tracing.number import Number, refuse


class Values(np.ndarray):
    """An array of floats, each known or a `Number`."""

    __array_priority__ = 1001.0

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return operations.ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        return operations.function(function, args, options)

    def __jax_array__(self) -> Any:
        return jnp.asarray(gathered(self))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of its numbers, not that they are objects."""
        return np.dtype(gathered(self).dtype)

    def __getitem__(self, index: Any) -> Any:
        if is_traced(index):
            return _looked_up(self, index)
        found = np.ndarray.__getitem__(self, index)
        return np.float64(found) if type(found) is float else found

    def __setitem__(self, index: Any, value: Any) -> None:
        base = self.view(np.ndarray)
        if is_traced(index):
            base[...] = objects(_changed(self, index, value))
            return
        new = objects(value)
        if isinstance(new, np.ndarray) and not isinstance(base[index], np.ndarray):
            # An element is no array.
            new = new.reshape(()).item() if new.size == 1 else float(new)
        base[index] = new

    def astype(self, dtype: Any, *rest: Any, **options: Any) -> Any:
        """In another type; of floats a copy."""
        kind = np.dtype(dtype)
        if kind.kind in "fO":
            return self.copy()
        return wrapped(jnp.asarray(gathered(self)).astype(kind))

    def item(self, *place: Any) -> Any:
        """An element."""
        return self[place] if place else self.reshape(-1)[0] if self.size == 1 else np.ndarray.item(self)

    def tolist(self) -> Any:
        """Its elements."""
        return self.view(np.ndarray).tolist()

    def sort(self, *args: Any, **options: Any) -> None:
        """In place."""
        self[...] = np.sort(self, *args, **options)


def _method(name: str) -> Any:
    def method(self: Values, *args: Any, **options: Any) -> Any:
        return operations.function(getattr(np, name), (self, *args), options)

    return method


for _name in ("sum", "mean", "prod", "cumsum", "cumprod", "std", "var", "max", "min", "dot", "clip", "round", "trace"):
    setattr(Values, _name, _method(_name))
for _name in ("argmax", "argmin", "argsort", "all", "any"):
    setattr(Values, _name, _method(_name))


def is_traced(value: Any) -> bool:
    """Whether a value is, or holds, a number that is not known."""
    if isinstance(value, Number | jax.Array):
        return True
    if isinstance(value, np.ndarray):
        base = value.view(np.ndarray)
        return base.dtype.hasobject and any(map(is_traced, base.ravel().tolist()))
    return isinstance(value, list | tuple) and any(map(is_traced, value))


def wrapped(made: Any) -> Any:
    """What was computed, as a function of NumPy would give it: numbers, `Values`, whole numbers as they are."""
    if isinstance(made, tuple | list):
        parts = map(wrapped, made)
        return type(made)(*parts) if hasattr(made, "_fields") else type(made)(parts)
    if isinstance(made, jax.Array):
        if made.ndim == 0:
            return Number(made)
        array, flat = np.empty(made.shape, object), made.reshape(-1)
        places = array.reshape(-1)
        for k in range(array.size):
            places[k] = Number(flat, k)
        return array.view(Values)
    if isinstance(made, np.ndarray) and made.dtype.kind in "fO" and made.ndim:
        return made.astype(object, copy=made.dtype.kind == "f").view(Values)
    return made.item() if isinstance(made, np.ndarray) and made.dtype.kind == "O" else made


def objects(value: Any) -> Any:
    """A value as one to be put into an array of objects."""
    if isinstance(value, jax.Array):
        value = wrapped(value)
    if isinstance(value, Number):
        alone = np.empty((), object)
        alone[()] = value
        return alone
    if isinstance(value, list | tuple):
        value = array_of(value)
    return value.view(np.ndarray) if isinstance(value, Values) else value


def array_of(value: Any, **options: Any) -> Any:
    """`np.array` where there may be traced numbers in what is given.

    Raises:
        ValueError: where the parts have different shapes, as NumPy does.
    """
    options.pop("copy", None)
    kind = options.pop("dtype", None)
    if isinstance(value, jax.Array):
        value = wrapped(value)
    if not is_traced(value):
        plain = gathered(value) if isinstance(value, Values) else _plain(value)
        return wrapped(np.array(plain, dtype=kind, **options))
    inner = [wrapped(v) if isinstance(v, jax.Array) else v for v in value] if isinstance(value, list | tuple) else value
    made = np.array(inner, dtype=object, **options)
    if any(isinstance(v, np.ndarray | list | tuple | jax.Array) for v in made.ravel().tolist()):
        raise ValueError("setting an array element with a sequence: the parts of the array have different shapes")
    made = made.view(Values)
    return made if kind is None or np.dtype(kind).kind == "f" else made.astype(kind)


def _plain(value: Any) -> Any:
    if isinstance(value, Values):
        return gathered(value)
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def _looked_up(array: Values, index: Any) -> Any:
    """Elements at places that are computed."""
    places = [_place(i) for i in (index if isinstance(index, tuple) else (index,))]
    if any(map(_is_mask, places)):
        refuse("takes those elements of an array for which a condition holds", "write np.where(condition, a, b)")
    return wrapped(jnp.asarray(gathered(array))[tuple(places)])


def _changed(array: Values, index: Any, value: Any) -> Any:
    """The array with a change at places that are computed."""
    whole = jnp.asarray(gathered(array))
    new = gathered(array_of(value) if isinstance(value, list | tuple) else value)
    places = tuple(_place(i) for i in (index if isinstance(index, tuple) else (index,)))
    if len(places) == 1 and _is_mask(places[0]):
        mask = places[0].reshape(places[0].shape + (1,) * (whole.ndim - places[0].ndim))
        return wrapped(jnp.where(mask, new, whole))
    return wrapped(whole.at[places].set(new))


def _is_mask(place: Any) -> bool:
    return hasattr(place, "dtype") and np.dtype(place.dtype).kind == "b"


def _place(index: Any) -> Any:
    if isinstance(index, list):
        index = array_of(index)
    place = gathered(index)
    if hasattr(place, "dtype") and jnp.issubdtype(place.dtype, jnp.floating):
        raise IndexError("only whole numbers are places in an array")
    return place
