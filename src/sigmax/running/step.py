"""One step of any filter on any model: pure functions of small arrays that trace to plain operations."""

import math
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import Lifted, wrap
from sigmax.algebra.factor import Matrix, tria
from sigmax.filters import Filter
from sigmax.models.evaluate import motion_noise, moving, sensing, sensor_noise
from sigmax.models.model import Model, Noise

LOG_2PI = math.log(2 * math.pi)


class Fault(IntEnum):
    """Why a step of a track was not sound; the state stays as it was before the half-step that failed."""

    NONE = 0
    MOTION_NOT_FINITE = 1
    MOTION_NOISE_INDEFINITE = 2
    PREDICTION_INDEFINITE = 3
    SENSOR_NOT_FINITE = 4
    SENSOR_NOISE_INDEFINITE = 5
    CORRECTION_INDEFINITE = 6

    @property
    def message(self) -> str:
        """The fault in words."""
        return _MESSAGES[self]


_MESSAGES = {
    Fault.NONE: "sound",
    Fault.MOTION_NOT_FINITE: "the motion gave a state or a derivative that is not finite",
    Fault.MOTION_NOISE_INDEFINITE: "Q is not positive semidefinite at this step",
    Fault.PREDICTION_INDEFINITE: "the predicted covariance is not positive definite",
    Fault.SENSOR_NOT_FINITE: "the sensor function or the measurement is not finite",
    Fault.SENSOR_NOISE_INDEFINITE: "R is not positive semidefinite at this step",
    Fault.CORRECTION_INDEFINITE: "the covariance of the innovation or of the corrected state is not positive definite",
}


class Belief(NamedTuple):
    """What a filter knows: mean (n, ...), factor (n, n, ...), what the form carries beside it."""

    mean: Any
    factor: Any
    carried: Any


class Innovation(NamedTuple):
    """What one measurement said.

    Attributes:
        residual: ν (m, ...), NaN where a component was missing.
        factor: S_y (m, m, ...), the factor of its covariance; 0 where nothing was seen.
        nis: νᵀ (S_y S_yᵀ)⁻¹ ν (...), over the components seen.
        log_likelihood: of the measurement (...).
        dof: number of components seen and used (...).
    """

    residual: Any
    factor: Any
    nis: Any
    log_likelihood: Any
    dof: Any


def begin(filter: Filter, mean: jax.Array, factor: jax.Array) -> Belief:
    """The belief of a prior given by its factor."""
    return Belief(mean, factor, filter.form.start(factor))


def predict(
    filter: Filter, model: Model, root: Matrix | None, belief: Belief, dt: jax.Array, u: jax.Array | None
) -> tuple[Belief, jax.Array]:
    """The belief dt later, and the fault (...) of each member of the batch.

    `root` is the factor of a Q that is given as numbers (`noise_root(model.Q)`).
    """
    x, S, _ = belief
    with jax.named_scope("the motion, linearised"):
        line = filter.predict(moving(model, dt, u, x.ndim > 1), x, S, model.angular)
    with jax.named_scope("the noise of the motion"):
        Lq, noise_sound = motion_noise(model, root, x, dt, u)
    with jax.named_scope("the predicted covariance"):
        predicted = filter.form.predict(line, Lq)
    new = _in_domain(filter, model, Belief(line.mean, predicted.factor, predicted.carried))
    with jax.named_scope("is it sound?"):
        fault = _first(
            (~_finite(line.mean, line.slope, line.residual), Fault.MOTION_NOT_FINITE),
            (~noise_sound, Fault.MOTION_NOISE_INDEFINITE),
            (~(predicted.sound & _finite(new.mean, new.factor)), Fault.PREDICTION_INDEFINITE),
        )
        return _keep(fault == 0, new, belief), fault


def correct(
    filter: Filter, model: Model, sensor: str, R: Noise, belief: Belief, z: jax.Array, u: jax.Array | None
) -> tuple[Belief, Innovation, jax.Array]:
    """The belief after a measurement z (m, ...) of one sensor, NaN in it meaning missing."""
    x, S, carried = belief
    seen = ~jnp.isnan(z)
    angular = model.measured_angular(sensor, z.shape[0])
    with jax.named_scope("the sensor, linearised"):
        line = filter.correct(sensing(model, sensor, u, x.ndim > 1), x, S, angular)
    with jax.named_scope("the noise of the sensor"):
        Lr, noise_sound = sensor_noise(R, x, u, seen)
    innovation = jnp.where(seen, wrap(jnp.where(seen, z, 0) - line.mean, angular), 0)
    line = line._replace(
        slope=jnp.where(seen[:, None], line.slope, 0),
        residual=jnp.where(seen[:, None], line.residual, 0),
        deficit=jnp.where(seen[:, None], line.deficit, 0),
    )
    with jax.named_scope("the correction"):
        done = filter.form.correct(S, carried, line, Lr, innovation)
    moved = Belief(wrap(x + done.shift, model.angular), done.factor, done.carried)
    new = _in_domain(filter, model, moved)
    diagonal = jnp.stack([done.innovation_factor[i, i] for i in range(z.shape[0])])
    sound = done.sound & (diagonal > 0).all(0) & _finite(new.mean, new.factor)
    fault = _first(
        (~_finite(innovation, line.slope, line.residual), Fault.SENSOR_NOT_FINITE),
        (~noise_sound, Fault.SENSOR_NOISE_INDEFINITE),
        (~sound, Fault.CORRECTION_INDEFINITE),
    )
    count = seen.sum(0)
    used = (count > 0) & (fault == 0)
    nis = (done.whitened**2).sum(0)
    volume = jnp.log(jnp.where(diagonal > 0, diagonal, 1)).sum(0)
    told = Innovation(
        residual=jnp.where(seen, innovation, jnp.nan),
        factor=jnp.where(count > 0, done.innovation_factor, 0),
        nis=jnp.where(used, nis, jnp.nan),
        log_likelihood=jnp.where(used, -0.5 * (nis + count * LOG_2PI) - volume, 0),
        dof=jnp.where(used, count, 0),
    )
    return _keep(used, new, belief), told, jnp.where(count > 0, fault, 0)


def _in_domain(filter: Filter, model: Model, belief: Belief) -> Belief:
    """The belief with the model's domain applied to the mean and, by its derivative, to the factor."""
    if model.domain is None:
        return belief
    function = Lifted(model.domain, [], belief.mean.ndim > 1)
    mean, derivative = jax.linearize(function, belief.mean)
    factor = tria(jax.vmap(derivative, in_axes=1, out_axes=1)(belief.factor))
    return begin(filter, wrap(mean, model.angular), factor)


def _finite(*arrays: jax.Array) -> jax.Array:
    """Whether all the numbers of each member of the batch are finite: a sum carries NaN and infinity on."""
    total = sum((a.sum(tuple(range(_core(a, arrays[0])))) for a in arrays[1:]), start=arrays[0].sum(0))
    return jnp.isfinite(total)


def _core(a: jax.Array, vector: jax.Array) -> int:
    return a.ndim - (vector.ndim - 1)


def _first(*causes: tuple[jax.Array, Fault]) -> jax.Array:
    fault = jnp.zeros(causes[0][0].shape, jnp.int8)
    for failed, cause in reversed(causes):
        fault = jnp.where(failed, jnp.int8(cause), fault)
    return fault


def _keep(accept: jax.Array, new: Belief, old: Belief) -> Belief:
    # XLA repeats cheap operations in every entry that reads them, and the whole chain of checks is cheap
    # one by one. A square root counts as dear: with it the checks are made once for each track.
    accept = jnp.sqrt(jnp.where(accept, 1.0, 0.0)) > 0.5
    return jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, old)
