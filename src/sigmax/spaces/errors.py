"""Errors of estimates, as people hold them: the components last."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import TWO_PI
from sigmax.spaces.space import Space


def errors(space: Space, mean: Any, truth: Any) -> Any:
    """Mean − truth (..., d) of points (..., n), angles in [-π, π]; of curved parts −(truth ⊟ mean), at the mean.

    NumPy arrays give one, anything else a JAX array. There the covariance of the mean is.
    """
    array: Any = np if all(isinstance(a, np.ndarray) for a in (mean, truth)) else jnp
    if space.flat:
        difference = mean - truth
        if not any(space.periodic):
            return difference
        return difference - TWO_PI * array.where(np.array(space.periodic), array.round(difference / TWO_PI), 0.0)
    truth, mean = array.broadcast_arrays(truth, mean)
    away = space.difference(space.nearest(array.moveaxis(truth, -1, 0)), array.moveaxis(mean, -1, 0))
    return array.moveaxis(-away, 0, -1)
