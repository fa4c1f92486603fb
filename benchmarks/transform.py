"""What the order of the state saves: one linearisation over a map, whole steps, and flights at equal accuracy.

Run it as `python benchmarks/transform.py`; another map by `--map FILE`. `--study FOLDER` adds what a run of
`sigmax compare belov-terrain --out FOLDER` says, `--write docs/cheap-transform.md` puts all that into
the page.
"""

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.interpolate import RectBivariateSpline

import sigmax
from report import Section, markdown, show, write
from sigmax.records.maps import elevation
from sigmax.records.terrain import START, flight, middle, terrain_model
from sigmax.running.explain import explain

SETS = {"2n": ("CKF", {}), "2n+1": ("UKF", {}), "n+1": ("SKF", {"moireau": 1}), "n+1 reversed": ("SKF", {})}
MODELS = ("radar-ct", "radar-ct-cartesian", "terrain")


def spline(ground):
    """The same heights by SciPy's bicubic spline, which JAX cannot trace."""
    (x0, x1), (z0, z1) = ground.extent
    rows, columns = ground.heights.shape
    fitted = RectBivariateSpline(np.linspace(z0, z1, rows), np.linspace(x0, x1, columns), ground.heights)
    return sigmax.models.opaque(lambda x, z: fitted.ev(z, x))


def transforms(map_name):
    """Time of one linearisation of the altimeter, in the order of the state and in the best one."""
    ground = middle(elevation(map_name))
    place = flight(ground).place
    prior = sigmax.Gaussian(np.zeros(7), np.square(START))
    rows = []
    for label, looked in (("bicubic, native", ground), ("SciPy's spline, opaque", spline(ground))):
        model = terrain_model(looked)
        for name, (base, parameters) in SETS.items():
            found = explain(sigmax.get(base, **parameters), model, prior, inputs=place[len(place) // 2])[-1]
            (part,) = (p for p in found.parts if "look-up" in p.what or "opaque" in p.what)
            before, after = (f"{1e6 * s:.3g}" for s in found.seconds)
            counts = f"{part.given} → {part.permuted}"
            saved = f"{found.measured:.1%}", f"{1 - part.permuted / part.given:.1%}"
            rows.append((label, name, counts, before, after, *saved))
    columns = ("look-up", "points", "evaluations", "µs before", "µs after", "time saved", "evaluations saved")
    return Section("One linearisation of the altimeter, of one track", "", columns, rows)


def steps(rounds=20, tracks=2048, T=20):
    """Time of a whole step in a batch, with and without the permutation, in turn."""
    rows = []
    for name, base in itertools.product(MODELS, ("SRCKFB", "SRUKFB")):
        made = sigmax.builtin(name)
        m = len(made.model.measurement[""])
        z = np.asarray(seen_at_the_start(made))[None, None] * np.ones((tracks, T, m))
        u = None if made.inputs is None else np.tile(made.inputs, (T, 1))
        best = [np.inf, np.inf]
        for _ in range(rounds):
            for i, permute in enumerate((False, True)):
                chosen = sigmax.get(base, permute=permute)
                start = time.perf_counter()
                sigmax.run(chosen, made.model, made.prior, z, dt=made.dt, inputs=u, keep=())
                best[i] = min(best[i], time.perf_counter() - start)
        found = explain(base, made.model, made.prior, dt=made.dt, inputs=made.inputs, measure=False)
        orders = "; ".join(f"{one.function} {', '.join(one.order) if one.estimated else '–'}" for one in found)
        before, after = (1e6 * b / (tracks * T) for b in best)
        rows.append((name, base, orders, f"{before:.3f}", f"{after:.3f}", f"{1 - after / before:.1%}"))
    columns = ("model", "filter", "drawn first", "µs before", "µs after", "time saved")
    return Section("A whole step of one track, in a batch", "", columns, rows)


def flights(folder):
    """Median and RMSE of the horizontal position at the end, runs lost and cost, from the summary of the study."""
    told = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    end = max(told["rmse"]["EKF"]["dx"], key=float)

    def apart(of):
        return f"{np.hypot(of['dx'][end], of['dz'][end]):.1f}"

    rows = [
        (
            name,
            f"{motion} + {sensor}",
            f"{told['relative_cost'][name]:.2f}",
            apart(told["median"][name]),
            apart(told["rmse"][name]),
            f"{told['lost'][name]:.1%}",
        )
        for name, (motion, sensor) in told["evaluations"].items()
    ]
    if told["optimum"] is not None:
        rows.append(("optimum", "–", "–", "–", apart(told["optimum"]), "–"))
    columns = ("filter", "evaluations", "cost / EKF", "median error, m", "RMSE, m", "lost")
    note = f"{told['runs']} flights of {float(end):.0f} s over the Jacksboro fault; position at the end."
    return Section("Flights", note, columns, rows)


def seen_at_the_start(made):
    """What the sensor says at the mean of the prior."""
    given = () if made.inputs is None else (made.inputs,)
    return made.model.sensors[""](np.asarray(made.prior.mean), *given[: made.model.sensor_inputs[""]])


def marks(name):
    """The lines of a page between which a table stands."""
    return f"<!-- {name}: written by transform.py -->", f"<!-- end of {name} -->"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", default="jacksboro")
    parser.add_argument("--study", type=Path, help="folder of sigmax compare belov-terrain")
    parser.add_argument("--only-study", action="store_true", help="measure no times")
    parser.add_argument("--write", type=Path, help="page to write into")
    chosen = parser.parse_args()
    made = {} if chosen.only_study else {"times": [transforms(chosen.map), steps()]}
    if chosen.study is not None:
        made["flights"] = [flights(chosen.study)]
    for name, sections in made.items():
        for section in sections:
            show(section, Console())
        if chosen.write is not None:
            write(chosen.write, "\n".join(map(markdown, sections)), *marks(name))
