"""The optimum by particles: what no filter can do better than, as far as so many particles tell."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import times, wrap, wrapped
from sigmax.algebra.factor import cholesky, dense, inverse_lower, solve_lower, square
from sigmax.engine.vectorized import vectorized
from sigmax.modelling.evaluate import motion_noise, moving, noise_root, sensing, sensor_noise
from sigmax.models import Model
from sigmax.steps.step import Fault
from sigmax.studies.simulate import Drawn, mover, root_of, sizes
from sigmax.studies.study import Study
from sigmax.studies.sums import Estimated

# Rows of particles that are moved in one call; and how many times more there are for the first measurement, of
# which a wide prior leaves few.
_ROWS, _FIRST = 200_000, 16


def particles(
    study: Study, drawn: Drawn, count: int, seed: tuple[int, ...], proposal: str, backend: str | None = None
) -> Estimated:
    """Mean and covariance of the posterior of each run, by sequential importance sampling with resampling.

    Weights are kept as logarithms; a run is resampled systematically where less than half of its particles
    count. The proposal "guided" draws the noise of half of the particles given the measurement, the sensor being
    linearised at each, and weighs all by the mixture of both; "bootstrap" draws it as the motion does.
    O(runs × steps × particles).

    Args:
        study: what truth and filters share.
        drawn: the runs.
        count: N, for each run.
        seed: numbers from which all draws come.
        proposal: "guided" or "bootstrap".
        backend: as in `run`.
    """
    model = study.model
    functions = _functions(model, tuple(sizes(study).items()), proposal)
    rng = np.random.default_rng(seed)
    B, T, n = drawn.truth.shape
    mean, cov, failed = np.empty((B, T, n)), np.empty((B, T, n, n)), np.zeros((B, T), bool)
    size = max(1, _ROWS // (count * _FIRST))
    for first in range(0, B, size):
        part = slice(first, min(first + size, B))
        mean[part], cov[part], failed[part] = _runs(study, drawn, part, count, functions, rng, backend)
    (factor,) = vectorized(root_of, cov.reshape(B * T, n, n), backend=backend)
    nothing = np.full((B, T), np.nan)
    fault = np.where(failed, Fault.SENSOR_NOT_FINITE, Fault.NONE).astype(np.int8)
    return Estimated(mean, factor.reshape(cov.shape), fault, nothing, np.zeros((B, T), int))


@np.errstate(over="ignore", invalid="ignore")  # particles of a motion that escapes
def _runs(
    study: Study,
    drawn: Drawn,
    part: slice,
    N: int,
    move: Callable[..., Any],
    rng: np.random.Generator,
    backend: str | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, covariances and failures of a few runs."""
    angular = np.array(study.model.angular)
    z = np.concatenate([v[part] for v in drawn.z.values()], axis=-1)
    B, T, _ = z.shape
    n = study.model.size
    root = np.asarray(root_of(jnp.asarray(study.prior.cov)))
    M = N * _FIRST
    x = drawn.mean[part][:, None] + rng.standard_normal((B, M, n)) @ root.T
    weight = np.zeros((B, M))
    mean, cov, failed = np.empty((B, T, n)), np.empty((B, T, n, n)), np.zeros((B, T), bool)
    inputs = np.zeros((T, 0)) if study.inputs is None else np.asarray(study.inputs, float)
    for t, dt in enumerate(study.elapsed):
        measured = np.repeat(z[:, t], M, axis=0)
        u = np.broadcast_to(inputs[t], (B * M, inputs.shape[1]))
        blind = np.arange(B * M) % 2.0
        given = (x.reshape(B * M, n), rng.standard_normal((B * M, n)), blind, measured, np.full(B * M, dt), u)
        moved, gained = vectorized(move, *given, backend=backend)
        escaped = ~(np.isfinite(moved).all(1) & np.isfinite(gained))
        moved[escaped], gained[escaped] = 0.0, -np.inf
        x = moved.reshape(B, M, n)
        weight = weight + gained.reshape(B, M)
        top = weight.max(1)
        failed[:, t] = ~np.isfinite(top)
        weight[failed[:, t]] = 0.0
        weight -= weight.max(1)[:, None]
        share = np.exp(weight)
        share /= share.sum(1)[:, None]
        centre = x[:, :1]
        d = wrapped(x - centre, angular)
        shift = np.matmul(share[:, None], d)
        mean[:, t] = wrapped((centre + shift)[:, 0], angular)
        d -= shift
        cov[:, t] = np.matmul((d * share[..., None]).swapaxes(1, 2), d)
        few = np.full(B, True) if M > N else 1 / (share**2).sum(1) < N / 2
        kept = _resampled(x[few], share[few], rng.random(few.sum()), N)
        if M > N:
            x, weight, M = kept, np.zeros((B, N)), N
        else:
            x[few], weight[few] = kept, 0.0
    return mean, cov, failed


def _resampled(x: np.ndarray, share: np.ndarray, offset: np.ndarray, N: int) -> np.ndarray:
    """N particles of each run drawn systematically, each about N times its share."""
    B, M, n = x.shape
    until = np.ceil(share.cumsum(1) * N - offset[:, None]).astype(int)
    until[:, -1] = N
    until = np.clip(until, 0, N)
    often = np.diff(until, axis=1, prepend=0)
    return x.reshape(B * M, n)[np.repeat(np.arange(B * M), often.ravel())].reshape(B, N, n)


@lru_cache(maxsize=16)
def _functions(model: Model, measured: tuple[tuple[str, int], ...], proposal: str) -> Callable[..., Any]:
    """(x, w, blind, z, dt, u) -> the particle dt later and the logarithm of what its weight gains."""
    disturbed, root = mover(model), noise_root(model.Q)

    def misses(x: Any, z: Any, u: Any) -> list[tuple[Any, Any, Any]]:
        """By sensor: the miss in units of its noise (0 where missing), the factor of the noise, what was seen."""
        found, at = [], 0
        for sensor, m in measured:
            part = z[at : at + m]
            at += m
            seen = ~jnp.isnan(part)
            L, _ = sensor_noise(model, model.R[sensor], x, u, seen)
            said = jnp.where(seen, part, 0.0) - sensing(model, sensor, x, u)(x)
            said = wrap(said, model.measured_angular(sensor, m))
            factor = dense(L)
            found.append((solve_lower(factor, jnp.where(seen, said, 0.0)), factor, seen))
        return found

    def likelihood(x: Any, z: Any, u: Any) -> Any:
        total = jnp.zeros(())
        for miss, factor, seen in misses(x, z, u):
            volume = sum(jnp.log(jnp.where(seen[i], factor[i, i], 1.0)) for i in range(len(miss)))
            total = total - 0.5 * (miss**2).sum() - volume
        return total

    def bootstrap(x: Any, w: Any, blind: Any, z: Any, dt: Any, u: Any) -> Any:
        moved = disturbed(x, w, dt, u)
        return moved, likelihood(moved, z, u)

    def guided(x: Any, w: Any, blind: Any, z: Any, dt: Any, u: Any) -> Any:
        centre = wrap(moving(model, x, dt, u)(x), model.angular)
        L = dense(motion_noise(model, root, x, dt, u)[0])

        def missed(noise: Any) -> Any:
            return jnp.concatenate([miss for miss, *_ in misses(centre + times(L, noise), z, u)])

        def solved(at: Any) -> tuple[Any, Any]:
            """With the miss as a straight line of the noise around `at`, noise given z is N(μ, (C Cᵀ)⁻¹)."""
            A = -jax.jacfwd(missed)(at)
            C, _ = cholesky(square(A.T) + jnp.eye(len(x)))
            inverse = inverse_lower(C)
            target = missed(at) + (A * at).sum(1)
            return times(inverse.T, times(inverse, (A * target[:, None]).sum(0))), C

        # Around what the first line gives, for the sensor may bend between.
        middle, C = solved(solved(jnp.zeros_like(x))[0])
        noise = jnp.where(blind > 0, w, middle + times(inverse_lower(C).T, w))
        moved = wrap(centre + times(L, noise), model.angular)
        # Half of the particles move blindly: a line that is wrong must not leave a part of the posterior empty.
        off = times(C.T, noise - middle)
        volume = sum(jnp.log(C[i, i]) for i in range(len(x)))
        aimed, free = volume - 0.5 * (off**2).sum(), -0.5 * (noise**2).sum()
        mixed = jnp.maximum(aimed, free) + jnp.log1p(jnp.exp(-jnp.abs(aimed - free)))
        return moved, likelihood(moved, z, u) + free - mixed + jnp.log(2.0)

    return guided if proposal == "guided" else bootstrap
