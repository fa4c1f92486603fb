"""dynamax: the steps its filters scan over, in double precision; it has neither angles nor missing measurements."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from dynamax.nonlinear_gaussian_ssm import UKFHyperParams, inference_ekf, inference_ukf

from conforming import Steps
from sigmax.conformance import Adapter, Task

jax.config.update("jax_enable_x64", True)

_NOTHING = jnp.zeros(0)  # inputs


def _functions(task: Task) -> tuple[Any, Any, Any, Any]:
    Q, R = jnp.asarray(task.Q), jnp.asarray(task.R)
    return lambda x, u: task.motion(x, jnp), lambda x, u: task.sensor(x, jnp), Q, R


@lru_cache(maxsize=4)
def _extended(task: Task) -> tuple[Any, Any]:
    f, h, Q, R = _functions(task)
    F, H = jax.jacfwd(f), jax.jacfwd(h)
    moved = jax.jit(lambda m, P: inference_ekf._predict(m, P, f, F, Q, _NOTHING))
    corrected = jax.jit(lambda m, P, z: inference_ekf._condition_on(m, P, h, H, R, _NOTHING, z, 1))
    return moved, corrected


@lru_cache(maxsize=4)
def _unscented(task: Task) -> tuple[Any, Any]:
    f, h, Q, R = _functions(task)
    alpha, beta, kappa = UKFHyperParams()
    n = len(task.Q)
    scale = inference_ukf._compute_lambda(alpha, kappa, n)
    weights = inference_ukf._compute_weights(n, alpha, beta, scale)
    moved = jax.jit(lambda m, P: inference_ukf._predict(m, P, f, Q, scale, *weights, _NOTHING)[:2])
    corrected = jax.jit(lambda m, P, z: inference_ukf._condition_on(m, P, h, R, scale, *weights, _NOTHING, z)[1:])
    return moved, corrected


def adapters(name: str, version: str) -> Iterator[Adapter]:
    def start(kind: Any) -> Any:
        return lambda task, mean, cov: Steps(jnp.asarray(mean), jnp.asarray(cov), *kind(task))

    yield Adapter("dynamax EKF", start(_extended), 1, frozenset(), version)
    yield Adapter("dynamax UKF", start(_unscented), 3, frozenset(), version)
