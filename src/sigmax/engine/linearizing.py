"""The time of linearisations, measured in turn."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import Lifted
from sigmax.algebra.compiling import compiled
from sigmax.algebra.factor import cholesky
from sigmax.engine.backend import natively
from sigmax.engine.job import rows as job_of_rows
from sigmax.engine.job import without_numbers
from sigmax.modelling.gaussian import Gaussian
from sigmax.native import Graph, Program, Refused, Unavailable, compiler, evaluate
from sigmax.native.driver import driver, over_cores, steps
from sigmax.rules import Rule

_TRACKS = 1024
# Rounds in turn: as many as a second allows, on a busy machine the more the better.
_ROUNDS, _SECONDS = 25, 1.0
_factor = compiled(cholesky)


def seconds_of(
    rules: Sequence[Rule], function: Callable[..., Any], rest: Sequence[Any], angular: Sequence[bool], prior: Gaussian
) -> tuple[float, float]:
    """Seconds for each of two linearisations of one track, the fastest of several rounds in turn.

    On the native engine less the time of a program that reads and writes the same rows and computes nothing.
    """
    mean = np.asarray(prior.mean if prior.mean.ndim == 1 else prior.mean[0], float)
    cov = np.asarray(prior.cov if prior.cov.ndim == 2 else prior.cov[0], float)
    factor = np.asarray(_factor(cov)[0])
    rng = np.random.default_rng(0)
    x = mean + rng.standard_normal((_TRACKS, len(mean))) @ factor.T
    # A factor as a filter has it: all components correlated.
    mixing = np.tril(rng.uniform(-0.3, 0.3, (_TRACKS, *factor.shape)), -1) + np.eye(len(mean))
    S = np.diagonal(factor)[:, None] * mixing + (factor - np.diag(np.diagonal(factor)))
    runs: Sequence[tuple[Callable[[], None], Callable[[], None] | None]]
    try:
        if compiler() is None:
            raise Unavailable("there is no C compiler")
        with natively():
            runs = _native(rules, function, rest, angular, x, S)
    except (Refused, Unavailable):
        runs = [(_on_xla(rule, function, rest, angular, x, S), None) for rule in rules]

    def taken(run: Callable[[], None] | None) -> float:
        start = time.perf_counter()
        if run is not None:
            run()
        return time.perf_counter() - start

    rounds: list[list[list[float]]] = []
    begun = time.perf_counter()
    while len(rounds) < _ROUNDS or time.perf_counter() - begun < _SECONDS:
        rounds.append([[taken(run) for run in pair] for pair in runs])
    (whole, idle), (less, idle_too) = np.min(rounds, axis=0) / _TRACKS
    return float(whole - idle), float(less - idle_too)


def _native(
    rules: Sequence[Rule], function: Any, rest: Sequence[Any], angular: Sequence[bool], x: np.ndarray, S: np.ndarray
) -> list[tuple[Callable[[], None], Callable[[], None]]]:
    """Each linearisation, and a program of the same rows that computes nothing."""
    n = x.shape[1]
    lower = np.tril_indices(n)
    shared = [np.broadcast_to(np.ravel(r), (len(x), np.size(r))) for r in rest]
    rows = np.ascontiguousarray(np.concatenate([x, S[:, lower[0], lower[1]], *shared], axis=1))
    programs = [_program(rule, function, rest, angular, n, rows.shape[1]) for rule in rules]
    g = Graph()
    idle = [
        p._replace(graph=g, outputs={k: [g.constant(0.0)] * len(v) for k, v in p.outputs.items()}) for p in programs
    ]
    made = steps([(None, partial(_itself, p)) for p in (*programs, *idle)], False)

    def runner(step: Any, program: Program) -> Callable[[], None]:
        out = np.empty((len(rows), len(program.outputs["made"])))
        part = without_numbers(step)
        job = job_of_rows(part, rows, out)

        def run(kept: Any = (part, out)) -> None:
            over_cores(driver(False)["rows"], job, len(rows), False)

        return run

    each = [runner(*pair) for pair in zip(made, (*programs, *idle), strict=True)]
    return list(zip(each[: len(rules)], each[len(rules) :], strict=True))


def _itself(program: Program) -> Program:
    return program


def _program(rule: Rule, function: Any, rest: Sequence[Any], angular: Sequence[bool], n: int, size: int) -> Program:
    """The linearisation of one track as scalar operations: mean, lower factor and the other arguments in a row."""
    g = Graph()
    flat = g.inputs("given", (size,))
    factor = g.constants(np.zeros((n, n)))
    below = n + n * (n + 1) // 2
    factor[np.tril_indices(n)] = flat[n:below]
    bounds = np.cumsum([np.size(r) for r in rest])[:-1]
    others = [a.reshape(np.shape(r)) for a, r in zip(np.split(flat[below:], bounds), rest, strict=True)] if rest else []

    def line(x: Any, S: Any, *given: Any) -> Any:
        return tuple(rule(Lifted(function, [(r, r.ndim) for r in given], False), x, S, angular))

    arrays = [flat[:n], factor, *others]
    traced = jax.make_jaxpr(line)(*(jax.ShapeDtypeStruct(a.shape, jnp.float64) for a in arrays))
    made = [node for a in evaluate(g, traced, arrays) for node in a.flat]
    return Program(g, ("given",), {"made": made, "told": [g.constant(0.0)]})


def _on_xla(
    rule: Rule, function: Any, rest: Sequence[Any], angular: Sequence[bool], x: np.ndarray, S: np.ndarray
) -> Callable[[], None]:
    given = jnp.asarray(x.T), jnp.asarray(np.moveaxis(S, 0, -1))

    @jax.jit
    def line(x: Any, S: Any) -> Any:
        return tuple(rule(Lifted(function, [(r, r.ndim) for r in rest], True), x, S, angular))

    jax.block_until_ready(line(*given))

    def run() -> None:
        jax.block_until_ready(line(*given))

    return run
