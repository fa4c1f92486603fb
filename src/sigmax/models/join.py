"""Two motions as one."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.errors import InputError
from sigmax.modelling.checks import numbers
from sigmax.modelling.noise import arrays_of, motion_of, takes
from sigmax.modelling.parts import Motion, made_once
from sigmax.tracing import traceable


@made_once
def join(first: Motion, second: Motion) -> Motion:
    """Two independent motions as one, such as a vehicle and a scale factor of its sensor.

    The noise takes the noises of the two: `join(a, b).noise(a.noise(…), b.noise(…))`. Inputs
    belong to the first.
    """
    for part in (first, second):
        if not isinstance(part, Motion):
            raise InputError(f"join takes two motions, such as motions.constant_velocity(); it was given {part!r}")
    k = len(first.state)
    one, other = traceable(first.function), traceable(second.function)

    def function(x: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        return jnp.concatenate([one(x[:k], dt, *u), other(x[k:], dt)])

    def noise(a: Any, b: Any) -> Any:
        a, b = (of if callable(of) else numbers("the noise of a joined motion", of) for of in (a, b))
        if not callable(a) and not callable(b) and np.ndim(a) == np.ndim(b) == 1:
            return arrays_of((a, b)).concatenate([a, b])

        def Q(dt: jax.Array) -> jax.Array:
            return jax.scipy.linalg.block_diag(_interval(a, dt), _interval(b, dt))

        return Q

    units = [unit for part in (first, second) for unit in part.units or ("",) * len(part.state)]
    joined = motion_of(function, bool(first.inputs))
    return Motion(joined, (*first.state, *second.state), noise, first.inputs, tuple(units))


def _interval(Q: Any, dt: jax.Array) -> jax.Array:
    if callable(Q):
        takes(Q, "Q of a joined motion", (1,))
        return traceable(Q)(dt)
    return jnp.diag(jnp.asarray(Q)) * dt if np.ndim(Q) == 1 else jnp.asarray(Q) * dt
