"""How a function is compiled for numbers that are known."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

# The newer emitters of XLA's CPU compiler take two to six times as long over a step of a filter,
# and what they make is slower.
_FOR_CPU = {"xla_cpu_use_fusion_emitters": False}


@cache
def _options() -> dict[str, Any] | None:
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda: 0, compiler_options=_FOR_CPU)()
    except Exception:  # an XLA that does not know the option says so in more than one way
        return None
    return _FOR_CPU


def tracing() -> bool:
    """Whether the caller is being traced, as under `jax.jit` or `jax.grad`."""
    return isinstance(jnp.zeros(()) + 0, jax.core.Tracer)


def compiled(function: Callable[..., Any], static: tuple[int, ...] = ()) -> Callable[..., Any]:
    """`function` compiled for calls from outside any trace; options belong to the outermost compilation only."""

    @cache
    def made() -> Any:
        return jax.jit(function, static_argnums=static, compiler_options=_options())

    return lambda *arguments: made()(*arguments)
