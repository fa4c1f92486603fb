"""How often `sigmax.doctor` names a fault that was put into a record, and how often it speaks of a sound one.

python benchmarks/doctor.py [--sound N] [--seeds N] [--only set|scored] [--model NAME] [--jobs N]

Thresholds may be set on the models and seeds of the tables "set on"; those of "scored" are other models with other
seeds, and nothing was set on them.

A record may not tell of a fault: positions that are all too far east by 5 m say nothing where nothing else is known.
So each fault is judged by one who knows it, its place and its size: the log-likelihood of model and record without
the fault, less that with it; of long tails, what their density gains over a Gaussian of any width. Where that is
below LIMIT the fault counts as untold, and is not among those to be found.
"""

import argparse
import resource
import sys
import time
from collections import defaultdict
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple
from zlib import crc32

import numpy as np

import sigmax
from doctor_faults import Faulty, cases
from doctor_worlds import SCORED, SET_ON, WORLDS, World, drawn
from sigmax.examination import Examination

# What a cause must gain to be believed by the doctor, about.
LIMIT = 8.0


class Row(NamedTuple):
    """One record: whether it tells the fault, whether something was found, and the right thing, of the right size."""

    strength: int
    told: bool
    found: bool
    named: bool
    sized: bool | None
    said: str


def examined(world: World, z: dict[str, np.ndarray]) -> Examination:
    """What the doctor says."""
    whole = z if world.model.several else z[""]
    return sigmax.doctor(world.model, world.prior, whole, inputs=world.inputs)


def likelihood(world: World, z: dict[str, np.ndarray]) -> float:
    """Of a record, by the Gaussian filter; −inf where it fails."""
    whole = z if world.model.several else z[""]
    done = sigmax.run("EKF", world.model, world.prior, whole, inputs=world.inputs)
    return float(done.log_likelihood) if np.asarray(done.ok).all() else -np.inf


def tells(case: Faulty) -> bool:
    """Whether the record tells the fault to one who knows it."""
    if case.right is None:
        return case.tails > LIMIT
    wrong = likelihood(case.world, case.z)
    return not np.isfinite(wrong) or likelihood(*case.right) - case.jacobian - wrong > LIMIT


def sound(name: str, seeds: range) -> list[str]:
    """The kinds of the first findings in sound records of a model."""
    world, kinds = WORLDS[name](), []
    for seed in seeds:
        found = examined(world, drawn(world, [seed, crc32(name.encode())]).z).findings
        kinds += [found[0].kind] if found else []
    return kinds


def print_sound(kinds: dict[str, list[str]], seeds: range) -> None:
    """How many sound records have a finding."""
    for name, some in kinds.items():
        said = ", ".join(f"{k} {some.count(k)}" for k in sorted(set(some)))
        print(f"| {name} | {len(seeds)} | {len(some)} | {said} |")
    total, count = sum(map(len, kinds.values())), len(seeds) * len(kinds)
    print(
        f"\nSound: {total} of {count} with a finding, at most {100 * bound(total, count):.2g} % (at 95 %)", flush=True
    )


def bound(k: int, n: int) -> float:
    """The largest share that k of n still allow, at 95 % (Clopper and Pearson)."""
    from scipy.stats import beta

    return float(beta.ppf(0.95, k + 1, n - k)) if n else 1.0


def faults(name: str, seeds: range) -> list[tuple[str, Row]]:
    """What the doctor says of each fault of a model, by the name of the fault."""
    world, rows = WORLDS[name](), []
    for case in cases():
        for seed in seeds if case.fits(world) else ():
            # Draws of their own: the same ones for all models and strengths are one sample.
            draw = [seed, crc32(name.encode()), crc32(case.fault.encode()), case.strength]
            given = case.made(world, drawn(world, draw), np.random.default_rng([*draw, 1]))
            f = next(iter(examined(given.world, given.z).findings), None)
            named = f is not None and bool({f.kind, *f.either_kinds} & set(case.kinds))
            sized = None
            # Of two sensors the other one may be late, or too short, the other way round: then it has no size here.
            if f is not None and case.size is not None and f.kind == case.kinds[0] and placed(f.where, given):
                sized = abs(f.value - case.size) < 2 * f.std
            said = f"{'silent' if f is None else f.kind} ({name})"
            row = Row(case.strength, tells(given), f is not None, named, sized, said)
            rows.append((case.fault, row))
            if row.told and not named:
                print(f"{case.fault}, strength {case.strength + 1}, seed {seed}: {said}", file=sys.stderr, flush=True)
    return rows


def print_faults(every: list[tuple[str, Row]]) -> None:
    """Shares of faults found, named first or tied, and sizes within two standard errors."""
    rows: dict[str, list[Row]] = defaultdict(list)
    for fault, row in every:
        rows[fault].append(row)
    for fault, found in rows.items():
        at = [[r for r in found if r.told and r.strength == i] for i in range(3)]
        told = " ".join(f"{len(some)}/{sum(r.strength == i for r in found)}" for i, some in enumerate(at))
        sized = [r.sized for some in at for r in some if r.sized is not None]
        others = sorted({r.said for some in at for r in some if not r.named})
        print(
            f"| {fault} | {told} | {shares([[r.found for r in some] for some in at])} "
            f"| {shares([[r.named for r in some] for some in at])} | {shares([sized])} | {', '.join(others) or '–'} |",
            flush=True,
        )
    large = [r for some in rows.values() for r in some if r.strength > 0]
    for what, some in (("told by their records", [r for r in large if r.told]), ("all", large)):
        print(f"\nThe two larger strengths, {what}: {len(some)}; found {np.mean([r.found for r in some]):.3f}, "
              f"named first or tied {np.mean([r.named for r in some]):.3f}", flush=True)  # fmt: skip
    sized = [r.sized for r in large if r.told and r.sized is not None]
    print(f"\nOf {len(sized)} sizes {np.mean(sized):.3f} are within two standard errors.\n", flush=True)


def placed(where: str, given: Faulty) -> bool:
    """Whether a finding is not about another sensor than the first, which the faults are put into."""
    return not any(where.split(".")[0] == s for s in list(given.z)[1:])


def shares(groups: list[list[bool]]) -> str:
    """The share of each, – where there are none."""
    return " ".join(f"{np.mean(some):.2f}" if some else "–" for some in groups)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sound", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", choices=("set", "scored"))
    parser.add_argument("--model", action="append", help="of one model, or some: " + ", ".join(WORLDS))
    parser.add_argument("--jobs", type=int, default=2, help="models at a time")
    given, begun = parser.parse_args(), time.perf_counter()
    with get_context("spawn").Pool(given.jobs, maxtasksperchild=1) as pool:
        for title, worlds, first in (("set on", SET_ON, 0), ("scored", SCORED, 1000)):
            names = [name for name in worlds if not given.model or name in given.model]
            if (given.only and not title.startswith(given.only)) or not names:
                continue
            seeds = range(first, first + given.sound), range(first + 500, first + 500 + given.seeds)
            asked = pool.map_async(partial(faults, seeds=seeds[1]), names, 1)
            print(f"{title}\n")
            if given.sound:
                print("| sound model | records | with a finding | of kind |\n|---|---|---|---|")
                kinds = pool.map(partial(sound, seeds=seeds[0]), names, 1)
                print_sound(dict(zip(names, kinds, strict=True)), seeds[0])
            print(
                "\n| fault | told by the record (strength 1 2 3) | found | named first or tied "
                "| size within 2 std | else |\n"
                "|---|---|---|---|---|---|"
            )
            print_faults([row for some in asked.get() for row in some])
        pool.close()
        pool.join()
    of_jobs = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{time.perf_counter() - begun:.0f} s, of the processor {of_jobs.ru_utime + of_jobs.ru_stime:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
