"""How often `sigmax.doctor` names a fault that was put into a record, and how often it speaks of a sound one.

python benchmarks/doctor.py [--sound N] [--seeds N]: seeds below 1000 are those that thresholds may be set on,
the table "scored" is of other seeds and of models that nothing was set on.
"""

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

import sigmax
from sigmax.examination import Examination

STEPS = 300


class World(NamedTuple):
    """A model, its prior, and what drives it (T, k) or None."""

    model: sigmax.Model
    prior: sigmax.Gaussian
    inputs: np.ndarray | None = None


def radar() -> World:
    """A radar that sees a target at constant velocity."""
    flight = sigmax.motions.constant_velocity(("north", "east"))
    seen = sigmax.sensors.range_azimuth()
    model = sigmax.Model(motion=flight, Q=flight.noise(0.5), sensor=seen, R=[30.0**2, 0.002**2])
    return World(model, sigmax.Gaussian([-20e3, 5e3, 60.0, -80.0], [1e4, 1e4, 100.0, 100.0]))


def beacons() -> World:
    """A vehicle with odometry among three beacons."""
    drive = sigmax.motions.unicycle()
    places = {"A": (0.0, 0.0), "B": (100.0, 0.0), "C": (40.0, 90.0)}
    seen = {name: sigmax.sensors.range_only(origin=at) for name, at in places.items()}
    model = sigmax.Model(
        motion=drive, Q=drive.noise(position=0.05, heading=0.01), sensor=seen, R={name: [0.25] for name in places}
    )
    t = np.arange(STEPS)
    inputs = np.column_stack([1.5 + 0.5 * np.sin(t / 15), 0.12 * np.cos(t / 25)])
    return World(model, sigmax.Gaussian([30.0, 30.0, 0.3], [1.0, 1.0, 0.01]), inputs)


def position() -> World:
    """Positions of a target at constant velocity."""
    flight = sigmax.motions.constant_velocity()
    model = sigmax.Model(motion=flight, Q=flight.noise(0.2), sensor=sigmax.sensors.position(), R=[25.0, 25.0])
    return World(model, sigmax.Gaussian([0.0, 0.0, 10.0, -5.0], [100.0, 100.0, 9.0, 9.0]))


def level() -> World:
    """A level that two gauges see."""
    walk = sigmax.motions.random_walk(("level",))
    seen = {name: sigmax.sensors.position(at=(0,), names=("level",)) for name in ("near", "far")}
    model = sigmax.Model(motion=walk, Q=[0.04], sensor=seen, R={"near": [0.09], "far": [0.25]})
    return World(model, sigmax.Gaussian([10.0], [1.0]))


SET_ON = {"radar": radar, "beacons": beacons}
SCORED = {"position": position, "level": level}


def drawn(world: World, seed: int) -> dict[str, np.ndarray]:
    """A record of a sound model by sensor, (T, m), drawn by NumPy alone."""
    rng, model = np.random.default_rng(seed), world.model
    n = len(world.prior.mean)
    x = rng.multivariate_normal(world.prior.mean, world.prior.cov)
    Q = model.Q(1.0) if callable(model.Q) else np.asarray(getattr(model.Q, "entries", model.Q))
    Q = np.asarray(Q) if np.ndim(Q) == 2 else np.diag(np.asarray(Q))
    z: dict[str, list[np.ndarray]] = defaultdict(list)
    for k in range(STEPS):
        u = () if world.inputs is None else (world.inputs[k],)
        x = np.asarray(model.motion(x, 1.0, *u)) + rng.multivariate_normal(np.zeros(n), Q)
        for s, h in model.sensors.items():
            R = np.asarray(model.R[s].entries)
            z[s].append(np.asarray(h(x)) + rng.normal(size=len(R)) * np.sqrt(R))
    return {s: np.array(rows) for s, rows in z.items()}


class Case(NamedTuple):
    """A fault in a record, its kinds as the doctor may name them, and its size where it has one."""

    fault: str
    kinds: tuple[str, ...]
    strength: int
    size: float | None
    change: Callable[[World, dict[str, np.ndarray], np.random.Generator], tuple[World, dict[str, np.ndarray]]]


def on_first(change: Callable[..., np.ndarray]) -> Any:
    """A change of the first component of the first sensor; it is given the deviation of its noise."""

    def changed(
        world: World, z: dict[str, np.ndarray], rng: np.random.Generator
    ) -> tuple[World, dict[str, np.ndarray]]:
        s = next(iter(z))
        own = z[s].copy()
        own[:, 0] = change(own[:, 0], np.sqrt(np.asarray(world.model.R[s].entries)[0]), rng)
        return world, z | {s: own}

    return changed


def wrong_q(c: float) -> Any:
    """A model whose Q is the truth times 1 / c."""

    def changed(world: World, z: Any, rng: Any) -> Any:
        import copy

        model, Q = copy.copy(world.model), world.model.Q
        value = Q(1.0) if callable(Q) else getattr(Q, "entries", Q)
        model.Q = sigmax.Model(
            motion=model.motion, state=model.state, Q=np.asarray(value) / c, sensor=lambda x: x[:1], R=[1.0]
        ).Q
        return world._replace(model=model), z

    return changed


def wrong_prior(k: float) -> Any:
    """A prior whose first component is off by k deviations."""

    def changed(world: World, z: Any, rng: Any) -> Any:
        mean = np.array(world.prior.mean)
        mean[0] -= k * np.sqrt(world.prior.cov[0, 0])
        return world._replace(prior=sigmax.Gaussian(mean, world.prior.cov)), z

    return changed


def stuck(v: np.ndarray, s: float, rng: Any, length: int) -> np.ndarray:
    """The value of row 100 held for some rows."""
    v = v.copy()
    v[100 : 100 + length] = v[100]
    return v


def cases() -> Iterator[Case]:
    """All faults, each in three strengths."""
    for i, c in enumerate((1.6, 2.5, 6.0)):
        yield Case(
            "R", ("R",), i, np.log(c), on_first(lambda v, s, g, c=c: v + g.normal(size=len(v)) * s * np.sqrt(c - 1))
        )
    for i, c in enumerate((4.0, 16.0, 64.0)):
        yield Case("Q", ("Q",), i, np.log(c), wrong_q(c))
    for i, c in enumerate((0.5, 1.5, 4.0)):
        yield Case("bias", ("bias",), i, None, on_first(lambda v, s, g, c=c: v + c * s))
    for i, c in enumerate((0.01, 0.03, 0.07)):
        yield Case("scale", ("scale",), i, c, on_first(lambda v, s, g, c=c: v * (1 + c)))
    for i, c in enumerate((0.02, 0.05, 0.15)):
        far = on_first(lambda v, s, g, c=c: v + 10 * s * (g.random(len(v)) < c) * g.normal(size=len(v)))
        yield Case("outliers", ("outliers", "tails"), i, None, far)
    for i, c in enumerate((6.0, 4.0, 2.5)):
        long = on_first(lambda v, s, g, c=c: v - s * g.normal(size=len(v)) * 0 + s * g.standard_t(c, size=len(v)))
        yield Case("tails", ("tails", "outliers", "R"), i, None, long)
    for i, c in enumerate((2.0, 4.0, 8.0)):
        yield Case("coarse", ("coarse",), i, None, on_first(lambda v, s, g, c=c: np.round(v / (c * s)) * c * s))
    for i, c in enumerate((8, 16, 40)):
        yield Case("stuck", ("stuck",), i, None, on_first(lambda v, s, g, c=c: stuck(v, s, g, c)))
    for i, c in enumerate((5.0, 10.0, 30.0)):
        yield Case("prior", ("prior",), i, c, wrong_prior(c))
    yield Case("sign", ("sign",), 2, None, on_first(lambda v, s, g: -v))
    yield Case("km for m", ("units",), 2, None, on_first(lambda v, s, g: v / 1000))


def examined(world: World, z: dict[str, np.ndarray]) -> Examination:
    """What the doctor says."""
    whole: Any = z if world.model.several else z[""]
    return sigmax.doctor(world.model, world.prior, whole, inputs=world.inputs)


def sound(worlds: dict[str, Callable[[], World]], seeds: range) -> None:
    """How many sound records have a finding."""
    for name, make in worlds.items():
        world, spoken, kinds = make(), 0, defaultdict(int)
        for seed in seeds:
            found = examined(world, drawn(world, seed)).findings
            spoken += bool(found)
            kinds[found[0].kind if found else ""] += 1
        said = ", ".join(f"{k} {v}" for k, v in kinds.items() if k)
        print(f"| {name} | {len(seeds)} | {spoken} | {said} |", flush=True)


def faults(worlds: dict[str, Callable[[], World]], seeds: range) -> None:
    """Shares of faults found, named first or tied, and sizes within two standard errors."""
    rows: dict[str, list[tuple[int, bool, bool, bool | None, str]]] = defaultdict(list)
    for make in worlds.values():
        world = make()
        for case in cases():
            for seed in seeds:
                changed, z = case.change(world, drawn(world, seed), np.random.default_rng(seed + 10**6))
                f = next(iter(examined(changed, z).findings), None)
                named = f is not None and (f.kind in case.kinds or any(k in f.either_kinds for k in case.kinds))
                right = None
                if f is not None and case.size is not None and f.kind == case.kinds[0]:
                    right = abs(f.value - case.size) < 2 * f.std
                rows[case.fault].append((case.strength, f is not None, named, right, "silent" if f is None else f.kind))
    for fault, found in rows.items():
        cells = []
        for which in (1, 2):
            cells.append(" ".join(
                f"{np.mean(some):.2f}" if (some := [r[which] for r in found if r[0] == i]) else "–" for i in range(3)
            ))  # fmt: skip
        sized = [r[3] for r in found if r[3] is not None]
        others = sorted({r[4] for r in found if not r[2]})
        share = f"{np.mean(sized):.2f}" if sized else "–"
        print(f"| {fault} | {cells[0]} | {cells[1]} | {share} | {', '.join(others) or '–'} |", flush=True)
    large = [r for some in rows.values() for r in some if r[0] > 0]
    print(f"\nThe two larger strengths, {len(large)} records: found {np.mean([r[1] for r in large]):.3f}, "
          f"named first or tied {np.mean([r[2] for r in large]):.3f}\n", flush=True)  # fmt: skip


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sound", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=4)
    given, begun = parser.parse_args(), time.perf_counter()
    for title, worlds, first in (("set on", SET_ON, 0), ("scored", SCORED, 1000)):
        print(f"{title}\n\n| sound model | records | with a finding | of kind |\n|---|---|---|---|")
        sound(worlds, range(first, first + given.sound))
        print(
            "\n| fault | found (strength 1 2 3) | named first or tied | size within 2 std | else |\n"
            "|---|---|---|---|---|"
        )
        faults(worlds, range(first + 500, first + 500 + given.seeds))
    print(f"{time.perf_counter() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
