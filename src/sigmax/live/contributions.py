"""Stations that hold the same belief and tell each other what they measured, in messages of information."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import TWO_PI, inner, product, times, wrap
from sigmax.algebra.factor import absorb as reflect
from sigmax.algebra.factor import cholesky, dense, identity, inverse_lower, pivoted, solve_lower, tria
from sigmax.errors import InputError, unknown
from sigmax.filters import Bank, Filter, once
from sigmax.live.live import Live
from sigmax.live.message import Contribution
from sigmax.modelling.checks import finite, members, numbers
from sigmax.modelling.evaluate import sensing, sensor_noise
from sigmax.modelling.model import Model, check_added, check_flat
from sigmax.modelling.noise import dense_noise, noise_once
from sigmax.modelling.switching import check_one_mode
from sigmax.preparation.fusing import additive, check_inputs
from sigmax.rewriting.fusion import Fused
from sigmax.steps.step import Belief, Fault, Innovation


def contribution(
    live: Live, z: Any, sensor: str, *, R: Any = None, u: Any = None, space: str = "measurement", time: Any = None
) -> Contribution:
    """What a measurement of one sensor adds, for stations that hold the same belief as `live`, which stays as it is.

    Args:
        live: a filter of one track.
        z: (m,), NaN where a component is missing.
        sensor: which of the model's sensors it comes from.
        R: its covariance or variances, if not the model's.
        u: inputs (k,) where the sensor takes them.
        space: "measurement", exact for every filter; "state" for those whose contributions add up: with a rule
            of first derivatives, or information="paper". A receiver of those need not know the sensor.
        time: to carry along.

    Raises:
        InputError: for what does not fit, or a sum that would not be exact.
    """
    model = _alone(live).apart
    check_added(model, "a contribution")
    if sensor not in model.sensors:
        raise unknown("sensor", sensor, model.sensors)
    if space not in ("measurement", "state"):
        raise unknown("space of contributions", space, ("measurement", "state"))
    names = model.measurement[sensor]
    value = numbers("z", z, missing=True)
    if names is None or value.shape != (len(names),):
        raise InputError(f"z must have the shape ({len(names or ())},) for the named components of {sensor!r}")
    finite("z", np.where(np.isnan(value), 0, value))
    used = noise_once(R, names) if R is not None else model.R[sensor]
    time = None if time is None else float(numbers("time", time))
    seen = ~np.isnan(value)
    if space == "state":
        _taken_once(live)
        if not additive(live.filter):
            raise InputError(
                "contributions to the state add up where there is no Ω, as in EKF and EIF, or it is left out by "
                f'information="paper"; {live.filter.name} counts it; take space="measurement"'
            )
        if u is None and model.sensor_driven(sensor):
            raise InputError(f"the sensor {sensor!r} takes inputs; give u=")
        own = used if R is not None else None
        i, matrix = _to_state(live.filter, sensor)(model, live.belief, value, own, u)
        if not np.isfinite(matrix).all():
            raise _no_inverse(sensor)
        of_state = model.state, np.array(live.belief.mean, float), np.array(i), np.array(matrix)
        return Contribution("state", sensor, *of_state, 0.0, 0.0, int(seen.sum()), time)
    if callable(used):
        raise InputError(f"R of {sensor!r} is a function; give R= of this measurement")
    m = len(value)
    both = seen[:, None] & seen[None]
    covariance = np.where(both, dense_noise(used), np.eye(m))
    if np.linalg.eigvalsh(covariance).min(initial=1) <= 0:
        raise _no_inverse(sensor)
    weight = np.where(both, np.linalg.inv(covariance), 0.0)
    turning = np.array(model.measured_angular(sensor, m))
    # Angles are counted from what was measured: nobody has to agree on how many circles they hold.
    about = np.where(turning & seen, value, 0.0)
    off = np.where(seen, value - about, 0.0)
    volume = float(np.linalg.slogdet(covariance)[1])
    square = float(off @ weight @ off)
    return Contribution(
        "measurement", sensor, names, about, weight @ off, weight, square, volume, int(seen.sum()), time
    )


def _no_inverse(sensor: str) -> InputError:
    return InputError(
        f"R of {sensor!r} has no inverse, and a contribution is made of R⁻¹; give each component a variance above 0"
    )


def absorb(live: Live, contributions: Iterable[Contribution], *, u: Any = None) -> Innovation | None:
    """Correct with what stations contributed, one's own among it: the answer is that of the central filter.

    Args:
        live: on `sigmax.models.fused(model, messages=True)` for contributions of measurements, on the model for those
            of the state; of one track.
        contributions: all of one instant, of one space.
        u: inputs (k,) where sensors take them.

    Returns:
        What they said together, as `Live.update`; None for contributions of the state.

    Raises:
        InputError: where spaces are mixed, a sensor or its components are not those of the model, or one came twice.
    """
    given, model = _each_once(contributions), _alone(live).apart
    spaces = {c.space for c in given}
    if len(spaces) > 1:
        raise InputError("contributions of measurements and of the state do not add up to each other")
    if spaces == {"state"}:
        _taken_once(live)
        _into_state(live, given)
        return None
    for c in given:
        if c.sensor not in model.sensors:
            raise unknown("sensor", c.sensor, model.sensors)
        here = list(map(str, model.measurement[c.sensor] or ()))
        if list(map(str, c.components)) != here:
            raise InputError(
                f"{c.sensor!r} measures {here} here, the contribution is of {list(map(str, c.components))}"
            )
    if model.fusion is None or not all(block.given for block in model.fusion):
        raise InputError("contributions of measurements need a filter on sigmax.models.fused(model, messages=True)")
    check_inputs(model, u)
    return live.update_together(_reflect(model, given, u))


def _each_once(contributions: Iterable[Contribution]) -> list[Contribution]:
    given = members(contributions)
    if given is None:
        raise InputError(f"give a list of sigmax.running.Contribution; it is {type(contributions).__name__}")
    for c in given:
        if not isinstance(c, Contribution):
            raise InputError(
                f"give a list of sigmax.running.Contribution, as from_json makes them; it holds {type(c).__name__}"
            )
    told = [(c.space, c.sensor, c.time, *(a.tobytes() for a in (c.about, c.vector, c.matrix))) for c in given if c.seen]
    twice = [key[1] for k, key in enumerate(told) if key in told[:k]]
    if twice:
        raise InputError(f"a contribution of {twice[0]!r} is there twice; a message that comes twice counts once")
    return given


def _alone(live: Live) -> Live:
    if live.belief.mean.ndim > 1:
        raise InputError("stations exchange contributions to one track; make a filter for each")
    check_flat(live.apart, "a contribution")
    check_one_mode(live.apart, "a contribution")
    if isinstance(live.filter, Bank):
        raise InputError(f"contributions are corrected with one belief, and {live.filter.name} has several: take one")
    return live


def _taken_once(live: Live) -> None:
    if live.filter.update not in (None, once):
        raise InputError(
            f"contributions to the state are linearised where they arise and taken as they are; {live.filter.name} "
            f'corrects by {live.filter.update}: take a filter with update=sigmax.once, or space="measurement"'
        )


def _reflect(model: Model, given: list[Contribution], u: Any) -> Fused:
    """The sums of information of each block as one measurement with its covariance."""
    parts, noises = [], [] if u is None else [np.asarray(u, float)]
    disagreement, merged, volume = np.zeros(3)
    for block in model.fusion or ():
        own = [c for c in given if c.sensor in block.members]
        m, turning = len(block.angular), np.array(block.angular)
        seen = sum((np.diagonal(c.matrix) > 0 for c in own), start=np.zeros(m, int)) > 0
        first = np.zeros(m)
        for c in reversed(own):
            first = np.where(np.diagonal(c.matrix) > 0, c.about, first)
        total: np.ndarray = np.diag((~seen).astype(float))
        vector: np.ndarray = np.zeros(m)
        square = 0.0
        for c in own:
            off = c.about - first
            off = np.where(np.diagonal(c.matrix) > 0, off - turning * TWO_PI * np.round(off / TWO_PI), 0.0)
            total = total + c.matrix
            vector = vector + c.vector + c.matrix @ off
            square += c.square + 2 * off @ c.vector + off @ c.matrix @ off
        covariance = np.linalg.inv(total)
        middle = covariance @ vector
        parts.append(np.where(seen, first + middle, np.nan))
        noises.append(((covariance + covariance.T) / 2).ravel())
        disagreement += square - vector @ middle
        merged += sum(c.seen for c in own) - int(seen.sum())
        volume += (sum(c.volume for c in own) + np.linalg.slogdet(total)[1]) / 2
    return Fused(np.concatenate(parts), np.concatenate(noises), disagreement, merged, volume)


@lru_cache(maxsize=64)
def _to_state(filter: Filter, sensor: str) -> Any:
    def contributed(model: Model, belief: Belief, z: Any, R: Any, u: Any) -> tuple[Any, Any]:
        x, S = belief
        seen = ~jnp.isnan(z)
        angular = model.measured_angular(sensor, z.shape[0])
        line = filter.correct(sensing(model, sensor, x, u), x, S, angular)
        Lr, _ = sensor_noise(model, model.R[sensor] if R is None else R, x, u, seen)
        nu = jnp.where(seen, wrap(jnp.where(seen, z, 0) - line.mean, angular), 0)
        A = jnp.where(seen[:, None], line.slope, 0) @ inverse_lower(pivoted(S))
        G = solve_lower(dense(Lr), A)
        return times(G.swapaxes(0, 1), solve_lower(dense(Lr), nu)), inner(G, G)

    return jax.jit(contributed)


def _into_state(live: Live, given: list[Contribution]) -> None:
    model, names = live.apart, tuple(map(str, live.apart.state))
    x, S = (np.asarray(a, float) for a in live.belief)
    vector, matrix = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for c in given:
        if c.components != names:
            raise InputError(f"a contribution is to {list(c.components)}, this filter carries {list(names)}")
        vector = vector + c.vector + c.matrix @ np.asarray(wrap(jnp.asarray(c.about - x), model.angular))
        matrix = matrix + c.matrix
    mean, factor, sound = (np.asarray(a) for a in _summed(x, S, vector, matrix))
    if sound:
        moved = np.asarray(wrap(jnp.asarray(mean), model.angular))
        live.put(Belief(moved, factor), Fault.NONE)
    else:
        live.put(live.belief, Fault.CORRECTION_INDEFINITE)


@jax.jit
def _summed(x: Any, S: Any, vector: Any, matrix: Any) -> tuple[Any, Any, Any]:
    """Y⁺ = Y + I and y⁺ = y + i, in units of S."""
    root, sound = cholesky(matrix)
    _, _, rest = reflect(identity(root), inner(root, S), identity(S))
    factor = product(S, tria(rest))
    return x + times(factor, times(factor.swapaxes(0, 1), vector)), factor, sound
