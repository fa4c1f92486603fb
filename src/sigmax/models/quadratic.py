"""Quadratic functions from their matrices."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import finite, numbers


def quadratic_function(
    name: str, constant: Any, linear: Any, blocks: Any, driven: Any = None
) -> tuple[Callable[..., jax.Array], int]:
    """y_j = c_j + (L x)_j + xᵀ B_j x + (U u)_j, a function of x, or of x and u, and its number of components m.

    The formulas of the polynomial filter need symmetric blocks, which the paper says only in its appendix;
    derivatives are symmetric of themselves, so that any blocks of the same value will do.

    Raises:
        InputError: where the shapes of constant (m,), linear (m, n), blocks (m, n, n) and driven (m, k) do not fit.
    """
    parts = {f"{name}0": constant, f"{name}_x": linear, f"{name}_xx": blocks}
    c, L, B = (numbers(label, value) for label, value in parts.items())
    for label, value in zip(parts, (c, L, B), strict=True):
        finite(label, value)
    if L.ndim != 2 or c.shape != L.shape[:1] or B.shape != (*L.shape, L.shape[-1]):
        raise InputError(
            f"{name}0, {name}_x and {name}_xx must have the shapes (m,), (m, n) and (m, n, n); "
            f"they have {c.shape}, {L.shape} and {B.shape}"
        )
    whole = (B + np.swapaxes(B, 1, 2)) / 2
    U = None if driven is None else numbers(f"{name}_u", driven)
    if U is not None and (U.ndim != 2 or U.shape[0] != len(c)):
        raise InputError(f"{name}_u must have the shape ({len(c)}, k); it has {U.shape}")

    def function(x: jax.Array, *u: jax.Array) -> jax.Array:
        still = jnp.asarray(c) + jnp.asarray(L) @ x + jnp.einsum("i,mij,j->m", x, jnp.asarray(whole), x)
        return still if U is None else still + jnp.asarray(U) @ u[0]

    return function, len(c)
