"""Other ready-made motions for a target that moves by itself, each with its noise fitted, judged by the later rows."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.errors import InputError
from sigmax.examination.envelope_runs import Variant, log_likelihood
from sigmax.examination.gauss_newton import Start
from sigmax.examination.hypotheses import noise_at
from sigmax.examination.record_data import RecordData
from sigmax.examination.search import Candidate, Setup
from sigmax.fitting import fit
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.noise import sensor_of
from sigmax.modelling.parts import Motion
from sigmax.models import motions
from sigmax.running import run

# The share of the last rows that judge, and what a family must gain there and over all rows beyond any other cause.
_LATER, _MORE = 0.3, 3.0
# The time constant of Singer's motion, in median intervals.
_TAU = 20.0


class _Family(NamedTuple):
    """A motion, how it is written, and where the search for the numbers of its noise begins."""

    motion: Motion
    written: str
    start: dict[str, float]


def other_families(setup: Setup, record: RecordData, best: Candidate) -> list[Candidate]:
    """The family of motions that explains a record better than any cause found so far, by name; none where none does.

    A family is tried where the state has a position, its velocity, and no more than accelerations or a rate of turn,
    nothing drives the motion, and the sensors see no component that the family lacks.
    """
    model = setup.runner.family.plain
    axes = _axes(model)
    if not axes:
        return []
    z = {
        s: np.where(out, np.nan, v) for (s, v), out in zip(record.z.items(), record.by_sensor(record.out), strict=True)
    }
    clean = replace(record, z=z, out=np.zeros_like(record.out))
    later, whole = _own(setup, clean)
    found = [c for one in _families(model, record, axes) if (c := _tried(setup, clean, one, (later, whole)))]
    return [c for c in found if c.gain > best.gain + _MORE]


def _axes(model: Model) -> tuple[str, ...]:
    """The axes of a position whose velocity is in the state, too; none where there is anything else but they know."""
    names = [str(name) for name in model.state]
    if (
        model.curved
        or model.motion_inputs
        or model.domain is not None
        or model.constraints
        or any(map(callable, model.R.values()))
    ):
        return ()
    if names == ["north", "east", "speed", "course", "turn_rate"]:
        return ("north", "east")
    axes = [name for name in names if f"v{name}" in names]
    known = {"turn_rate", *(prefix + name for name in axes for prefix in ("", "v", "a"))}
    return tuple(axes) if set(names) <= known else ()


def _families(model: Model, record: RecordData, axes: tuple[str, ...]) -> Iterator[_Family]:
    """All that are not the model's own, by what they do to its state."""
    dt = record.interval
    q = max(_speed_noise(model, record, dt), 1e-12)
    tau = float(f"{_TAU * dt:.3g}")
    own = [str(name) for name in model.state]
    every = [
        _Family(motions.constant_velocity(axes), f"constant_velocity({axes})", {"density": q}),
        _Family(motions.constant_acceleration(axes), f"constant_acceleration({axes})", {"density": q / (10 * dt) ** 2}),
        _Family(motions.singer(axes, tau), f"singer({axes}, tau={tau:g})", {"acceleration": np.sqrt(q / dt) / 3}),
    ]
    if len(axes) == 2:
        start = {"acceleration": q, "turn_rate": 0.01 / np.sqrt(dt)}
        turning = motions.coordinated_turn_cartesian(axes)
        every.append(_Family(turning, f"coordinated_turn_cartesian({axes})", start))
    for one in every:
        if [str(name) for name in one.motion.state] != own or not _moves_alike(model, one.motion, record, dt):
            yield one


def _moves_alike(model: Model, motion: Motion, record: RecordData, dt: float) -> bool:
    x = record.mean + 0.7 * np.sqrt(np.diag(record.cov))
    return bool(np.allclose(model.motion(jnp.asarray(x), dt), motion.function(jnp.asarray(x), dt), rtol=1e-6))


def _speed_noise(model: Model, record: RecordData, dt: float) -> float:
    """How much variance a second adds to a velocity, about."""
    Q, _ = noise_at(model, record, dt)
    return float(max(Q[i, i] for i, name in enumerate(model.state) if name == "speed" or str(name)[0] == "v") / dt)


def _own(setup: Setup, record: RecordData) -> tuple[float, float]:
    """Log-likelihoods of the model as it stands: of the later rows, its Q fitted to the others, and of all rows."""
    theta = np.zeros(len(setup.climber.steps))
    places = [i for i, p in enumerate(setup.runner.family.parameters) if p.kind == "Q"]
    early = record.first(len(record.dt) - int(_LATER * len(record.dt)))
    basis = np.eye(len(theta))[:, places]
    ((value, there),) = setup.climber.climb([Start(theta, basis, np.full(len(places), 1.5), early)])
    at = log_likelihood(setup.runner([Variant(theta + basis @ value, record), Variant(theta, record)]))
    return float(at[0]) - there.L, float(at[1])


def _tried(setup: Setup, record: RecordData, one: _Family, own: tuple[float, float]) -> Candidate | None:
    model = setup.runner.family.plain
    there = view(model, one.motion)
    if there is None:
        return None
    prior = prior_of(model, one.motion, Gaussian(record.mean, record.cov), record.interval)

    def seen(s: str) -> Callable[..., Any]:
        h = model.sensors[s]
        return sensor_of(lambda x, *u: h(there(x), *u), bool(model.sensor_inputs[s]))

    extra = record.by_sensor(record.extra)
    parts: tuple[dict[str, Any], ...] = (
        {s: seen(s) for s in model.sensors},
        {s: _more(model.R[s], more) for s, more in zip(model.R, extra, strict=True)},
        model.measurement,
    )
    sensor, R, names = parts if model.several else (of_all[""] for of_all in parts)
    given: dict[str, Any] = {
        "z": record.z if model.several else record.z[""], "dt": record.dt,
        "inputs": record.u if record.u.shape[1] else None, "update_first": setup.runner.update_first,
    }  # fmt: skip

    def build(p: Any) -> tuple[Model, Gaussian]:
        Q = one.motion.noise(**p)
        return Model(motion=one.motion, Q=Q, sensor=sensor, R=R, measurement=names), prior

    try:
        found = fit(setup.runner.filter, build, one.start, positive=tuple(one.start), hold_out=_LATER, **given)
    except InputError:  # it fails on the record
        return None
    counts = [np.isfinite(v).sum(1) for v in record.z.values()]
    constant = 0.5 * np.log(2 * np.pi) * sum(counts)  # which log-likelihoods of the examination leave out
    T, last = len(record.dt), int(_LATER * len(record.dt))
    if found.held_out is None or found.held_out.after + constant[T - last :].sum() - own[0] < _MORE:
        return None
    gain = found.log_likelihood + constant.sum() - own[1] - 0.5 * np.log(T) * len(one.start)
    done = run(setup.runner.filter, *build(found.parameters), **given)
    numbers = ", ".join(f"{name}={float(v):.3g}" for name, v in found.parameters.items())
    nis = float(np.nansum(done.nis) / np.sum(done.dof))
    return Candidate("motion", one.written, float(gain), np.zeros(0), np.nan, numbers=numbers, nis=nis)


def _more(R: Any, extra: np.ndarray) -> np.ndarray:
    V = np.asarray(R.entries if isinstance(R, Diagonal) else R)
    return np.asarray(V + (extra if V.ndim == 1 else np.diag(extra)))


def view(model: Model, motion: Motion) -> Callable[[Any], Any] | None:
    """The state of the model as that of another motion has it; None where a sensor sees what that one lacks.

    Accelerations and rates of turn that the other motion lacks are 0; speed and course are those of its velocity.
    """
    own, new = [str(name) for name in model.state], [str(name) for name in motion.state]
    velocity = [i for i, name in enumerate(new) if name[0] == "v"]
    lost = [i for i, name in enumerate(own) if name not in (*new, "speed", "course")]
    x = jnp.arange(1.0, 1.0 + len(own))
    for h, driven in ((h, model.sensor_inputs[s]) for s, h in model.sensors.items()):
        if lost and (driven or np.asarray(jax.jacfwd(h)(x))[:, lost].any()):
            return None

    def seen(y: Any) -> Any:
        along, across = (y[i] for i in velocity[:2]) if "speed" in own else (0.0, 0.0)
        known = {name: y[i] for i, name in enumerate(new)} | {
            "speed": jnp.hypot(along, across), "course": jnp.arctan2(across, along),
        }  # fmt: skip
        return jnp.stack([jnp.asarray(known.get(name, 0.0), y.dtype) for name in own])

    return seen


def prior_of(model: Model, motion: Motion, before: Gaussian, dt: float) -> Gaussian:
    """The prior seen by another motion; of what the model does not know, a change of a tenth of its speeds a step."""
    own, new = [str(name) for name in model.state], [str(name) for name in motion.state]

    def turned(x: Any) -> Any:
        known = {name: x[i] for i, name in enumerate(own)}
        if "speed" in known:
            known |= {
                "vnorth": known["speed"] * jnp.cos(known["course"]),
                "veast": known["speed"] * jnp.sin(known["course"]),
            }
        return jnp.stack([known.get(name, 0.0 * x[0]) for name in new])

    at = jnp.asarray(before.mean)
    slope = np.asarray(jax.jacfwd(turned)(at))
    mean, cov = np.array(turned(at)), slope @ before.cov @ slope.T
    speed = np.sqrt(max(cov[i, i] + mean[i] ** 2 for i, name in enumerate(new) if name[0] == "v"))
    for i, name in enumerate(new):
        if name not in own and name[0] == "a":
            cov[i, i] = (0.1 * speed / dt) ** 2
        elif name not in own and name == "turn_rate":
            cov[i, i] = (0.1 / dt) ** 2
    return Gaussian(mean, cov)
