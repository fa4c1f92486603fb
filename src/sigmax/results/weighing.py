"""What an update made of each measurement: the weights that it took it with."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular

from sigmax.filters import Weight
from sigmax.modelling.checks import is_traced
from sigmax.steps.step import Innovation


def weights(weight: Weight | None, innovation: Innovation) -> Any:
    """The weights ω (..., m) of measured components by their innovation, NaN where nothing was measured or used.

    A function of e = S_y⁻¹ ν as in the step itself, so that nothing has to be stored for it.

    Args:
        weight: of the update, None where every measurement counts in full.
        innovation: with residual (..., m) and factor (..., m, m).
    """
    array = jnp if is_traced((innovation.residual, innovation.factor)) else np
    seen = ~array.isnan(innovation.residual)
    if weight is None:
        return array.where(seen, 1.0, array.nan).astype(innovation.residual.dtype)
    e = whitened(innovation)
    found = weight(jnp.moveaxis(jnp.nan_to_num(e), -1, 0), seen.sum(-1)).weights
    return array.where(array.isnan(e), array.nan, array.asarray(array.moveaxis(found, 0, -1)))


def whitened(innovation: Innovation) -> Any:
    """S_y⁻¹ ν (..., m) of an innovation, NaN where nothing was measured or S_y is none."""
    residual, factor = innovation.residual, innovation.factor
    array = jnp if is_traced((residual, factor)) else np
    seen = ~array.isnan(residual)
    diagonal = array.einsum("...ii->...i", factor)
    sound = (array.isfinite(factor).all((-1, -2)) & (diagonal > 0).all(-1))[..., None]
    whole = jnp.where(sound[..., None], factor, jnp.eye(residual.shape[-1], dtype=residual.dtype))
    e = solve_triangular(whole, jnp.where(seen, residual, 0)[..., None], lower=True)[..., 0]
    return array.where(seen & sound, array.asarray(e), array.nan)
