"""Whether another linearisation than the filter's explains a record better."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.examination.envelope_runs import Runner, Variant, log_likelihood
from sigmax.examination.record_data import RecordData
from sigmax.examination.search import Candidate, Setup, masked, nis_per_value
from sigmax.filters import Filter, Update, get, once
from sigmax.modelling.model import Model

# What curvature may cost in log-likelihood before others are tried.
_BENT = 0.5
# NIS per value from here on, or below its inverse, leaves much that another linearisation does not explain.
_NEAR = 1.6
# Of degree 3, of order 2, of degree 5, and iterated.
_OTHERS = ("CKF", "SOKF", "HCKF", "IEKF")


def other_linearisations(setup: Setup, theta: np.ndarray, record: RecordData, as_it_stands: float) -> list[Candidate]:
    """What other filters gain in log-likelihood, those that bring the record near to the model."""
    names = [name for name in _OTHERS if name != setup.runner.filter.name]
    found = (_with(setup, theta, record, name, as_it_stands) for name in names)
    return [c for c in found if c is not None]


def with_filter(setup: Setup, name: str) -> Setup:
    """The same search by another filter."""
    old = setup.runner
    runner = Runner(judging(get(name)), old.family, old.update_first)
    return replace(setup, climber=setup.climber._replace(runner=runner))


def judging(filter: Filter) -> Filter:
    """A filter without weights, which would hide outliers; one that iterates goes on doing so."""
    update = filter.update
    if isinstance(update, Update) and update.iterations:
        return replace(filter, update=replace(update, weight=None))
    return replace(filter, update=once)


def _with(setup: Setup, theta: np.ndarray, record: RecordData, name: str, as_it_stands: float) -> Candidate | None:
    (record,), out = masked(with_filter(setup, name), [Variant(theta, record)])
    if not 1 / _NEAR < nis_per_value(out, record) < _NEAR:
        return None
    L = float(log_likelihood(out)[0])
    gain = L - as_it_stands if np.isfinite(as_it_stands) else 1e9 + L / 1e3
    return Candidate("linearisation", name, gain, np.zeros(0), np.nan)


def crude(setup: Setup, theta: np.ndarray, record: RecordData) -> bool:
    """Whether motion and sensors bend within the filter's own spread as far as a log-likelihood shows.

    What a filter of order 1 takes a prediction of sensor i to be is off by Σⱼ ½ (g(x ⊞ sⱼ) + g(x ⊞ −sⱼ) − 2 g(x)),
    g = h ∘ f, sⱼ the columns of a root of P of the step before. The correction takes it for a measurement of the noise
    R, so that half its square over R is about what it costs.
    """
    model, u = setup.runner.family.plain, record.u
    out = setup.runner([Variant(theta, record)])
    means, covs = (a[0] for a in setup.runner.estimates([Variant(theta, record)]))
    x = np.concatenate([record.mean[None], means[:-1]])
    values, vectors = np.linalg.eigh(np.nan_to_num(np.concatenate([record.cov[None], covs[:-1]])))
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    cost = 0.0
    for s in model.sensors:
        off = np.asarray(_bent(model, s)(x, roots, record.dt, u))
        square = off**2 / np.maximum(setup.R[s], 1e-9 * np.einsum("tii->ti", out.S[s][0]))
        cost += 0.5 * float(np.where(out.seen[s], np.nan_to_num(square, nan=np.inf), 0.0).sum())
    return cost > _BENT


@lru_cache(maxsize=8)  # the functions of a model are compiled once for many records
def _bent(model: Model, s: str) -> Any:
    def off(x: Any, root: Any, dt: Any, u: Any) -> Any:
        def seen(x: Any) -> Any:
            y = model.motion(x, dt, u) if model.motion_inputs else model.motion(x, dt)
            return jnp.asarray(model.sensors[s](y, u) if model.sensor_inputs[s] else model.sensors[s](y))

        middle = seen(x)
        space = model.measured_space(s, middle.shape[0])

        def way(d: Any) -> Any:
            there, back = seen(model.space.add(x, d)), seen(model.space.add(x, -d))
            return jnp.abs(space.difference(there, middle) + space.difference(back, middle)) / 2

        return jax.vmap(way, in_axes=1)(root).sum(0)

    return jax.jit(jax.vmap(off))
