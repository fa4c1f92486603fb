"""Parts that a model can be made of: a function with the names of what it gives."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax

P = ParamSpec("P")
T = TypeVar("T")


class Motion(NamedTuple):
    """A motion ready to use: `Model(motion=m, Q=m.noise(…), …)`.

    Attributes:
        function: `motion(x, dt)` or `motion(x, dt, u)`.
        state: names of the components, angles marked.
        noise: gives Q from densities or standard deviations per √s, in SI units and radians.
        inputs: names of the inputs u, empty where there are none.
    """

    function: Callable[..., jax.Array]
    state: tuple[str, ...]
    noise: Callable[..., Any]
    inputs: tuple[str, ...] = ()


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


def made_once(make: Callable[P, T]) -> Callable[P, T]:
    """Let equal arguments give the same part, so that a compiled filter is found again."""
    kept = functools.lru_cache(maxsize=256)(make)

    @functools.wraps(make)
    def remembered(*args: P.args, **kwargs: P.kwargs) -> T:
        def fixed(value: Any) -> Any:
            return tuple(value) if isinstance(value, list) else value

        return kept(*map(fixed, args), **{k: fixed(v) for k, v in kwargs.items()})

    return remembered
