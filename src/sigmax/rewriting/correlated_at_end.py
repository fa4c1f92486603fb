"""Noises of motion and of the measurement after it that are correlated: the latter becomes part of the state."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.modelling.bias import joint
from sigmax.modelling.components import Components
from sigmax.modelling.constraint import of_part
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, by_value, motion_of, sensor_of, takes
from sigmax.rewriting.correlated import correlation, correlations_of, covariance_over
from sigmax.spaces import Flat, product

Matrix = tuple[tuple[float, ...], ...]


def correlated_at_end(model: Model, prior: Gaussian, S: Any) -> tuple[Model, Gaussian]:
    """The model whose noise over an interval is correlated with that of the measurement at its end, and its prior.

    S = Cov(w_k, v_{k+1}) of x_{k+1} = f(x_k) + w_k and z_{k+1} = h(x_{k+1}) + v_{k+1}. The noise v becomes part of the
    state, behind it, and is drawn anew with w: the covariance of both over an interval is [[Q, S], [Sᵀ, R]]. Exact
    where f and h are linear. A sensor is heard once in an interval: a second measurement has the same noise.

    Args:
        model: with its bias written into its state, if it has one.
        prior: of its state.
        S: (d, m) of the whole interval; a dict by sensor where there are several, of those that are correlated.

    Raises:
        InputError: for another shape or sensor, an R that is a function, modes, fused sensors, curved spaces.
    """
    given = correlations_of("correlated_at_end", model, S)
    n, matrices, noises = model.size, [], []
    names: list[str] = []
    sensors, R = {s: _seen(h, model.sensor_inputs[s], n, None) for s, h in model.sensors.items()}, dict(model.R)
    for s, value in given.items():
        measured, where = model.measured_deviations(s), s or "the sensor"
        if measured is None or callable(model.R[s]):
            raise InputError(f"R of {where} is a function: its noise, which is part of the state, takes numbers")
        at = n + len(names)
        names += [f"noise_{s}_{name}" if s else f"noise_{name}" for name in measured]
        matrices.append(correlation(model, s, value, len(measured)))
        noises.append(np.asarray(by_value(model.R[s])))
        sensors[s] = _seen(model.sensors[s], model.sensor_inputs[s], n, (at, n + len(names)))
        R[s] = Diagonal(np.zeros(len(measured)))
    whole = np.asarray(jax.scipy.linalg.block_diag(*noises))
    own, Q = model.components, model.Q if callable(model.Q) else by_value(model.Q)
    made = model.with_parts(
        motion=_moved(model.motion, model.motion_inputs, n, len(names)),
        sensors=sensors,
        R=R,
        Q=_together(Q, n, by_value(np.concatenate(matrices, 1)), by_value(whole)),
        components=Components(
            (*own.numbers, *names), (*own.deviations, *names), product(own.space, Flat((False,) * len(names)))
        ),
        constraints=of_part(model.constraints, 0, n),
        domain=None if model.domain is None else _kept(model.domain, n),
    )
    return made, joint(prior, Gaussian(np.zeros(len(names)), whole), False)


@lru_cache(maxsize=256)
def _moved(f: Callable[..., Any], driven: bool, n: int, more: int) -> Callable[..., Any]:
    def moved(X: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        return jnp.concatenate([jnp.asarray(f(X[:n], dt, *u)), jnp.zeros(more, X.dtype)])

    return motion_of(moved, driven)


@lru_cache(maxsize=256)
def _seen(h: Callable[..., Any], driven: bool, n: int, noise: tuple[int, int] | None) -> Callable[..., Any]:
    def measured(X: jax.Array, *u: jax.Array) -> jax.Array:
        z = jnp.asarray(h(X[:n], *u))
        return z if noise is None else z + X[noise[0] : noise[1]]

    return sensor_of(measured, driven)


@lru_cache(maxsize=256)
def _kept(domain: Callable[..., Any], n: int) -> Callable[..., Any]:
    return lambda X: jnp.concatenate([jnp.asarray(domain(X[:n])), X[n:]])


@lru_cache(maxsize=256)
def _together(Q: Any, n: int, S: Matrix, R: Matrix) -> Callable[..., Any]:
    def noise(X: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        value = covariance_over(Q, X[:n], dt, u)
        cross = jnp.asarray(S, X.dtype)
        return jnp.block([[value, cross], [cross.T, jnp.asarray(R, X.dtype)]])

    return motion_of(noise, callable(Q) and takes(Q, "Q", OF_MOTION) == 3)
