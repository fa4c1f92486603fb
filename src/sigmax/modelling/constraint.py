"""What is known of every state: functions of it that have a value, or lie between bounds."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError, unknown
from sigmax.modelling.checks import numbers
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.tracing import traceable


@dataclass(frozen=True)
class Constraint:
    """A function of the state (n,) -> (k,) and its bounds, which are equal where it has a value.

    Attributes:
        function: of a state.
        low: k numbers, −inf where there is no bound.
        high: k numbers.
        when: in a step it is taken: "predicted" after the motion, "measured" before the next one.
    """

    function: Callable[..., Any]
    low: tuple[float, ...]
    high: tuple[float, ...]
    when: str = "predicted"


_WHEN = ("predicted", "measured")


def constrain(
    model: Model,
    function: Callable[..., Any],
    *,
    low: Any = None,
    high: Any = None,
    equal: Any = None,
    when: str = "predicted",
) -> Model:
    """The model with something known of each state, on which every step is conditioned, for any filter and form.

    Between bounds the normal distribution is cut off and taken by its mean and covariance; with a value it is
    projected, which is a measurement without noise. Both are corrections of the filter's own form. Several constraints
    are taken one after the other.

    Args:
        model: of one mode.
        function: of a state (n,), giving a number or (k,).
        low: the least that it can be, a number or k of them.
        high: the most.
        equal: its value, in the place of both.
        when: "predicted" for after each motion, before anything is measured; the prior is taken as it is. "measured"
            for after all that was measured in a step, which is before the next motion: nearer to what is exact for
            bounds. Estimates are told as they were before; `constrained` conditions them.

    Raises:
        InputError: for bounds that are none or do not fit, and a model of several modes.
    """
    check_one_mode(model, "constrain")
    if not callable(function):
        raise InputError(f"constrain wants a function of the state; it is {type(function).__name__}")
    g = traceable(function)
    if (equal is None) == (low is None and high is None):
        raise InputError("a constraint has bounds, low= or high= or both, or a value, equal=")
    shape = jax.eval_shape(lambda x: jnp.asarray(g(x)), jax.ShapeDtypeStruct((model.size,), np.float64)).shape
    if len(shape) > 1:
        raise InputError(f"a constraint gives a number or (k,); it gives {shape}")
    size = shape[0] if shape else 1
    least, most = (_bounds(*b, size) for b in ((("equal", equal),) * 2 if low is high is None else _both(low, high)))
    for a, b in zip(least, most, strict=True):
        if not a <= b or a == np.inf or b == -np.inf:
            raise InputError(f"a constraint lies between low and high; they are {a:g} and {b:g}")
    if when not in _WHEN:
        raise unknown("time of a constraint, when=", when, _WHEN)
    return model.with_parts(constraints=(*model.constraints, Constraint(g, least, most, when)))


def _both(low: Any, high: Any) -> tuple[tuple[str, Any], tuple[str, Any]]:
    return ("low", -np.inf if low is None else low), ("high", np.inf if high is None else high)


def _bounds(what: str, given: Any, size: int) -> tuple[float, ...]:
    value = numbers(what, given)
    if value.shape not in ((), (1,), (size,)) or np.isnan(value).any():
        raise InputError(f"{what} of a constraint is a number or {size} of them; it is {given!r}")
    return tuple(np.broadcast_to(value, (size,)).astype(float).tolist())


def of_part(constraints: tuple[Constraint, ...], start: int, size: int) -> tuple[Constraint, ...]:
    """The same of a state of which theirs is a part: so many numbers from a place on."""
    return tuple(Constraint(_of_part(c.function, start, size), c.low, c.high, c.when) for c in constraints)


@lru_cache(maxsize=256)
def _of_part(function: Callable[..., Any], start: int, size: int) -> Callable[..., Any]:
    return lambda X: function(X[start : start + size])
