"""Derivatives that a user has, for functions that cannot be traced well or are faster by hand."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from sigmax.tracing import traceable


def with_derivatives(function: Callable[..., Any], jacobian: Callable[..., Any]) -> Callable[..., Any]:
    """`function(x, ...)` with the Jacobian the user gives, `jacobian(x, ...)` (m, n), in x (n,).

    Every rule then uses it; second derivatives are those of `jacobian`. The other arguments
    are taken as constants in derivatives.
    """
    function, jacobian = traceable(function), traceable(jacobian)

    @jax.custom_jvp
    def wrapped(*arguments: Any) -> jax.Array:
        return jnp.asarray(function(*arguments))

    @wrapped.defjvp
    def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
        return wrapped(*primals), jnp.asarray(jacobian(*primals)) @ tangents[0]

    return functools.wraps(function)(lambda *arguments: wrapped(*arguments))
