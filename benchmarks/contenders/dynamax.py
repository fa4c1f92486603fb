"""dynamax: filters in JAX, compiled and mapped over the batch as its documentation shows.

It knows no angles (nothing crosses ±π here). It starts at the first measurement, so it is given the
prior moved there. It adds 1e-9 to the diagonal of every innovation covariance, 5 % of the variance of
an azimuth in radians, so measurements are given in units of their standard deviations.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.nonlinear_gaussian_ssm import (
    ParamsNLGSSM,
    UKFHyperParams,
    extended_kalman_filter,
    unscented_kalman_filter,
)

from contenders import Entry
from scenario import DT, Estimate, Q, R, motion, predicted, sensor

jax.config.update("jax_enable_x64", True)

_GIVES = "mean, cov, log-likelihood"


def _ekf(params: ParamsNLGSSM, z: jax.Array) -> Any:
    return extended_kalman_filter(params, z)


def _ukf(params: ParamsNLGSSM, z: jax.Array) -> Any:
    return unscented_kalman_filter(params, z, UKFHyperParams(alpha=1.0, beta=0.0, kappa=0.0))


_FILTERS = {"UKF": ("CKF", _ukf), "EKF": ("EKF", _ekf)}


def _function(kind: str, filtered: Any) -> Callable[[jax.Array], tuple[jax.Array, ...]]:
    mean, cov = predicted(kind)
    params = ParamsNLGSSM(
        initial_mean=jnp.asarray(mean),
        initial_covariance=jnp.asarray(cov),
        dynamics_function=lambda x: motion(x, xp=jnp),
        dynamics_covariance=jnp.diag(jnp.asarray(Q * DT)),
        emission_function=lambda x: sensor(x, xp=jnp) / np.sqrt(R),
        emission_covariance=jnp.eye(len(R)),
    )

    def run(z: jax.Array) -> tuple[jax.Array, ...]:
        # Named outputs only: what is not returned, the compiler leaves out.
        post = filtered(params, z)
        return post.filtered_means, post.filtered_covariances, post.marginal_loglik

    return run


def _estimate(compiled: Any, z: np.ndarray) -> Estimate:
    mean, cov, _ = jax.block_until_ready(compiled(jnp.asarray(z)))
    return Estimate(mean, cov)


def _over_cores(compiled: Any, z: np.ndarray, parts: int) -> Estimate:
    with ThreadPoolExecutor(parts) as pool:
        done = list(pool.map(lambda part: _estimate(compiled, part), np.array_split(z, parts)))
    return Estimate(*(np.concatenate(a) for a in zip(*done, strict=True)))


def batch(z: np.ndarray) -> list[Entry]:
    """`jit(vmap(filter))` in one call, and the same cut over the cores by hand."""
    z, cores, entries = z / np.sqrt(R), os.cpu_count() or 1, []
    for name, (kind, filtered) in _FILTERS.items():
        compiled = jax.jit(jax.vmap(_function(kind, filtered)))
        entries.append(Entry(f"dynamax {name}", kind, _GIVES, lambda c=compiled: _estimate(c, z)))
        if cores > 1:
            cut = f"dynamax {name}, cut over {cores} threads by hand"
            entries.append(Entry(cut, kind, _GIVES, lambda c=compiled: _over_cores(c, z, cores)))
    return entries


def offline(z: np.ndarray) -> list[Entry]:
    """`jit(filter)` on one track."""
    z, entries = z / np.sqrt(R), []
    for name, (kind, filtered) in _FILTERS.items():
        compiled = jax.jit(_function(kind, filtered))
        entries.append(Entry(f"dynamax {name}", kind, _GIVES, lambda c=compiled: _estimate(c, z)))
    return entries
