"""What a step costs that estimates a bias: augmented, in two stages, and with points on the state alone.

python benchmarks/stages.py            all sizes (some minutes: large steps are compiled)
python benchmarks/stages.py 4,1,2,1    one size n,p,m,N: state, bias, measurement, sensors
python benchmarks/stages.py --count    scalar operations instead: nothing is compiled, no machine matters

Microseconds per track and step on one core, filters taking turns, the least of the rounds. Sensors are of
different places and corrected together. "every point": the augmented filter that is not told what a function reads, so
that it samples the bias as well: what the paper's augmented filter does. [b; x]: with the root that TSHCIF has too.
"permuted": points drawn in the order in which a function is evaluated least, the state before the bias.
"""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
sys.path.insert(0, str(Path(__file__).parent))

import jax.numpy as jnp
import numpy as np

import sigmax
from sigmax import Bias, Filter, Gaussian, Model
from sigmax.engine import native_engine
from sigmax.engine.lowered import lowered
from sigmax.preparation.prepare import Prepared, prepare
from sigmax.rules.linearization import Function, Linearization, Rule

SIZES = ((4, 1, 2, 1), (4, 1, 2, 3), (4, 4, 2, 3), (6, 3, 2, 3), (6, 6, 3, 1), (6, 6, 3, 4), (9, 6, 3, 1))
TRACKS, STEPS, ROUNDS = 256, 20, 30
TARGETS = {(4, 1): 1.6, (6, 6): 4.0}


@dataclass(frozen=True)
class EveryPoint:
    """A rule that sees a function as its values alone, and takes those of every point."""

    rule: Rule

    def __call__(self, g: Function, x: Any, S: Any, angular: Sequence[bool]) -> Linearization:
        """Linearise g without a look into it."""
        return self.rule(lambda X: g(X), x, S, angular)


def motion(x: Any, dt: Any) -> Any:
    """Positions, velocities (and accelerations) with a drag."""
    k = 2 if len(x) == 4 else 3
    levels = [x[i * k : (i + 1) * k] for i in range(len(x) // k)]
    speed = jnp.sqrt((levels[1] ** 2).sum() + 1.0)
    rate = levels[1] * (1 - 1e-3 * speed * dt)
    moved = [levels[0] + dt * rate, rate + (dt * levels[2] if len(levels) > 2 else 0.0), *levels[2:]]
    return jnp.concatenate(moved)


def model(n: int, p: int, m: int, N: int) -> tuple[Model, Gaussian, dict[str, np.ndarray]]:
    """A model of this size with measurements."""
    rng = np.random.default_rng(0)
    k = 2 if n == 4 else 3
    names = [f"s{i}" for i in range(N)]
    places = rng.uniform(-10e3, 10e3, (N, 3))
    seen = {}
    for s, place in zip(names, places, strict=True):
        at = tuple(range(min(k, m if m == 3 else 2)))
        seen[s] = sigmax.sensors.range_azimuth(at=at, origin=tuple(place[: len(at)]))
    Qb, deviation = np.full(p, 1e-6), np.full(p, 1e-2)
    bias = Bias(
        motion=1e-2 * rng.standard_normal((n, p)),
        sensor={s: rng.standard_normal((m, p)) for s in names},
        Q=Qb,
        prior=Gaussian(np.zeros(p), deviation**2),
    )
    R = {s: np.square([10.0, 0.01, 0.01][:m]) for s in names}
    start = np.r_[[15e3, 12e3, 8e3][:k], [100.0, 80.0, 10.0][:k], [0.1] * (n - 2 * k)]
    made = Model(motion=motion, state=[f"x{i}" for i in range(n)], sensor=seen, Q=np.full(n, 0.1), R=R, bias=bias)
    prior = Gaussian(start, np.square(np.r_[[100.0] * k, [10.0] * k, [1.0] * (n - 2 * k)]))
    z = {}
    for s in names:
        exact = np.asarray(seen[s].function(jnp.asarray(start)))
        z[s] = exact + rng.standard_normal((TRACKS, STEPS, m)) * np.sqrt(R[s])
    return (sigmax.models.fused(made) if N > 1 else made), prior, z


def contenders() -> dict[str, Filter]:
    """The filters by name; HCIF with the root of [b; x] is what TSHCIF is equal to."""
    augmented = sigmax.get("HCIF")
    first = replace(augmented, form=replace(augmented.form, bias_first=True))
    return {
        "CKF": sigmax.get("CKF"),
        "CIF": sigmax.get("CIF"),
        "HCIF, every point": replace(
            augmented, predict=EveryPoint(augmented.predict), correct=EveryPoint(augmented.correct)
        ),
        "HCIF": augmented,
        "HCIF [b; x]": first,
        "TSHCIF": sigmax.get("TSHCIF"),
        "TSHCIF permuted": sigmax.get("TSHCIF", permute=True),
        "MTSHCIF": sigmax.get("MTSHCIF"),
        "MTSHCIF projected": sigmax.get("MTSHCIF", points="projected"),
        "MTSHCIF permuted": sigmax.get("MTSHCIF", permute=True),
        "MTSHCKF": sigmax.get("MTSHCKF"),
    }


def seconds(ready: Prepared) -> float:
    """Processor time of a record: others that run on the machine do not count."""
    begun = time.process_time()
    native_engine.filtered(frozenset(), ready)
    return time.process_time() - begun


def measured(size: tuple[int, int, int, int]) -> dict[str, tuple[float, float]]:
    """Microseconds of a prediction and of the whole step, by filter."""
    given = model(*size)
    ready = {name: prepare(f, *given, 1.0, None, "float64") for name, f in contenders().items()}
    turns = [laid._replace(z={}) for laid in ready.values()] + list(ready.values())
    # The least of many rounds: whatever disturbs a measurement makes it longer.
    rounds = [[seconds(laid) for laid in turns] for _ in range(ROUNDS)]
    alone, whole = np.split(np.min(rounds, axis=0) * 1e6 / (TRACKS * STEPS), 2)
    return {name: (float(a), float(b)) for name, a, b in zip(ready, alone, whole, strict=True)}


def counted(size: tuple[int, int, int, int]) -> dict[str, tuple[float, float]]:
    """Thousands of scalar operations of a prediction and of the whole step, by filter."""
    given, found = model(*size), {}
    for name, f in contenders().items():
        ready = prepare(f, *given, 1.0, None, "float64")
        low = lowered(ready.filter, ready.model, 0 if ready.u is None else ready.u.shape[-1], "float64")
        ((sensor, z),) = ready.z.items()
        alone, update = low.program("predict"), low.program("correct", sensor, z.shape[-1])
        found[name] = alone.operations / 1e3, (alone.operations + update.operations) / 1e3
    return found


def main() -> None:
    """Print the table, line by line."""
    count = "--count" in sys.argv
    asked = [tuple(map(int, a.split(","))) for a in sys.argv[1:] if a != "--count"] or SIZES
    names = list(contenders())
    heads = ["HCIF, every point / MTSHCIF", "HCIF / MTSHCIF", "TSHCIF / HCIF [b; x]"]
    print(f"| n, p, m, N | {' | '.join([*names, *heads])} |")
    print("|-" * (len(names) + len(heads) + 1) + "|")
    for size in asked:
        took = (counted if count else measured)(size)  # type: ignore[arg-type]
        whole = {name: b for name, (_, b) in took.items()}
        digits = 1 if count else 2
        cells = [f"{a:.{digits}f} + {b - a:.{digits}f}" for a, b in took.values()]
        marginal, staged = whole["HCIF, every point"] / whole["MTSHCIF"], whole["TSHCIF"] / whole["HCIF [b; x]"]
        near = f"{whole['HCIF'] / whole['MTSHCIF']:.2f}"
        said, two = f"{marginal:.1f}", f"{staged:.2f}"
        # What was aimed at are times.
        if not count:
            target = TARGETS.get(size[:2])
            said += f" (target {target}: {'reached' if marginal >= target else 'missed'})" if target else ""
            two += f" (target 1.1: {'reached' if staged <= 1.1 else 'missed'})"
        print(f"| {', '.join(map(str, size))} | {' | '.join([*cells, said, near, two])} |", flush=True)


if __name__ == "__main__":
    main()
