"""Fits of a radar's noises by the likelihood of an EKF, beside the gradient of dynamax's on the same problem.

python benchmarks/fit.py --write benchmarks/README.md

dynamax's marginal log-likelihood is differentiated by JAX and climbed by SciPy's L-BFGS, its best tool for so few
numbers; ours is `sigmax.fit` with its standard errors. Both start at the same place and end at the same likelihood. A
contender has a process of its own; what it imports is not counted.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

BEGIN, END = "<!-- fit: written by fit.py -->", "<!-- end of fit -->"
START = {"azimuth": 0.004, "q": 0.1, "range": 10.0, "scale": 1.0}
TRUE = {"azimuth": 0.002, "q": 0.5, "range": 30.0, "scale": 1.01}
# Steps and parameters of each row, and whether dynamax has to do it.
SIZES = ((200, 2, True), (2000, 2, True), (60_000, 4, False))


def names(count: int) -> list[str]:
    return ["q", "range"] if count == 2 else sorted(START)


def record(T: int) -> np.ndarray:
    """Ranges and azimuths (T, 2) of an aircraft that never comes near the radar, azimuths without turns."""
    rng, x, z = np.random.default_rng(4), np.array([-20e3, 5e3, 0.0, 0.0]), []
    Q = TRUE["q"] * np.kron([[1 / 3, 1 / 2], [1 / 2, 1]], np.eye(2))
    L = np.linalg.cholesky(Q)
    for _ in range(T):
        pull = 1e-4 * (np.array([-20e3, 5e3]) - x[:2]) - 0.02 * x[2:]
        x = np.concatenate([x[:2] + x[2:] + pull / 2, x[2:] + pull]) + L @ rng.normal(size=4)
        far, azimuth = np.hypot(*x[:2]), np.arctan2(x[1], x[0])
        z.append([TRUE["scale"] * far + TRUE["range"] * rng.normal(), azimuth + TRUE["azimuth"] * rng.normal()])
    return np.array(z)


def moved(x: Any, array: Any) -> Any:
    pull = 1e-4 * (array.array([-20e3, 5e3]) - x[:2]) - 0.02 * x[2:]
    return array.concatenate([x[:2] + x[2:] + pull / 2, x[2:] + pull])


def seen(x: Any, scale: Any, array: Any) -> Any:
    return array.stack([scale * array.hypot(x[0], x[1]), array.arctan2(x[1], x[0])])


MEAN, COV = np.array([-20e3, 5e3, 0.0, 0.0]), np.array([1e4, 1e4, 100.0, 100.0])


def ours(z: np.ndarray, count: int) -> Callable[[], Any]:
    import jax.numpy as jnp

    import sigmax

    freed = names(count)

    def build(p: Any) -> Any:
        known = {**{k: v for k, v in TRUE.items() if k not in freed}, **p}
        Q = jnp.kron(jnp.array([[1 / 3, 1 / 2], [1 / 2, 1]]), jnp.eye(2)) * known["q"]
        model = sigmax.Model(
            motion=lambda x, dt: moved(x, jnp),
            sensor=lambda x: seen(x, known["scale"], jnp),
            Q=lambda dt: Q,
            R=jnp.stack([known["range"] ** 2 * jnp.ones(()), known["azimuth"] ** 2 * jnp.ones(())]),
            state=("x", "y", "vx", "vy"),
        )
        return model, sigmax.Gaussian(MEAN, COV)

    start = {name: START[name] for name in freed}

    def go() -> Any:
        found = sigmax.fit("EKF", build, start, z, update_first=True, positive=freed)
        return found.log_likelihood, {k: float(v) for k, v in found.parameters.items()}, found.evaluations

    return go


def theirs(z: np.ndarray, count: int) -> Callable[[], Any]:
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter
    from scipy.optimize import minimize

    jax.config.update("jax_enable_x64", True)
    freed, emissions = names(count), jnp.asarray(z)

    def negative(y: Any) -> Any:
        known = {**{k: v for k, v in TRUE.items() if k not in freed}, **dict(zip(freed, jnp.exp(y), strict=True))}
        params = ParamsNLGSSM(
            initial_mean=jnp.asarray(MEAN),
            initial_covariance=jnp.diag(jnp.asarray(COV)),
            dynamics_function=lambda x: moved(x, jnp),
            dynamics_covariance=known["q"] * jnp.kron(jnp.array([[1 / 3, 1 / 2], [1 / 2, 1]]), jnp.eye(2)),
            emission_function=lambda x: seen(x, known["scale"], jnp),
            emission_covariance=jnp.diag(jnp.stack([known["range"] ** 2, known["azimuth"] ** 2 * 1.0])),
        )
        return -extended_kalman_filter(params, emissions).marginal_loglik

    slope = jax.jit(jax.value_and_grad(negative))

    def go() -> Any:
        found = minimize(
            lambda y: tuple(np.asarray(v, float) for v in slope(jnp.asarray(y))),
            np.log([START[name] for name in freed]), jac=True, method="L-BFGS-B",
        )  # fmt: skip
        return -float(found.fun), dict(zip(freed, map(float, np.exp(found.x)), strict=True)), int(found.nfev)

    return go


def worker(who: str, T: int, count: int) -> None:
    """One contender: the first fit of a process and another one, by the clock and by all processors."""
    go = {"sigmax": ours, "dynamax": theirs}[who](record(T), count)
    rows = []
    for _ in range(3):
        start = time.perf_counter(), sum(os.times()[:4])
        likelihood, found, evaluations = go()
        rows.append([time.perf_counter() - start[0], sum(os.times()[:4]) - start[1]])
    again = min(rows[1:])
    print(json.dumps({"first": rows[0], "again": again, "L": likelihood, "found": found, "n": evaluations}))


def asked(who: str, T: int, count: int, cache: str) -> dict[str, Any]:
    command = [sys.executable, __file__, "--worker", f"{who},{T},{count}"]
    done = subprocess.run(command, env={**os.environ, "SIGMAX_CACHE": cache}, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def main(
    page: Annotated[Path | None, typer.Option("--write", help="Put the table between the markers of a page.")] = None,
    inside: Annotated[str, typer.Option("--worker", hidden=True)] = "",
) -> None:
    """Time the fits; takes a minute or two."""
    if inside:
        who, T, count = inside.split(",")
        worker(who, int(T), int(count))
        return
    from rich.console import Console

    from machine import description
    from report import Section, markdown, show, write

    console, load_average, rows = Console(), os.getloadavg()[0], []
    for T, count, both in SIZES:
        with tempfile.TemporaryDirectory(prefix="fit-") as cache:
            found = [("sigmax.fit", asked("sigmax", T, count, cache))]
            found.append(("sigmax.fit, the next process", asked("sigmax", T, count, cache)))
        if both:
            found.append(("dynamax's gradient, L-BFGS", asked("dynamax", T, count, "")))
        for who, a in found:
            took = [f"{v:.2f}" for pair in (a["first"], a["again"]) for v in pair]
            rows.append((who, f"{T:,}", str(count), *took, f"{a['L']:,.2f}", str(a["n"])))
    columns = (
        "fit",
        "steps",
        "parameters",
        "first, s",
        "of processors, s",
        "again, s",
        "of processors, s ",
        "log-likelihood",
    )
    machine = "; ".join(f"{what}: {value}" for what, value in description(load_average)[:2])
    note = (
        "The first fit of a process and another one, by the clock and in time of all processors, compilers included. "
        f"Ours has standard errors, correlations and the likelihood along each number besides. {machine}."
    )
    section = Section("Fits", note, (*columns, "runs of the filter"), rows)
    show(section, console)
    if page is not None:
        text = [f"Made by `python benchmarks/fit.py --write {page}`.", "", markdown(section)]
        write(page, "\n".join(text), BEGIN, END)
        console.print(f"written to {page}")


if __name__ == "__main__":
    typer.run(main)
