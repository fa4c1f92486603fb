"""Checks at the edge of the library; values being traced are let through."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError


def is_traced(value: Any) -> bool:
    """Whether a value is being differentiated or compiled, so that its numbers are not known."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def numbers(what: str, value: Any) -> Any:
    """`value` as a floating array.

    Raises:
        InputError: where it does not consist of numbers.
    """
    if is_traced(value):
        return jnp.asarray(value)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"it has the type {array.dtype}")
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be an array of real numbers; {error}") from error
    return array if array.dtype.kind == "f" else array.astype(float)


def finite(what: str, value: Any) -> None:
    """Refuse NaN and infinity.

    Raises:
        InputError: naming the first place that is not finite.
    """
    if not is_traced(value) and not np.isfinite(value).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(np.asarray(value)))[0])
        raise InputError(f"{what} must be finite; it has {np.asarray(value)[place]} at {list(place)}")


def symmetric_semidefinite(what: str, value: Any) -> None:
    """Refuse what is no covariance (..., n, n).

    Raises:
        InputError: with the asymmetry or the negative eigenvalue that was found.
    """
    finite(what, value)
    if is_traced(value):
        return
    P = np.asarray(value, float)
    d = np.sqrt(np.abs(np.einsum("...ii->...i", P)))
    scale = np.maximum(d[..., :, None] * d[..., None, :], np.finfo(float).tiny)
    gap = np.abs(P - np.swapaxes(P, -1, -2)) / scale
    if gap.max(initial=0) > 1e-6:
        *_, i, j = np.unravel_index(gap.argmax(), gap.shape)
        raise InputError(
            f"{what} must be symmetric; entries [{i}, {j}] and [{j}, {i}] differ by {gap.max():.1g} of their scale: "
            f"use ({what} + {what}.T) / 2 if that is rounding"
        )
    smallest = np.linalg.eigvalsh(P / scale * (scale > np.finfo(float).tiny)).min(initial=0.0)
    if smallest < -1e-6:
        raise InputError(
            f"{what} must be positive semidefinite; scaled to unit diagonal it has the eigenvalue {smallest:.3g}: "
            "check the signs of its covariances (variances are squares of standard deviations)"
        )
