"""Faults that are put into records and models for `sigmax.doctor`, each beside what would be right."""

import copy
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import sigmax
from doctor_worlds import Drawn, World, drawn, measured, process_noise


class Faulty(NamedTuple):
    """What the doctor is given, and what is right.

    Attributes:
        world: with the wrong model, prior or inputs.
        z: the wrong record.
        right: the world and the record without the fault; None where nothing but leaving values out mends it.
        jacobian: of the record with the fault by the one without: what changed values add to a likelihood.
        tails: what the true density of the noise gains over a Gaussian of any deviation, where that is the fault.
    """

    world: World
    z: dict[str, np.ndarray]
    right: tuple[World, dict[str, np.ndarray]] | None
    jacobian: float = 0.0
    tails: float = np.inf


class Case(NamedTuple):
    """A fault, its kinds as the doctor may name them, its strength (0, 1, 2), and its size where it has one."""

    fault: str
    kinds: tuple[str, ...]
    strength: int
    size: float | None
    made: Callable[[World, Drawn, np.random.Generator], Faulty]
    fits: Callable[[World], bool] = lambda world: True


def on_values(change: Callable[..., np.ndarray], mended: bool = True, jacobian: float = 0.0) -> Any:
    """A change of the first component of the first sensor, by values, deviation, rng, values without noise."""

    def made(world: World, d: Drawn, rng: np.random.Generator) -> Faulty:
        s = next(iter(d.z))
        own, deviation = d.z[s].copy(), np.sqrt(np.asarray(world.model.R[s].entries)[0])
        own[:, 0] = change(own[:, 0], deviation, rng, d.clean[s][:, 0])
        count = int(np.isfinite(own[:, 0]).sum())
        return Faulty(world, d.z | {s: own}, (world, d.z) if mended else None, count * jacobian)

    return made


def long_tails(nu: float) -> Any:
    """Noise of the first component of the first sensor from Student's density."""

    def made(world: World, d: Drawn, rng: np.random.Generator) -> Faulty:
        s = next(iter(d.z))
        own, deviation = d.z[s].copy(), np.sqrt(np.asarray(world.model.R[s].entries)[0])
        e = rng.standard_t(nu, size=len(own))
        own[:, 0] = d.clean[s][:, 0] + deviation * e
        e = e[np.isfinite(own[:, 0])]
        gain = stats.t.logpdf(e, nu).sum() - stats.norm.logpdf(e, scale=np.sqrt((e * e).mean())).sum()
        return Faulty(world, d.z | {s: own}, None, tails=float(gain))

    return made


def with_model(world: World, Q: np.ndarray | None = None, R: dict[str, np.ndarray] | None = None) -> World:
    """A world whose model has another Q or R."""
    m, whole = world.model, copy.copy(world.model)
    R = R or {s: np.asarray(r.entries) for s, r in m.R.items()}
    other = sigmax.Model(motion=m.motion, sensor=m.sensors, Q=process_noise(m) if Q is None else Q, R=R, state=m.state)
    whole.Q, whole.R = (m.Q if Q is None else other.Q), other.R
    return world._replace(model=whole)


def wrong_r(c: float) -> Any:
    """R of the first component of the first sensor is the truth times 1 / c."""

    def made(world: World, d: Drawn, rng: Any) -> Faulty:
        R = {s: np.array(r.entries) for s, r in world.model.R.items()}
        R[next(iter(R))][0] /= c
        return Faulty(with_model(world, R=R), d.z, (world, d.z))

    return made


def wrong_q(c: float) -> Any:
    """Q is the truth times 1 / c."""
    return lambda world, d, rng: Faulty(with_model(world, Q=process_noise(world.model) / c), d.z, (world, d.z))


def wrong_prior(k: float) -> Any:
    """The mean of the first component is off by k deviations."""

    def made(world: World, d: Drawn, rng: Any) -> Faulty:
        mean = np.array(world.prior.mean)
        mean[0] -= k * np.sqrt(world.prior.cov[0, 0])
        return Faulty(world._replace(prior=sigmax.Gaussian(mean, world.prior.cov)), d.z, (world, d.z))

    return made


def wrong_inputs(change: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Other inputs are given than those that drove the body."""
    return lambda world, d, rng: Faulty(world._replace(inputs=change(world.inputs)), d.z, (world, d.z))


def late(share: float, more: float = 0.0) -> Any:
    """The first sensor saw what was so many steps ago, and more with each step, on straight lines between states."""

    def made(world: World, d: Drawn, rng: Any) -> Faulty:
        s = next(iter(d.z))
        rows = np.arange(len(d.x))
        # The first may have seen what was before the first state.
        x, at = np.concatenate([2 * d.x[:1] - d.x[1:2], d.x]), np.append(-1, rows)
        then = measured(world, np.column_stack([np.interp(rows - share - more * (rows + 1), at, c) for c in x.T]))[s]
        return Faulty(world, d.z | {s: d.z[s] - d.clean[s] + then}, (world, d.z))

    return made


def pair(world: World) -> str | None:
    """A sensor that measures two lengths."""
    for s, r in world.model.R.items():
        if len(r.entries) == 2 and not any(world.model.measured_angular(s, 2)):
            return str(s)
    return None


def turned(c: float) -> Any:
    """The axes of a sensor are turned by so much that its values are off by c deviations."""

    def made(world: World, d: Drawn, rng: Any) -> Faulty:
        s = str(pair(world))
        far = np.sqrt(np.nanmean(d.clean[s] ** 2))
        a = c * np.sqrt(float(world.model.R[s].entries[0])) / far
        turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        return Faulty(world, d.z | {s: d.clean[s] @ turn.T + d.z[s] - d.clean[s]}, (world, d.z))

    return made


def quarter_turn(world: World, d: Drawn, rng: Any) -> Faulty:
    """A sensor has y and −x for x and y."""
    s = str(pair(world))
    return Faulty(world, d.z | {s: d.z[s][:, ::-1] * [1, -1]}, (world, d.z))


def manoeuvre(c: float) -> Any:
    """Three jumps of the state, of c deviations of Q."""

    def made(world: World, d: Drawn, rng: np.random.Generator) -> Faulty:
        seed = int(rng.integers(2**31))
        return Faulty(world, drawn(world, seed, c).z, (world, drawn(world, seed).z))

    return made


def other_motion(world: World, motion: sigmax.models.Motion, Q: Any, prior: sigmax.Gaussian) -> World:
    """A world whose target moves in another way; its sensors see the first two components of any state."""
    m = world.model
    R = {s: np.asarray(r.entries) for s, r in m.R.items()}
    sensor, measurement = (m.sensors, m.measurement) if m.several else (m.sensors[""], m.measurement[""])
    model = sigmax.Model(
        motion=motion, Q=Q, sensor=sensor, R=R if m.several else R[""], measurement=measurement
    )  # fmt: skip
    return world._replace(model=model, prior=prior)


def straight(world: World, d: Drawn, rng: Any) -> Faulty:
    """A target that turns is said to fly straight on."""
    (x, y, v, c, _), P = world.prior.mean, np.diag(world.prior.cov)
    velocity = [v * np.cos(c), v * np.sin(c)]
    prior = sigmax.Gaussian([x, y, *velocity], [P[0], P[1], P[2] + v * v * P[3], P[2] + v * v * P[3]])
    motion = sigmax.motions.constant_velocity(("north", "east"))
    return Faulty(other_motion(world, motion, motion.noise(1.0), prior), d.z, (world, d.z))


def jerked(density: float) -> Any:
    """A target whose acceleration wanders is said to have none."""

    def made(world: World, d: Drawn, rng: np.random.Generator) -> Faulty:
        motion = sigmax.motions.constant_acceleration([str(name) for name in world.model.state[:2]])
        Q = motion.noise(density)
        x, states = np.append(d.x[0], [0.0, 0.0]), []
        for _ in d.x:
            w = rng.multivariate_normal(np.zeros(6), np.asarray(Q(1.0)))
            x = np.asarray(motion.function(x, 1.0)) + w
            states.append(x)
        then = measured(world, np.array(states)[:, :4])
        z = {s: v - d.clean[s] + then[s] for s, v in d.z.items()}
        cov = np.zeros((6, 6))
        cov[:4, :4] = world.prior.cov
        cov[4:, 4:] = np.eye(2) * 0.01
        prior = sigmax.Gaussian(np.append(world.prior.mean, [0.0, 0.0]), cov)
        return Faulty(world, z, (other_motion(world, motion, Q, prior), z))

    return made


def stuck(v: np.ndarray, length: int) -> np.ndarray:
    """The first value after row 100 held for some values."""
    v, rows = v.copy(), np.flatnonzero(np.isfinite(v))
    rows = rows[rows >= 100][:length]
    v[rows] = v[rows[0]]
    return v


def flies(world: World) -> bool:
    """Whether the state is a position in the plane and its velocity."""
    first, *_ = names = [str(name) for name in world.model.state]
    return len(names) == 4 and names[2] == f"v{first}"


def alike(world: World) -> bool:
    """Whether the inputs are two components of one vector."""
    return world.inputs is not None and world.model.state[0] == "x" and len(world.model.state) == 4


def turn(u: np.ndarray, a: float) -> np.ndarray:
    """Two inputs turned by a."""
    return u @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]).T


def shifted(u: np.ndarray, share: float) -> np.ndarray:
    """Inputs as they were so many rows before, on the straight lines between the rows."""
    rows = np.arange(len(u))
    return np.column_stack([np.interp(rows - share, rows, v) for v in u.T])


def cases() -> Iterator[Case]:
    """All faults, those with a size in three strengths."""
    driven = lambda world: world.inputs is not None  # noqa: E731
    several = lambda world: world.model.several  # noqa: E731
    for i, c in enumerate((1.6, 2.5, 6.0)):
        yield Case("R", ("R",), i, np.log(c), wrong_r(c))
    for i, c in enumerate((4.0, 16.0, 64.0)):
        yield Case("Q", ("Q",), i, np.log(c), wrong_q(c))
    for i, c in enumerate((0.5, 1.5, 4.0)):
        yield Case("bias", ("bias",), i, None, on_values(lambda v, s, g, x, c=c: v + c * s))
    for i, c in enumerate((0.01, 0.03, 0.07)):
        yield Case("scale", ("scale",), i, c, on_values(lambda v, s, g, x, c=c: v * (1 + c), jacobian=np.log1p(c)))
    for i, c in enumerate((0.02, 0.05, 0.15)):
        far = on_values(lambda v, s, g, x, c=c: v + 10 * s * (g.random(len(v)) < c) * g.normal(size=len(v)), False)
        yield Case("outliers", ("outliers", "tails"), i, None, far)
    for i, c in enumerate((6.0, 4.0, 2.5)):
        yield Case("tails", ("tails", "outliers"), i, None, long_tails(c))
    for i, c in enumerate((2.0, 4.0, 8.0)):
        steps = on_values(lambda v, s, g, x, c=c: np.round(v / (c * s)) * c * s, False)
        yield Case("coarse", ("coarse",), i, None, steps)
    for i, c in enumerate((8, 16, 40)):
        yield Case("stuck", ("stuck",), i, None, on_values(lambda v, s, g, x, c=c: stuck(v, c), False))
    for i, c in enumerate((5.0, 10.0, 30.0)):
        yield Case("prior", ("prior",), i, c, wrong_prior(c))
    for i, c in enumerate((0.1, 0.3, 0.8)):
        yield Case("delay", ("delay",), i, c, late(c), several)
    for i, c in enumerate((0.001, 0.003, 0.01)):
        yield Case("skew", ("skew",), i, c, late(0.0, c), several)
    for i, c in enumerate((0.5, 1.5, 4.0)):
        yield Case("rotation", ("rotation",), i, None, turned(c), lambda world: pair(world) is not None)
    for i, c in enumerate((0.05, 0.15, 0.4)):
        yield Case("input gain", ("input gain",), i, -c / (1 + c), wrong_inputs(lambda u, c=c: u * [1 + c, 1]), driven)
    for i, c in enumerate((0.3, 1.0, 2.0)):
        yield Case("input delay", ("input delay",), i, -c, wrong_inputs(lambda u, c=c: shifted(u, c)), driven)
    for i, c in enumerate((0.1, 0.3, 0.8)):
        yield Case("input axes", ("input rotation",), i, -c, wrong_inputs(lambda u, c=c: turn(u, c)), alike)
    for i, c in enumerate((8.0, 16.0, 40.0)):
        yield Case("manoeuvre", ("manoeuvre",), i, None, manoeuvre(c))
    for i, c in enumerate((3e-4, 1e-3, 1e-2)):
        yield Case("motion", ("motion",), i, None, jerked(c), lambda world: not driven(world) and flies(world))
    yield Case("motion", ("motion",), 2, None, straight, lambda world: "turn_rate" in world.model.state)
    yield Case("inputs swapped", ("swap",), 2, None, wrong_inputs(lambda u: u[:, ::-1].copy()), alike)
    yield Case(
        "inputs turned", ("axes", "input rotation"), 2, None, wrong_inputs(lambda u: u[:, ::-1] * [1, -1]), alike
    )
    yield Case("axes", ("axes", "rotation"), 2, None, quarter_turn, lambda world: pair(world) is not None)
    yield Case("input sign", ("sign",), 2, None, wrong_inputs(lambda u: u * [1, -1]), driven)
    yield Case("sign", ("sign",), 2, None, on_values(lambda v, s, g, x: -v))
    yield Case("km for m", ("units",), 2, None, on_values(lambda v, s, g, x: v / 1000, jacobian=-np.log(1000)))
