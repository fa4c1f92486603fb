"""Stations that hold the same belief and tell each other what they measured, in messages of information."""

import json
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import TWO_PI, inner, times, wrap
from sigmax.algebra.factor import dense, inverse_lower, solve_lower
from sigmax.errors import InputError, unknown
from sigmax.filters import Filter
from sigmax.forms.information import factor_of_inverse
from sigmax.models.evaluate import sensing, sensor_noise
from sigmax.models.fusion import Fused, dense_noise
from sigmax.models.model import Model
from sigmax.models.noise import OF_SENSOR, noise
from sigmax.running.fusing import additive
from sigmax.running.live import Live
from sigmax.running.step import Belief, Fault, Innovation

FORMAT = "sigmax contribution 1"


class Contribution(NamedTuple):
    """What one measurement adds, (i, I): in the space of the measurement or in that of the state.

    Measurement: I = R⁻¹, i = R⁻¹ (z − a). State: I = Hᵀ R⁻¹ H, i = Hᵀ R⁻¹ ν, linearised at a, state and bias
    in the order of `components`; the paper's i is i + I a. Either adds up over stations.

    Attributes:
        space: "measurement" or "state".
        sensor: its name.
        components: what the rows of i are.
        about: a, what i is counted from.
        vector: i.
        matrix: I; rows of what was not seen are 0.
        square: (z − a)ᵀ R⁻¹ (z − a), and 0 for the state.
        volume: log |R| of what was seen, and 0 for the state.
        seen: how many components of the measurement were seen.
        time: seconds, as the sender counts them; only carried along.
    """

    space: str
    sensor: str
    components: tuple[str, ...]
    about: np.ndarray
    vector: np.ndarray
    matrix: np.ndarray
    square: float
    volume: float
    seen: int
    time: float | None = None

    def to_json(self) -> str:
        """The message: one JSON object, its numbers exact."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in self._asdict().items()}
        return json.dumps({"format": FORMAT, **plain, "components": list(map(str, self.components))})

    @classmethod
    def from_json(cls, text: str | bytes) -> "Contribution":
        """The contribution of a message.

        Raises:
            InputError: where it is none.
        """
        try:
            given = json.loads(text)
            if given.pop("format") != FORMAT:
                raise InputError(f"this message is not of the format {FORMAT!r}")
            for name in ("about", "vector", "matrix"):
                given[name] = np.asarray(given[name], float)
            made = cls(**given | {"components": tuple(given["components"])})
        except InputError:
            raise
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError(f"this is no message of the format {FORMAT!r}: {error}") from error
        n = len(made.components)
        if made.space not in ("measurement", "state") or made.vector.shape != (n,) or made.matrix.shape != (n, n):
            raise InputError(f"i and I of a contribution to {n} components must be ({n},) and ({n}, {n})")
        if not all(np.isfinite(a).all() for a in (made.about, made.vector, made.matrix)):
            raise InputError("a contribution holds finite numbers only")
        return made


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
    if sensor not in model.sensors:
        raise unknown("sensor", sensor, model.sensors)
    names = model.measurement[sensor]
    value = np.asarray(z, float)
    if names is None or value.shape != (len(names),):
        raise InputError(f"z must have the shape ({len(names or ())},) for the named components of {sensor!r}")
    used = noise("R", R, names, OF_SENSOR) if R is not None else model.R[sensor]
    seen = np.isfinite(value)
    if space == "state":
        if not additive(live.filter):
            raise InputError(
                f"contributions of {live.filter.name} to the state do not add up, for its sensors share the error of "
                'linearisation; take space="measurement"'
            )
        own = used if R is not None else None
        i, matrix = _to_state(live.filter, sensor)(model, live.belief, value, own, u)
        of_state = model.joint_state, np.array(live.belief.mean, float), np.array(i), np.array(matrix)
        return Contribution("state", sensor, *of_state, 0.0, 0.0, int(seen.sum()), time)
    if callable(used):
        raise InputError(f"R of {sensor!r} is a function; give R= of this measurement")
    m = len(value)
    both = seen[:, None] & seen[None]
    covariance = np.where(both, dense_noise(used), np.eye(m))
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


def absorb(live: Live, contributions: Iterable[Contribution], *, u: Any = None) -> Innovation | None:
    """Correct with what stations contributed, one's own among it: the answer is that of the central filter.

    Args:
        live: on `sigmax.fused(model, messages=True)` for contributions of measurements, on the model for those
            of the state; of one track.
        contributions: all of one instant, of one space.
        u: inputs (k,) where sensors take them.

    Returns:
        What they said together, as `Live.update`; None for contributions of the state.

    Raises:
        InputError: where spaces are mixed or a sensor is not known.
    """
    given, model = list(contributions), _alone(live).apart
    spaces = {c.space for c in given}
    if len(spaces) > 1:
        raise InputError("contributions of measurements and of the state do not add up to each other")
    if spaces == {"state"}:
        _into_state(live, given)
        return None
    for c in given:
        if c.sensor not in model.sensors:
            raise unknown("sensor", c.sensor, model.sensors)
    if model.fusion is None or not all(block.given for block in model.fusion):
        raise InputError("contributions of measurements need a filter on sigmax.fused(model, messages=True)")
    return live.update_together(_gathered(model, given, u))


def _alone(live: Live) -> Live:
    if live.belief.mean.ndim > 1:
        raise InputError("stations exchange contributions to one track; make a filter for each")
    return live


def _gathered(model: Model, given: list[Contribution], u: Any) -> Fused:
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
        x, S, _ = belief
        seen = ~jnp.isnan(z)
        angular = model.measured_angular(sensor, z.shape[0])
        line = filter.correct(sensing(model, sensor, x, u), x, S, angular)
        Lr, _ = sensor_noise(model, model.R[sensor] if R is None else R, x, u, seen)
        nu = jnp.where(seen, wrap(jnp.where(seen, z, 0) - line.mean, angular), 0)
        A = jnp.where(seen[:, None], line.slope, 0) @ inverse_lower(S)
        G = solve_lower(dense(Lr), A)
        return times(G.swapaxes(0, 1), solve_lower(dense(Lr), nu)), inner(G, G)

    return jax.jit(contributed)


def _into_state(live: Live, given: list[Contribution]) -> None:
    model, names = live.apart, tuple(map(str, live.apart.joint_state))
    x, S = (np.asarray(a, float) for a in live.belief[:2])
    vector, matrix = np.zeros(len(names)), np.zeros((len(names), len(names)))
    for c in given:
        if c.components != names:
            raise InputError(f"a contribution is to {list(c.components)}, this filter carries {list(names)}")
        vector = vector + c.vector + c.matrix @ np.asarray(wrap(jnp.asarray(c.about - x), model.joint_angular))
        matrix = matrix + c.matrix
    mean, factor, sound = (np.asarray(a) for a in _summed(x, S, vector, matrix))
    if sound:
        moved = np.asarray(wrap(jnp.asarray(mean), model.joint_angular))
        live.put(Belief(moved, factor, live.filter.form.start(jnp.asarray(factor))), Fault.NONE)
    else:
        live.put(live.belief, Fault.CORRECTION_INDEFINITE)


@jax.jit
def _summed(x: Any, S: Any, vector: Any, matrix: Any) -> tuple[Any, Any, Any]:
    """Y⁺ = Y + I and y⁺ = y + i, in units of S."""
    D, sound = factor_of_inverse(jnp.eye(len(x)) + inner(S, inner(matrix, S)))
    factor = S @ D
    return x + times(factor, times(factor.swapaxes(0, 1), vector)), factor, sound
