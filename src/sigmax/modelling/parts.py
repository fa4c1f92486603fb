"""Parts that a model can be made of: a function with the names of what it gives."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import numpy as np

from sigmax.modelling.checks import is_traced

P = ParamSpec("P")
T = TypeVar("T")


class Motion(NamedTuple):
    """A motion ready to use: `Model(motion=m, Q=m.noise(…), …)`.

    Attributes:
        function: `motion(x, dt)` or `motion(x, dt, u)`.
        state: names of the components, angles marked.
        noise: gives Q from densities or standard deviations per √s, in SI units and radians.
        inputs: names of the inputs u, empty where there are none.
        units: of the components, empty where they are not known.
    """

    function: Callable[..., jax.Array]
    state: tuple[str, ...]
    noise: Callable[..., Any]
    inputs: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


class Sensor(NamedTuple):
    """A sensor ready to use: `Model(sensor=s, R=…, …)`.

    Attributes:
        function: `sensor(x)` or `sensor(x, u)`.
        measurement: names of the components, angles marked.
        inputs: names of the inputs u, empty where there are none.
    """

    function: Callable[..., jax.Array]
    measurement: tuple[str, ...]
    inputs: tuple[str, ...] = ()


class Origin(NamedTuple):
    """What made a function: a callable, its arguments, and which field of the result it is (None: the result)."""

    make: Callable[..., Any]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    field: str | None


def made_again(make: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], field: str | None) -> Any:
    """What an `Origin` stands for."""
    made = make(*args, **kwargs)
    return made if field is None else getattr(made, field)


@dataclass(eq=False)
class PartFunction:
    """A function of a ready-made part, which pickles as how it was made: functions inside functions cannot.

    Attributes:
        function: what it does, and all that it is; how it was made is not a field.
    """

    function: Callable[..., Any]

    def __init__(self, function: Callable[..., Any], origin: Origin) -> None:
        self.function, self._made_by = function, origin
        functools.update_wrapper(self, function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """What the function gives."""
        return self.function(*args, **kwargs)

    def __reduce__(self) -> tuple[Any, ...]:
        return made_again, tuple(self._made_by)


class Maker(PartFunction):
    """A function that makes parts: of equal arguments the same, so that a compiled filter is found again."""

    def __init__(self, function: Callable[..., Any], origin: Origin) -> None:
        super().__init__(function, origin)
        self._parts_made: dict[Any, Any] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """What the arguments make."""
        return self.made(self, args, kwargs)

    def made(self, by: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """The same, where a pickle calls this maker as `by`."""
        args, kwargs = tuple(map(_fixed, args)), {k: _fixed(v) for k, v in kwargs.items()}
        if is_traced((args, kwargs)):
            return self.function(*args, **kwargs)
        key = args, tuple(kwargs.items())
        try:
            found = self._parts_made.get(key)
        except TypeError:  # it cannot be looked up
            return _named(self.function(*args, **kwargs), by, args, kwargs)
        if found is None:
            found = _named(self.function(*args, **kwargs), by, args, kwargs)
            while len(self._parts_made) >= _MOST_KEPT:
                self._parts_made.pop(next(iter(self._parts_made)))
            self._parts_made[key] = found
        return found


_MOST_KEPT = 256


def made_once(make: Callable[P, T]) -> Callable[P, T]:
    """Let equal arguments give the same part, whose functions pickle."""
    maker = Maker(make, Origin(make, (), {}, None))

    @functools.wraps(make)
    def remembered(*args: P.args, **kwargs: P.kwargs) -> T:
        made: T = maker.made(remembered, args, kwargs)
        return made

    return remembered


def _fixed(value: Any) -> Any:
    """Lists and arrays as tuples, which can be looked up."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def _named(made: Any, by: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """A part with its functions named by their origin."""
    if isinstance(made, Motion | Sensor):
        functions = {field: value for field, value in made._asdict().items() if callable(value)}
        named: Any = {
            f: (Maker if f == "noise" else PartFunction)(g, Origin(by, args, kwargs, f)) for f, g in functions.items()
        }
        return made._replace(**named)
    return PartFunction(made, Origin(by, args, kwargs, None)) if callable(made) else made
