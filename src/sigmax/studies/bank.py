"""The optimum by a bank of filters: for motions with little noise, where particles that once agree stay the same."""

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import wrapped
from sigmax.engine.vectorized import vectorized
from sigmax.models import Gaussian
from sigmax.running.run import run
from sigmax.studies.simulate import Drawn, root_of
from sigmax.studies.study import Study
from sigmax.studies.sums import Estimated

# The filter of each member, and the numbers that their covariances may take at once.
_MEMBER, _ROOM = "SRCKFB", 12_000_000


@np.errstate(over="ignore", invalid="ignore")
def bank(study: Study, drawn: Drawn, members: int, seed: tuple[int, ...], backend: str | None = None) -> Estimated:
    """Mean and covariance of a mixture of filters that share the prior among them.

    Each member starts at a draw of its own with a part of the prior's covariance, h² with h = N^(-1/(n + 4)), and
    is weighted by the likelihood of what it was told; means are drawn so that the mixture has the moments of the
    prior. What is left of the nonlinearity within one member fades as N grows. O(runs × steps × members).

    Args:
        study: what truth and filters share.
        drawn: the runs.
        members: N, for each run.
        seed: numbers from which all draws come.
        backend: as in `run`.
    """
    rng = np.random.default_rng(seed)
    B, T, n = drawn.truth.shape
    angular = np.array(study.model.angular)
    root = np.asarray(root_of(jnp.asarray(study.prior.cov)))
    h = members ** (-1 / (n + 4))
    mean, cov = np.empty((B, T, n)), np.empty((B, T, n, n))
    fault = np.zeros((B, T), np.int8)
    size = max(1, _ROOM // (members * T * n**2))
    for first in range(0, B, size):
        part = slice(first, min(first + size, B))
        count = part.stop - first
        start = drawn.mean[part][:, None] + np.sqrt(1 - h**2) * rng.standard_normal((count, members, n)) @ root.T
        z = {s: np.repeat(v[part], members, axis=0) for s, v in drawn.z.items()}
        found = run(
            _MEMBER,
            study.model,
            Gaussian(wrapped(start.reshape(-1, n), angular), h**2 * np.asarray(study.prior.cov)),
            z if study.model.several else z[""],
            dt=study.dt,
            inputs=study.inputs,
            keep=("mean", "factor", "fault", "step_log_likelihood"),
            backend=backend,
        )
        x = found.mean.reshape(count, members, T, n)
        weight = found.step_log_likelihood.reshape(count, members, T).cumsum(-1)
        # A member that failed says nothing from then on.
        failed = (found.fault.reshape(count, members, T) > 0).cumsum(-1) > 0
        weight = np.where(failed, -np.inf, weight)
        top = weight.max(1, keepdims=True)
        fault[part] = ~np.isfinite(top[:, 0])
        share = np.exp(np.where(np.isfinite(top), weight - top, 0.0))
        share /= share.sum(1, keepdims=True)
        centre = np.take_along_axis(x, share.argmax(1)[:, None, :, None], axis=1)
        d = wrapped(x - centre, angular)
        shift = np.einsum("bkt,bkti->bti", share, d)
        mean[part] = wrapped(centre[:, 0] + shift, angular)
        d -= shift[:, None]
        inside = np.einsum("bkt,bktij->btij", share, found.cov.reshape(count, members, T, n, n))
        cov[part] = inside + np.einsum("bkt,bkti,bktj->btij", share, d, d, optimize=True)
    (factor,) = vectorized(root_of, cov.reshape(B * T, n, n), backend=backend)
    return Estimated(mean, factor.reshape(cov.shape), fault, np.full((B, T), np.nan), np.zeros((B, T), int))
