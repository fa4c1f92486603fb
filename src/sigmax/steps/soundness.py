"""Whether a step is sound, and what is kept where it is not."""

from typing import Any

import jax
import jax.numpy as jnp


def finite(*arrays: jax.Array) -> jax.Array:
    """Whether all the numbers of each member of the batch are finite: a sum carries NaN and infinity on."""
    total = sum((a.sum(tuple(range(_core(a, arrays[0])))) for a in arrays[1:]), start=arrays[0].sum(0))
    return jnp.isfinite(total)


def _core(a: jax.Array, vector: jax.Array) -> int:
    return a.ndim - (vector.ndim - 1)


def first(*causes: tuple[jax.Array, int]) -> jax.Array:
    """The fault (...) of the first cause that is there, 0 where there is none."""
    fault = jnp.zeros(causes[0][0].shape, jnp.int8)
    for failed, cause in reversed(causes):
        fault = jnp.where(failed, jnp.int8(cause), fault)
    return fault


def kept(accept: jax.Array, new: Any, old: Any) -> Any:
    """What is new where it is accepted (...), else what was before."""
    # XLA repeats cheap operations in every entry that reads them, and the whole chain of checks is cheap
    # one by one. A square root counts as costly: with it the checks are made once for each track.
    accept = jnp.sqrt(jnp.where(accept, 1.0, 0.0)) > 0.5
    return jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
