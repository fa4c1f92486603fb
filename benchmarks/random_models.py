"""Random linear models against a Kalman filter in extended precision: how many answers are wrong and not flagged.

`python benchmarks/random_models.py --models 1000000 --seed 7` draws models by the seed and runs every form of the
filter and its smoother over them. It prints a table, and adds what is done to `--out`, so that a run which was stopped
goes on where it was. A model is *silent* if, before any fault, a mean is off by 1e-3 of the
exact deviation or a deviation by 1e-3 of itself; it is *flagged* if it has a fault. Models whose exact answer moves by
1e-6 of a deviation when their numbers, and the means that a filter keeps, move in the last bit are counted apart, as
*beyond double precision*.

It needs a C compiler whose `long double` is longer than a double.
"""

import argparse
import ctypes
import json
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from linear_models import Models, Shape, draw, run_form
from sigmax import forms

FORMS = {
    "covariance": forms.covariance,
    "square root": forms.square_root,
    "square root, block": forms.block,
    "information": forms.information,
    "square root, information": forms.root_information,
    "two stages": forms.two_stage(forms.covariance),
    "two stages, information": forms.two_stage(forms.information),
}
SHAPES = [
    Shape(1, (1,), 0), Shape(2, (1,), 1), Shape(3, (2,), 0), Shape(3, (2, 1), 2), Shape(4, (2,), 0),
    Shape(2, (1, 1), 0), Shape(4, (3, 1), 1), Shape(5, (3,), 0), Shape(6, (2, 2), 2), Shape(6, (6,), 0),
    Shape(7, (4,), 0), Shape(8, (1,), 1), Shape(9, (5,), 0), Shape(10, (2, 3), 2), Shape(11, (3,), 0),
    Shape(12, (6,), 0), Shape(12, (4, 2), 1),
]  # fmt: skip
TOO_MUCH = 1e-3
POSED = 1e-6


def chunk(shape: Shape) -> int:
    """How many models of a shape are run at once: the larger, the fewer."""
    return 4000 if shape.n <= 4 else 1000 if shape.n <= 8 else 250


@cache
def judge() -> ctypes.CDLL:
    """The filter in extended precision, compiled."""
    if np.finfo(np.longdouble).nmant < 63:
        raise SystemExit("long double is no longer than a double here: there is nothing to judge by")
    library = Path(tempfile.mkdtemp()) / "exact_kalman.so"
    source = Path(__file__).with_name("exact_kalman.c")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    return ctypes.CDLL(str(library))


def exact(models: Models, in_double: bool = False) -> np.ndarray:
    """(B, 2, T, 2, N): of filter and smoother, at each step, mean and deviation; or with means rounded to double."""
    B, T, m, N = models.H.shape
    out = np.empty((B, 2, T, 2, N), np.longdouble)
    arrays = [np.ascontiguousarray(a) for a in models if a is not models.dt]
    *inputs, result = [ctypes.c_void_p(a.ctypes.data) for a in (*arrays, out)]
    judge().tracks(ctypes.c_long(B), N, m, T, *inputs, int(in_double), result)
    return out


def moved(models: Models, rng: np.random.Generator) -> Models:
    """The same with every number of F, H, z and the mean moved by half a unit in its last place, up or down."""

    def last_bit(a: np.ndarray) -> np.ndarray:
        return a * (1 + rng.choice([-1, 1], a.shape) * np.finfo(float).eps / 2)

    changed = {name: last_bit(getattr(models, name)) for name in ("mean", "F", "H", "z")}
    return models._replace(**changed)


class Count(NamedTuple):
    """Of one form: models, those silently wrong, those flagged, and the worst error before a fault."""

    models: int = 0
    silent: int = 0
    flagged: int = 0
    worst: float = 0.0

    def __add__(self, other: "Count") -> "Count":
        return Count(*(a + b for a, b in zip(self[:3], other[:3], strict=True)), max(self.worst, other.worst))


def errors(mean: np.ndarray, std: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The largest error of each model and step (B, T), in exact deviations and of them."""
    sd = truth[:, :, 1]
    off = np.maximum(np.abs(mean - truth[:, :, 0]) / sd, np.abs(std / sd - 1)).max(-1)
    return np.where(np.isfinite(off), off, np.inf).astype(float)


def posed(models: Models, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Whether the exact answer to each model (B) is determined by digits of double precision."""
    near = exact(moved(models, rng), in_double=True)
    apart = [errors(near[:, i, :, 0], near[:, i, :, 1], truth[:, i]).max(1) for i in range(2)]
    return np.maximum(*apart) < POSED


def score(shape: Shape, count: int, rng: np.random.Generator) -> dict[str, Count]:
    """Counts over models drawn, by "form, filter or smoother, within or beyond"."""
    models = draw(shape, count, rng)
    truth = exact(models)
    within = posed(models, truth, rng)
    counts = {}
    for name, form in FORMS.items():
        if form.biased is not None and not shape.p:
            continue  # without a bias there is one stage
        told = run_form(form, shape, models)
        failed = told["filter"][2] != 0
        bad = failed.any(1)
        for i, (what, (mean, std, fault)) in enumerate(told.items()):
            flagged = bad | (fault != 0).any(1)
            # A filtered step has seen the steps before it, a smoothed one all.
            sound = np.cumsum(failed, axis=1) == 0 if what == "filter" else ~flagged[:, None]
            off = np.where(sound, errors(mean, std, truth[:, i]), 0).max(1)
            for where, own in (("within", within), ("beyond", ~within)):
                silent = (off[own] > TOO_MUCH).sum()
                counted = Count(int(own.sum()), int(silent), int(flagged[own].sum()), float(off[own].max(initial=0)))
                counts[f"{name}; {what}; {where}"] = counted
    return counts


def table(counts: dict[str, Count]) -> Table:
    """The counts, a row for each form of filter and smoother."""
    shown = Table("form", "of", "models", "silent", "flagged", "worst error", "beyond double", "silent", "flagged")
    for key in counts:
        name, what, where = key.split("; ")
        if where == "within":
            c, beyond = counts[key], counts[f"{name}; {what}; beyond"]
            numbers = [c.models, c.silent, c.flagged, f"{c.worst:.1e}", beyond.models, beyond.silent, beyond.flagged]
            shown.add_row(name, what, *map(str, numbers))
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=int, default=10_000, help="so many in all, with what is there already")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("random_models.jsonl"), help="what is done, a chunk a line")
    given = parser.parse_args()
    done = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    done = [d for d in done if d["seed"] == given.seed]
    there, total, at = {d["chunk"] for d in done}, sum(d["models"] for d in done), 0
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("models", total=given.models, completed=total)
        while total < given.models:
            if at not in there:
                shape = SHAPES[at % len(SHAPES)]
                size = min(chunk(shape), given.models - total)
                counts = score(shape, size, np.random.default_rng([given.seed, at]))
                done.append({"seed": given.seed, "chunk": at, "shape": shape, "models": size, "counts": counts})
                with given.out.open("a") as file:
                    file.write(json.dumps(done[-1]) + "\n")
                total += size
                progress.update(task, completed=total)
            at += 1
    counts: dict[str, Count] = {}
    for d in done:
        for key, value in d["counts"].items():
            counts[key] = counts.get(key, Count()) + Count(*value)
    console = Console(width=120)
    console.print(f"{total} models of seed {given.seed}, {len(SHAPES)} shapes, 12 steps")
    console.print(table(counts))


if __name__ == "__main__":
    main()
