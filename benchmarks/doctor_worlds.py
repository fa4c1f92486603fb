"""Models on which `sigmax.doctor` is tried, and records of them drawn by NumPy alone."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import sigmax
from sigmax import Model, motions, sensors

STEPS = 300


class World(NamedTuple):
    """A model, its prior, what drives it (T, k) or None, and how many steps lie between two values of a sensor."""

    model: Model
    prior: sigmax.Gaussian
    inputs: np.ndarray | None = None
    every: Mapping[str, int] = MappingProxyType({})


class Drawn(NamedTuple):
    """A record: values with noise and without, by sensor (T, m), and the states (T, n)."""

    z: dict[str, np.ndarray]
    clean: dict[str, np.ndarray]
    x: np.ndarray


def radar() -> World:
    """A radar that sees a target at constant velocity."""
    flight = motions.constant_velocity(("north", "east"))
    model = Model(motion=flight, Q=flight.noise(0.5), sensor=sensors.range_azimuth(), R=[30.0**2, 0.002**2])
    return World(model, sigmax.Gaussian([-20e3, 5e3, 60.0, -80.0], [1e4, 1e4, 100.0, 100.0]))


def beacons() -> World:
    """A vehicle with odometry among three beacons."""
    drive = motions.unicycle()
    places = {"A": (0.0, 0.0), "B": (100.0, 0.0), "C": (40.0, 90.0)}
    seen = {name: sensors.range_only(origin=at) for name, at in places.items()}
    noises = {name: [0.25] for name in places}
    model = Model(motion=drive, Q=drive.noise(position=0.05, heading=0.01), sensor=seen, R=noises)
    t = np.arange(STEPS)
    inputs = np.column_stack([1.5 + 0.5 * np.sin(t / 15), 0.12 * np.cos(t / 25)])
    return World(model, sigmax.Gaussian([30.0, 30.0, 0.3], [1.0, 1.0, 0.01]), inputs)


def position() -> World:
    """Positions of a target at constant velocity."""
    flight = motions.constant_velocity()
    model = Model(motion=flight, Q=flight.noise(0.2), sensor=sensors.position(), R=[25.0, 25.0])
    return World(model, sigmax.Gaussian([0.0, 0.0, 10.0, -5.0], [100.0, 100.0, 9.0, 9.0]))


def level() -> World:
    """A level that two gauges see."""
    walk = motions.random_walk(("level",))
    seen = {name: sensors.position(at=(0,), names=("level",)) for name in ("near", "far")}
    model = Model(motion=walk, Q=[0.04], sensor=seen, R={"near": [0.09], "far": [0.25]})
    return World(model, sigmax.Gaussian([10.0], [1.0]))


def fused() -> World:
    """A target at constant velocity, its own positions and a radar."""
    flight = motions.constant_velocity(("north", "east"))
    seen = {"own": sensors.position(names=("north", "east")), "radar": sensors.range_azimuth(origin=(2e3, -1e3))}
    noises = {"own": [100.0, 100.0], "radar": [225.0, 0.003**2]}
    model = Model(motion=flight, Q=flight.noise(0.3), sensor=seen, R=noises)
    return World(model, sigmax.Gaussian([-5e3, 3e3, 70.0, 20.0], [1e4, 1e4, 100.0, 100.0]), every={"radar": 3})


def pushed() -> World:
    """Positions of a body whose acceleration is known."""

    def motion(x: Any, dt: Any, u: Any) -> Any:
        return jnp.stack([
            x[0] + dt * x[2] + dt * dt / 2 * u[0], x[1] + dt * x[3] + dt * dt / 2 * u[1],
            x[2] + dt * u[0], x[3] + dt * u[1],
        ])  # fmt: skip

    model = Model(
        motion=motion,
        Q=[1e-4, 1e-4, 1e-3, 1e-3],
        sensor=sensors.position(),
        R=[0.25, 0.25],
        state=("x", "y", "vx", "vy"),
    )
    t = np.arange(STEPS)
    inputs = np.column_stack([0.4 * np.sin(t / 9), 0.3 * np.cos(t / 14)])
    return World(model, sigmax.Gaussian([0.0, 0.0, 1.0, 0.0], [1.0, 1.0, 0.04, 0.04]), inputs)


def two_radars() -> World:
    """Two radars that take turns, and an aircraft that keeps its turn."""
    turn = motions.coordinated_turn()
    seen = {"west": sensors.range_azimuth(origin=(0.0, -8e3)), "south": sensors.range_azimuth(origin=(-9e3, 2e3))}
    noises = {"west": [400.0, 0.002**2], "south": [900.0, 0.003**2]}
    Q = turn.noise(position=1.0, speed=0.5, course=0.003, turn_rate=0.0003)
    model = Model(motion=turn, Q=Q, sensor=seen, R=noises)
    prior = sigmax.Gaussian([3e3, 4e3, 120.0, 0.8, 0.01], [1e4, 1e4, 25.0, 0.01, 1e-6])
    return World(model, prior, every={"south": 2})


def satellite_drive() -> World:
    """A vehicle with odometry, positions now and then, and a compass."""
    drive = motions.unicycle()
    seen = {"gps": sensors.position(), "compass": lambda x: x[2:3]}
    model = Model(
        motion=drive, Q=drive.noise(position=0.03, heading=0.005), sensor=seen,
        R={"gps": [1.0, 1.0], "compass": [0.03**2]}, measurement={"compass": (sigmax.angle("heading"),)},
    )  # fmt: skip
    t = np.arange(STEPS)
    inputs = np.column_stack([3 + np.cos(t / 20), 0.08 * np.sin(t / 18)])
    return World(model, sigmax.Gaussian([5.0, -2.0, 1.0], [4.0, 4.0, 0.01]), inputs, {"gps": 2})


def pendulum() -> World:
    """A pendulum of which angle and rate are seen, in a model of one's own."""

    def motion(x: Any, dt: Any) -> Any:
        middle = x[1] - dt / 2 * (jnp.sin(x[0]) + 0.02 * x[1])
        turned = x[0] + dt * middle
        return jnp.stack([turned, middle - dt / 2 * (jnp.sin(turned) + 0.02 * middle)])

    model = Model(
        motion=lambda x, dt: motion(motion(x, dt / 8), dt / 8), Q=[1e-6, 4e-4],
        sensor={"tip": lambda x: jnp.sin(x[:1]), "gyro": lambda x: x[1:2]}, state=("swing", "rate"),
        R={"tip": [0.01], "gyro": [0.0025]}, measurement={"tip": ("sideways",), "gyro": ("rate",)},
    )  # fmt: skip
    return World(model, sigmax.Gaussian([1.2, 0.0], [0.01, 0.01]))


def ship() -> World:
    """A ship with known thrust and three shore ranges, one of them seldom."""

    def motion(x: Any, dt: Any, u: Any) -> Any:
        return jnp.stack([
            x[0] + dt * x[2], x[1] + dt * x[3], x[2] + dt * (u[0] - 0.05 * x[2]), x[3] + dt * (u[1] - 0.05 * x[3]),
        ])  # fmt: skip

    places = {"pier": (0.0, 0.0), "mole": (900.0, 100.0), "tower": (300.0, 800.0)}
    model = Model(
        motion=motion, Q=[1e-3, 1e-3, 2e-3, 2e-3], state=("x", "y", "vx", "vy"),
        sensor={name: sensors.range_only(origin=at) for name, at in places.items()},
        R={"pier": [4.0], "mole": [9.0], "tower": [4.0]},
    )  # fmt: skip
    t = np.arange(STEPS)
    inputs = np.column_stack([0.15 * np.cos(t / 30), 0.12 * np.sin(t / 22)])
    prior = sigmax.Gaussian([350.0, 250.0, 0.5, 0.5], [25.0, 25.0, 0.25, 0.25])
    return World(model, prior, inputs, {"tower": 3})


SET_ON: dict[str, Callable[[], World]] = {
    "radar": radar, "beacons": beacons, "position": position, "level": level, "fused": fused, "pushed": pushed,
}  # fmt: skip
SCORED: dict[str, Callable[[], World]] = {
    "two radars": two_radars, "satellite drive": satellite_drive, "pendulum": pendulum, "ship": ship,
}  # fmt: skip
WORLDS = SET_ON | SCORED


def process_noise(model: Model) -> np.ndarray:
    """Q of one step (n, n)."""
    Q = model.Q(1.0) if callable(model.Q) else np.asarray(getattr(model.Q, "entries", model.Q))
    return np.asarray(Q) if np.ndim(Q) == 2 else np.diag(np.asarray(Q))


@lru_cache
def compiled(function: Callable[..., Any], many: bool) -> Callable[..., Any]:
    """A function of a model for one state, or for many."""
    return jax.jit(jax.vmap(function) if many else function)


def measured(world: World, x: np.ndarray) -> dict[str, np.ndarray]:
    """What the sensors would see without noise, by sensor (T, m)."""
    return {s: np.array(compiled(h, True)(x)) for s, h in world.model.sensors.items()}


def drawn(world: World, seed: int | Sequence[int], jumps: float = 0.0) -> Drawn:
    """A record of a sound model; with jumps its state moves three times by so many deviations of Q."""
    rng, model = np.random.default_rng(seed), world.model
    x, Q, motion = rng.multivariate_normal(world.prior.mean, world.prior.cov), process_noise(model), model.motion
    states, noises = [], defaultdict(list)
    for k in range(STEPS):
        u = () if world.inputs is None else (world.inputs[k],)
        w = rng.multivariate_normal(np.zeros(len(x)), Q)
        if jumps and k in (STEPS // 4, STEPS // 2, 3 * STEPS // 4):
            w *= jumps / np.sqrt(w @ np.linalg.pinv(Q) @ w)
        x = np.asarray(compiled(motion, False)(x, 1.0, *u)) + w
        states.append(x)
        for s in model.sensors:
            R = np.asarray(model.R[s].entries)
            noises[s].append(rng.normal(size=len(R)) * np.sqrt(R))
    clean = measured(world, np.array(states))
    for s, every in world.every.items():
        clean[s][np.arange(STEPS) % every > 0] = np.nan
    return Drawn({s: clean[s] + np.array(noises[s]) for s in clean}, clean, np.array(states))
