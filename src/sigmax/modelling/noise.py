"""Noises of motions and sensors as the engine keeps them."""

import inspect
import types
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.modelling.arguments import not_negative
from sigmax.modelling.checks import is_traced, numbers, own, symmetric_semidefinite
from sigmax.tracing import Traceable, traceable

Noise = Any  # an array, a Diagonal of variances, or a function that gives either

# How many arguments the functions of a noise may take: Q(dt), Q(x, dt), Q(x, dt, u); R(x), R(x, u).
OF_MOTION = (1, 2, 3)
OF_SENSOR = (1, 2)


def signature(function: Callable[..., Any]) -> inspect.Signature:
    """Of a function or of an object that can be called, which is never compared with anything."""
    if isinstance(function, Traceable):
        function = function.function
    call = type(function).__call__
    says_itself = hasattr(function, "__wrapped__") or hasattr(function, "__signature__")
    if isinstance(call, types.FunctionType) and not says_itself:
        return inspect.signature(types.MethodType(call, function))
    return inspect.signature(function)


def takes(function: Callable[..., Any], what: str, allowed: tuple[int, ...]) -> int:
    """How many of the `allowed` numbers of positional arguments a user's function takes."""
    try:
        parameters = signature(function).parameters.values()
    except (TypeError, ValueError):
        return allowed[0]
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    required = sum(p.default is p.empty for p in positional)
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        # The last of them are the inputs u, which only who asks for them needs.
        return allowed[-2] if required <= allowed[-2] else allowed[-1]
    fitting = [k for k in allowed if required <= k <= len(positional)]
    if not fitting:
        wanted = " or ".join(map(str, allowed))
        raise InputError(f"{what} must take {wanted} positional arguments, it takes {required}")
    return fitting[0] if required < len(positional) else fitting[-1]


def arguments_of(
    function: Callable[..., Any], what: str, allowed: tuple[int, ...], x: Any, dt: Any, inputs: Sequence[Any]
) -> tuple[Any, ...]:
    """The arguments that a noise, or a matrix of a bias, takes of state, interval and inputs (none, or u)."""
    count = takes(function, what, allowed)
    if allowed == OF_SENSOR:
        return (x, *inputs)[:count]
    return (dt,) if count == 1 else (x, dt, *inputs)[:count]


def motion_of(function: Callable[..., Any], driven: bool) -> Callable[..., Any]:
    """A function (x, dt, *u) as one of x and dt, and of u where it is `driven`: what `takes` counts."""
    return (lambda x, dt, u: function(x, dt, u)) if driven else (lambda x, dt: function(x, dt))


def sensor_of(function: Callable[..., Any], driven: bool) -> Callable[..., Any]:
    """A function (x, *u) as one of x, and of u where it is `driven`."""
    return (lambda x, u: function(x, u)) if driven else (lambda x: function(x))


def by_value(given: Any) -> Any:
    """Numbers as the rows of a matrix, so that equal ones give the same function; functions and None as they are."""
    if given is None or callable(given):
        return given
    return tuple(map(tuple, np.asarray(dense_noise(given)).tolist()))


def dense_noise(R: Any) -> Any:
    """A noise in numbers as a matrix."""
    return arrays_of(R.entries).diag(R.entries) if isinstance(R, Diagonal) else R


def noise(label: str, given: Any, components: Sequence[str] | None, allowed: tuple[int, ...]) -> Noise:
    """A noise as a function of so many arguments as are `allowed`, a diagonal or a matrix.

    Raises:
        InputError: where it does not fit the components, or is no covariance.
    """
    if isinstance(given, Diagonal):
        return given
    if callable(given):
        takes(given, label, allowed)
        return traceable(given)
    value = own(numbers(label, given))
    n = len(components) if components is not None else value.shape[-1]
    if value.ndim == 0 and n == 1:
        value = own(value[None])
    if value.shape == (n,):
        if not is_traced(value):
            symmetric_semidefinite(label, np.diag(value))
        return Diagonal(value)
    if value.shape != (n, n):
        by_row = value.ndim > 1 and value.shape[-1] == n
        hint = f"; one for each row is a function of the inputs, {label}=lambda x, dt, u: u[…] with inputs= (T, k)"
        hint = hint if allowed == OF_MOTION else "; one for each row is given to run as R="
        raise InputError(
            f"{label} must be a covariance of shape {(n, n)} or {n} variances, for {list(components or [])}; "
            f"this one has the shape {value.shape}{hint if by_row else ''}"
        )
    symmetric_semidefinite(label, value)
    if not is_traced(value) and np.count_nonzero(value - np.diag(np.diagonal(value))) == 0:
        return Diagonal(own(np.diagonal(value)))
    return value


def arrays_of(value: Any) -> Any:
    """NumPy, or JAX for what is traced, such as a parameter that is being fitted."""
    return jnp if is_traced(value) else np


def squares(deviations: Any) -> Any:
    """Variances of standard deviations, one or several; numbers or traced.

    Raises:
        InputError: for a deviation that is none.
    """
    return arrays_of(deviations).square(not_negative("a deviation", deviations))


def of_each(what: str, given: Any, count: int) -> Any:
    """One value for all, or one for each, as an array (count,).

    Raises:
        InputError: for a number of values that is neither, and for one below 0.
    """
    found = not_negative(what, given)
    if np.shape(found) not in ((), (1,), (count,)):
        raise InputError(f"{what} is one number, or {count}; it is {given!r}")
    return arrays_of(found).broadcast_to(found, (count,))


def on_diagonal(variance: Any, axes: int) -> Any:
    """A diagonal matrix from one value for all axes, or one an axis.

    Raises:
        InputError: as `of_each`.
    """
    return arrays_of(variance).diag(of_each("a density", variance, axes))


def noise_once(R: Any, components: Sequence[str] | None) -> Noise:
    """The noise of one measurement, given with it in numbers.

    Raises:
        InputError: as `noise`, and for a function.
    """
    if callable(R):
        raise InputError("R of one measurement must be numbers, its covariance or variances; it is a function")
    return noise("R", R, components, OF_SENSOR)
