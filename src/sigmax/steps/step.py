"""One step of any filter on any model: pure functions of small arrays that trace to plain operations."""

import math
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import diagonal
from sigmax.algebra.factor import Diagonal, Matrix, raised, tria
from sigmax.filters import Filter
from sigmax.forms import Predicted
from sigmax.modelling.evaluate import disturbed_motion, in_domain, sensor_noise
from sigmax.modelling.model import Model
from sigmax.modelling.noise import Noise
from sigmax.rules import Taylor1
from sigmax.rules.charted import linearized
from sigmax.rules.linearization import Linearization
from sigmax.spaces import reset
from sigmax.steps.considering import considered, grown
from sigmax.steps.constraining import conditioned
from sigmax.steps.noise_estimation import estimate_R
from sigmax.steps.soundness import finite, first, kept
from sigmax.steps.updating import ROUNDING, columns_scaled, observing, there, update_on, updated

LOG_2PI = math.log(2 * math.pi)


class Fault(IntEnum):
    """Why a step of a track was not sound.

    Above 0 a half-step failed, and the state stays as it was before it. Below 0 the negative weights of a
    sigma set made a covariance indefinite: the half-step was done without their columns, which makes
    what the straight line misses too large, never too small; or one of several modes or members failed and the
    others went on; or a constraint could not be taken; or components are still open that nothing was known of.
    """

    UNDETERMINED = -5
    CONSTRAINT_LEFT_OUT = -4
    MEMBER_FAILED = -3
    CORRECTION_WIDENED = -2
    PREDICTION_WIDENED = -1
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


_POSITIVE = "take a set without them: alpha = 1 and kappa of at least 0, or cubature of degree 3"
_NO_COVARIANCE = (
    "is not positive semidefinite at this step; its function gave a negative variance, "
    "or a covariance larger than its variances allow"
)
_MESSAGES = {
    Fault.UNDETERMINED: "components of which nothing was known at the start are not determined yet: they are NaN",
    Fault.CONSTRAINT_LEFT_OUT: (
        "a constraint was left out: its function is not finite there, or what is known exactly contradicts it"
    ),
    Fault.MEMBER_FAILED: (
        "one of several modes or members failed and counts nothing until another changes into it or is split; run it "
        "alone to see why"
    ),
    Fault.CORRECTION_WIDENED: (
        f"R + Ω was indefinite by negative weights; the correction was done without them; {_POSITIVE}"
    ),
    Fault.PREDICTION_WIDENED: (
        f"the predicted covariance was indefinite by negative weights; done without them; {_POSITIVE}"
    ),
    Fault.NONE: "sound",
    Fault.MOTION_NOT_FINITE: (
        "the motion gave a state or a derivative that is not finite; one made by sde says so, too, of an interval that "
        "is too long for its steps="
    ),
    Fault.MOTION_NOISE_INDEFINITE: f"Q {_NO_COVARIANCE}",
    Fault.PREDICTION_INDEFINITE: (
        "the predicted covariance is not finite; a direction that no sensor observes may have grown without limit: "
        "bound Q, or measure it now and then"
    ),
    Fault.SENSOR_NOT_FINITE: "the sensor function or the measurement is not finite",
    Fault.SENSOR_NOISE_INDEFINITE: f"R {_NO_COVARIANCE}",
    Fault.CORRECTION_INDEFINITE: (
        "the innovation has no variance, or the corrected state or the NIS is not finite: the measurement is beyond "
        "all reason; or R is 0 where nothing uncertain is measured: give it the "
        "variance of the sensor's last digit, or NaN for the measurement"
    ),
}


class Belief(NamedTuple):
    """What a filter knows: mean (n, ...) and lower factor of the covariance (n, n, ...)."""

    mean: Any
    factor: Any


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


def predict(
    filter: Filter, model: Model, root: Matrix | None, belief: Belief, dt: Any, u: Any, stretch: Any = None
) -> tuple[Belief, jax.Array]:
    """The belief dt later, and the fault (...) of each member of the batch.

    `root` is `noise_root(model.Q)`; the rows of the noise's factor are multiplied by `stretch` (n, ...).
    """
    x, S, begun = conditioned(filter, model, *belief, "measured")
    with jax.named_scope("the motion, linearised, and its noise"):
        line, Lq, noise_sound = disturbed_motion(filter.predict, model, root, x, S, dt, u, stretch)
    with jax.named_scope("the predicted covariance"):
        predicted, widened = _predicted(filter, line, Lq)
    new = _in_domain(model, Belief(line.mean, predicted.factor))
    mean, factor, agreed = conditioned(filter, model, *new, "predicted")
    with jax.named_scope("is it sound?"):
        fault = first(
            (~finite(line.mean, line.slope, line.residual), Fault.MOTION_NOT_FINITE),
            (~noise_sound, Fault.MOTION_NOISE_INDEFINITE),
            (~(predicted.sound & finite(new.mean, new.factor)), Fault.PREDICTION_INDEFINITE),
            (widened, Fault.PREDICTION_WIDENED),
            (~(begun & agreed), Fault.CONSTRAINT_LEFT_OUT),
        )
        return kept(fault <= 0, Belief(mean, factor), belief), fault


class CorrectedBelief(NamedTuple):
    """What a measurement made of a belief.

    Attributes:
        belief: after it.
        innovation: what it said.
        fault: (...), as numbers of `Fault`.
        scale: λ (m, ...) of the sensor after it, see `Noises`; None where R is the model's.
    """

    belief: Belief
    innovation: Innovation
    fault: Any
    scale: Any


def correct(
    filter: Filter, model: Model, sensor: str, R: Noise, belief: Belief, z: jax.Array, u: jax.Array | None
) -> tuple[Belief, Innovation, jax.Array]:
    """The belief after a measurement z (m, ...) of one sensor, NaN in it meaning missing."""
    belief, told, fault, _ = corrected(filter, model, sensor, R, belief, z, u, None)
    return belief, told, fault


def corrected(
    filter: Filter, model: Model, sensor: str, R: Noise, belief: Belief, z: Any, u: Any, scale: Any
) -> CorrectedBelief:
    """The same of a sensor whose R is found as it goes, by λ (m, ...) before it; None where it is the model's."""
    x, S = belief
    space, update = model.space, update_on(filter, model, sensor)
    _, seen = there(model.measured_space(sensor, z.shape[0]), z)
    count = seen.sum(0)
    with jax.named_scope("the noise of the sensor"):
        if model.noise_inside(sensor) is None:
            Lr, noise_sound = sensor_noise(model, R, x, u, seen)
        else:  # it comes with the line
            Lr, noise_sound = Diagonal(jnp.where(seen, 0, jnp.ones_like(z))), jnp.ones(x.shape[1:], bool)
        Lr = Lr if scale is None else columns_scaled(Lr, jnp.where(seen, jnp.sqrt(scale), 1))
    observe = observing(filter, model, sensor, Lr, x, S, z, u)
    with jax.named_scope("the sensor, linearised"):
        observed = observe()
    with jax.named_scope("the update"):
        taken, whitened, Sy, weighed = updated(filter, update, observe, observed, count)
        after = scale
        if scale is not None:
            assert update.memory is not None
            taken, after = estimate_R(update.memory, taken, scale, seen, filter.form.omega)
    with jax.named_scope("the correction"):
        done = filter.form.correct(S, taken.line, taken.noise, taken.innovation)
        done = considered(filter, model, S, taken, done)
    if whitened is None or Sy is None:
        whitened, Sy = done.whitened, done.innovation_factor
    factor = raised(done.factor, ROUNDING * float(np.finfo(x.dtype).eps) * jnp.abs(S).sum(1))
    if update.reset:
        factor = reset(space, x, done.shift, factor).factor
    new = _in_domain(model, Belief(space.add(x, done.shift), factor))
    nis = (whitened**2).sum(0)
    variances = diagonal(done.innovation_factor)
    sound = done.sound & (variances > 0).all(0) & finite(new.mean, new.factor) & jnp.isfinite(nis)
    fault = first(
        (~finite(observed.innovation, observed.line.slope, observed.line.residual), Fault.SENSOR_NOT_FINITE),
        (~noise_sound, Fault.SENSOR_NOISE_INDEFINITE),
        (~sound, Fault.CORRECTION_INDEFINITE),
        (taken.widened, Fault.CORRECTION_WIDENED),
    )
    heard = (count > 0) & (fault <= 0)
    if weighed is None:
        if scale is not None:  # as it was before the measurement changed R
            done = done._replace(whitened=whitened, innovation_factor=Sy)
            variances = diagonal(Sy)
        density = -0.5 * ((done.whitened**2).sum(0) + count * LOG_2PI)
    else:
        density, variances = weighed.log_density, diagonal(Sy)
    volume = jnp.log(jnp.where(variances > 0, variances, 1)).sum(0)
    used = heard if weighed is None else heard & (weighed.weights > 0).all(0)
    told = Innovation(
        residual=jnp.where(seen, observed.innovation, jnp.nan),
        factor=jnp.where(count > 0, Sy, 0),
        nis=jnp.where(used, nis, jnp.nan),
        log_likelihood=jnp.where(heard, density - volume, 0),
        dof=jnp.where(used, count, 0),
    )
    if weighed is not None:
        # What is refused widens the belief, so that a filter that is wrong cannot refuse for ever.
        belief = belief._replace(factor=grown(filter, model, S, jnp.where(heard & ~used, weighed.growth, 1)))
    after = None if scale is None else jnp.where(used, after, scale)
    return CorrectedBelief(kept(used, new, belief), told, jnp.where(count > 0, fault, 0), after)


def later(fault: jax.Array, then: jax.Array) -> jax.Array:
    """The fault of two half-steps: the first that failed, else the last that was widened."""
    return jnp.where((fault <= 0) & (then != 0), then, fault)


def _predicted(filter: Filter, line: Linearization, Lq: Matrix) -> tuple[Predicted, jax.Array]:
    """The prediction, without the columns of negative weights where it fails with them; and whether it did (...)."""
    predicted = filter.form.predict(line, Lq)
    if not line.deficit.shape[1]:
        return predicted, jnp.zeros(line.mean.shape[1:], bool)
    wider = filter.form.predict(line._replace(deficit=line.deficit[:, :0]), Lq)
    chosen: Predicted = jax.tree.map(lambda a, b: jnp.where(predicted.sound, a, b), predicted, wider)
    return chosen, ~predicted.sound


def _in_domain(model: Model, belief: Belief) -> Belief:
    """The belief with the model's domain applied to the mean and, by its derivative, to the factor."""
    function = in_domain(model, belief.mean.ndim > 1)
    if function is None:
        return belief
    space = model.space
    line = linearized(Taylor1(), function, belief.mean, belief.factor, space, space)
    return Belief(line.mean, tria(line.slope))
