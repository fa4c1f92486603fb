"""What the order of the state saves: one linearisation over a map, and whole steps on a radar.

Run it as `python benchmarks/transform.py`; another map by `--map FILE`.
"""

import argparse
import itertools
import time

import numpy as np
from scipy.interpolate import RectBivariateSpline

import sigmax
from sigmax.records.maps import elevation
from sigmax.records.terrain import START, flight, terrain_model
from sigmax.running.explain import explain

SETS = {"2n": ("CKF", {}), "2n+1": ("UKF", {}), "n+1": ("SKF", {"moireau": 1}), "n+1 reversed": ("SKF", {})}


def spline(ground):
    """The same heights by SciPy's bicubic spline, which JAX cannot trace."""
    (x0, x1), (z0, z1) = ground.extent
    rows, columns = ground.heights.shape
    fitted = RectBivariateSpline(np.linspace(z0, z1, rows), np.linspace(x0, x1, columns), ground.heights)
    return sigmax.opaque(lambda x, z: fitted.ev(z, x))


def transforms(map_name):
    """Time of one linearisation of the altimeter, in the order of the state and in the best one."""
    ground = elevation(map_name)
    place = flight(ground).place
    prior = sigmax.Gaussian(np.zeros(7), np.square(START))
    print("look-up                  set            µs before    after   saved   of evaluations")
    for label, looked in (("bicubic, native", ground), ("SciPy's spline, opaque", spline(ground))):
        model = terrain_model(looked)
        for name, (base, parameters) in SETS.items():
            found = explain(sigmax.get(base, **parameters), model, prior, inputs=place[len(place) // 2])[-1]
            if found.seconds is not None:
                before, after = (1e6 * s for s in found.seconds)
                print(f"{label:24} {name:12} {before:11.3f} {after:8.3f} {found.measured:7.1%} {found.estimated:10.1%}")


def steps(rounds=20, tracks=2048, T=20):
    """Time of a whole step in a batch, with and without the permutation, in turn."""
    print("\nmodel               filter     µs before    after   saved")
    for name, base in itertools.product(("radar-ct", "radar-ct-cartesian", "terrain"), ("SRCKFB", "SRUKFB")):
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
        before, after = (1e6 * b / (tracks * T) for b in best)
        print(f"{name:19} {base:8} {before:11.3f} {after:8.3f} {1 - after / before:7.1%}")


def seen_at_the_start(made):
    """What the sensor says at the mean of the prior."""
    given = () if made.inputs is None else (made.inputs,)
    return made.model.sensors[""](np.asarray(made.prior.mean), *given[: made.model.sensor_inputs[""]])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", default="jacksboro")
    transforms(parser.parse_args().map)
    steps()
