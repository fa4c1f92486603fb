"""cuthbert: its moment filter (an extended one), and its cubature linearisation with the same steps; no angles."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from cuthbertlib.kalman import filtering
from cuthbertlib.linearize import linearize_moments
from cuthbertlib.quadrature import cubature, linearize

from conforming import MISSING, PARTLY, Steps
from sigmax.conformance import Adapter, Task

jax.config.update("jax_enable_x64", True)


def _root(cov: np.ndarray) -> Any:
    values, vectors = np.linalg.eigh(cov)
    return jnp.asarray(vectors * np.sqrt(np.maximum(values, 0)))


@lru_cache(maxsize=4)
def _steps(sampled: bool, task: Task) -> tuple[Any, Any]:
    roots = _root(task.Q), _root(task.R)

    def line(function: Any, root: Any, m: Any, S: Any) -> Any:
        if sampled:
            return linearize.functional(lambda x: function(x, jnp), root, m, S, cubature.weights(len(task.Q)), "sqrt")
        return linearize_moments(lambda x: (function(x, jnp), root), m)

    moved = jax.jit(lambda m, S: filtering.predict(m, S, *line(task.motion, roots[0], m, S)))
    corrected = jax.jit(lambda m, S, z: filtering.update(m, S, *line(task.sensor, roots[1], m, S), z)[0])
    return moved, corrected


def _start(sampled: bool, task: Task, mean: np.ndarray, cov: np.ndarray) -> Any:
    running = Steps(jnp.asarray(mean), jnp.linalg.cholesky(jnp.asarray(cov)), *_steps(sampled, task))

    class Squared:
        mean = property(lambda self: running.mean)
        cov = property(lambda self: np.asarray(running.cov @ running.cov.T))
        predict = staticmethod(running.predict)
        update = staticmethod(running.update)

    return Squared()


def adapters(name: str, version: str) -> Iterator[Adapter]:
    offers = frozenset({MISSING, PARTLY})
    yield Adapter("cuthbert moments", lambda *given: _start(False, *given), 1, offers, version)
    yield Adapter("cuthbert cubature", lambda *given: _start(True, *given), 3, offers, version)
