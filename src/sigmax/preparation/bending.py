"""A bank with too few members for what a sensor bends within the prior: said before a run, for nothing fails."""

import math
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import dense, raised
from sigmax.filters import Bank, Filter
from sigmax.mixtures.splitting import LEAST_NOISE
from sigmax.modelling.checks import is_traced
from sigmax.modelling.evaluate import sensing, sensor_noise
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model

# A split makes three of one; each bends by 0.55² of it.
_GROWTH = math.log(3) / math.log(1 / 0.55**2)
_MOST = 31
_REMEMBERED = 64
_known: dict[tuple[Any, ...], float] = {}


def bending(filter: Filter, model: Model, prior: Gaussian) -> Iterator[str]:
    """Where a measurement within the prior wants more members than a bank has, a sentence for each sensor.

    Members split in three along the direction in which a sensor bends most, until it bends by less than `bend` in each;
    with fewer than that takes, means are off by a fifth of a deviation and more. Of several tracks the widest prior is
    looked at, and sensors that take inputs are left out.
    """
    if not isinstance(filter, Bank) or is_traced((prior.mean, prior.cov)) or prior.dim != model.dim:
        return
    mean, cov = np.asarray(prior.mean, float), np.asarray(prior.cov, float)
    tracks = np.broadcast_shapes(mean.shape[:-1], cov.shape[:-2])
    widest = np.argmax(np.broadcast_to(np.trace(cov, axis1=-2, axis2=-1), tracks))
    x = np.broadcast_to(mean, (*tracks, mean.shape[-1])).reshape(-1, mean.shape[-1])[widest]
    P = np.broadcast_to(cov, (*tracks, *cov.shape[-2:])).reshape(-1, *cov.shape[-2:])[widest]
    values, vectors = np.linalg.eigh(P)
    S = vectors * np.sqrt(np.maximum(values, 0))
    there = filter.kept + 2 * filter.splits
    for name, sensor in model.sensors.items():
        R = model.R[name]
        if model.sensor_inputs[name] or R is None or is_traced(R):
            continue
        # It takes longer than a short run; the same model, noise and prior bend alike again.
        key = sensor, R if callable(R) else np.asarray(jax.tree.leaves(R)[0]).tobytes(), x.tobytes(), S.tobytes()
        bend = _known.get(key)
        if bend is None:
            bend = _bend(model, name, x, S)
            if bend is None:
                continue
            if len(_known) >= _REMEMBERED:
                _known.clear()
            _known[key] = bend
        wanted = (bend / filter.bend) ** _GROWTH
        if not wanted > there:
            continue
        some = math.ceil(wanted) | 1
        instead = f"take members={some}" if some <= _MOST else f"it cannot have more than {_MOST}: narrow the prior"
        yield (
            f"within the prior the sensor{f' {name}' * bool(name)} bends by {bend:.3g} deviations of its noise, for "
            f"which a bank wants about {some} members; {filter.name} has {there}, and its first estimates may be off "
            f"and too sure: {instead}"
        )


def _bend(model: Model, sensor: str, x: np.ndarray, S: np.ndarray) -> float | None:
    """What a sensor departs from its line along a root's direction of most curvature, in deviations of its noise.

    By second differences, as the bank's own splits (`running.splitting`), with an exact eigenvector; None of numbers
    that are not known yet.
    """
    n = S.shape[1]
    i, j = np.tril_indices(n)
    away = S[:, i] + np.where(i == j, 0.0, S[:, j])
    m = jax.eval_shape(model.sensors[sensor], jnp.zeros(model.size)).shape[0]
    onto = model.measured_space(sensor, m)
    offsets = np.concatenate([np.zeros((len(S), 1)), away, -away], axis=1)
    beside = model.space.add(jnp.asarray(np.repeat(x[:, None], offsets.shape[1], axis=1)), jnp.asarray(offsets))
    seen = sensing(model, sensor, jnp.asarray(x), None)(beside)
    noise, _ = sensor_noise(model, model.R[sensor], jnp.asarray(x), None, jnp.ones(m, bool))
    if is_traced((seen, noise)):
        return None
    off = np.asarray(onto.difference(seen[:, 1:], jnp.repeat(seen[:, :1], 2 * len(i), axis=1)))
    both = off[:, : len(i)] + off[:, len(i) :]
    H = np.zeros((len(both), n, n))
    H[:, i, j] = H[:, j, i] = both
    own = np.einsum("mii->mi", H).copy()
    mixed = (H - own[:, :, None] - own[:, None, :]) / 2
    mixed[:, range(n), range(n)] = own
    mixed = np.where(np.isfinite(mixed), mixed, 0.0)
    size = np.abs(mixed).sum((1, 2))
    L = np.asarray(dense(raised(noise, jnp.asarray(np.where(size > 0, LEAST_NOISE * size, 1.0)))))
    white = np.linalg.solve(L, mixed.reshape(len(both), -1)).reshape(mixed.shape)
    d = np.linalg.eigh(np.einsum("mij,mjk->ik", white, white))[1][:, -1]
    return float(np.sqrt((np.einsum("i,mij,j->m", d, white, d) ** 2).sum() / 2))
