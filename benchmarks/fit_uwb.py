"""Fits of two published records of ultra-wideband ranges: what their noises, offsets and wheels are.

python benchmarks/fit_uwb.py [FOLDER]

The folder is that of `benchmarks/uwb.py`.
"""

import sys
import time
from pathlib import Path
from typing import Any

import jax.numpy as jnp

import sigmax
import sigmax.fitting
from uwb import DATA, Run, hanyang, labyrinth


def of_labyrinth(run: Run) -> sigmax.fitting.Fit:
    """The distance of the wheels, the offset of the ranges, and all noises."""
    drive, heard = sigmax.motions.unicycle(), sigmax.sensors.range_only()

    def build(p: Any) -> Any:
        def moved(x: Any, dt: Any, u: Any) -> Any:
            return drive.function(x, dt, jnp.stack([u[0], u[1] * 0.157 / p["wheels"]]))

        model = sigmax.Model(
            motion=moved,
            state=drive.state,
            sensor=lambda x, u: heard.function(x, u[2:]) + p["offset"],
            measurement=("range",),
            Q=drive.noise(position=p["position"], heading=p["heading"]),
            R=[p["range"] ** 2],
        )
        return model, run.prior

    start = {"wheels": 0.157, "offset": 0.0, "position": 0.02, "heading": 0.05, "range": 0.1}
    return sigmax.fit(
        "EKF", build, start, run.z, dt=run.dt, inputs=run.inputs, hold_out=0.3,
        positive=("wheels", "position", "heading", "range"),
    )  # fmt: skip


def of_hanyang(run: Run) -> sigmax.fitting.Fit:
    """The density of the acceleration, the deviation of all ranges, and what each anchor adds to its own."""
    given = run.models["no bias"]

    def build(p: Any) -> Any:
        def seen(name: str) -> Any:
            return lambda x: given.sensors[name](x) + p[name]

        model = sigmax.Model(
            motion=given.motion,
            state=given.state,
            sensor={name: seen(name) for name in given.sensors},
            Q=sigmax.motions.constant_velocity().noise(p["density"]),
            R={name: jnp.reshape(p["range"] ** 2, (1,)) for name in given.sensors},
        )
        return model, run.prior

    start = {"density": 0.1, "range": 0.03, **dict.fromkeys(given.sensors, 0.0)}
    return sigmax.fit("EKF", build, start, run.z, dt=run.dt, hold_out=0.3, positive=("density", "range"))


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    for name, load, fit in (("labyrinth", labyrinth, of_labyrinth), ("hanyang", hanyang, of_hanyang)):
        run, begun = load(folder / f"{name}_uwb"), time.perf_counter()
        found = fit(run)
        print(f"{name}, {len(run.dt):,} rows, {time.perf_counter() - begun:.1f} s\n{found}\n")


if __name__ == "__main__":
    main()
