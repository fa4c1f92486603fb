"""Directions in the parameters of an envelope, each a hypothesis of what is wrong."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import Diagonal
from sigmax.examination.envelope import Envelope, Parameter
from sigmax.examination.record_data import RecordData
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, arguments_of

# The longest step of one iteration, by kind: of logarithms and ratios.
LIMITS = {"Q": 1.5, "R": 1.5, "scale": 0.3, "input gain": 0.5, "rotation": 0.5, "input rotation": 0.5, "clock": 0.3}


@dataclass(frozen=True)
class Hypothesis:
    """One direction, or several for the mean of the prior as a whole.

    Attributes:
        kind: of its parameters.
        where: what is wrong, in words.
        basis: (p, d).
    """

    kind: str
    where: str
    basis: np.ndarray


def hypotheses(family: Envelope) -> list[Hypothesis]:
    """Each parameter by itself, and those groups that are often wrong together."""
    P = family.parameters
    found = [Hypothesis(p.kind, p.where, _ones(len(P), [i])) for i, p in enumerate(P)]

    def group(kind: str, where: str, chosen: Callable[[Parameter], bool]) -> None:
        places = [i for i, p in enumerate(P) if p.kind == kind and chosen(p)]
        if len(places) > 1:
            found.append(Hypothesis(kind, where, _ones(len(P), places)))

    several = len(family.sizes) > 1
    lengths = {p.where for p in P if p.kind == "scale"}
    group("bias", "all lengths", lambda p: p.where in lengths)
    group("scale", "all lengths", lambda p: True)
    group("Q", "all components", lambda p: True)
    group("R", "all components", lambda p: True)
    if several:
        for s, _ in family.sizes:
            group("R", s, lambda p, s=s: p.sensor == s)  # type: ignore[misc]
    start = [i for i, p in enumerate(P) if p.kind == "prior"]
    if len(start) > 1:
        found.append(Hypothesis("prior", "mean", np.eye(len(P))[:, start]))
    return found


def _ones(p: int, places: Sequence[int]) -> np.ndarray:
    column = np.zeros((p, 1))
    column[list(places)] = 1
    return column


def noise_at(model: Model, record: RecordData, dt: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Q over dt and the variances of R by sensor, at the prior."""
    x, u = jnp.asarray(record.mean), jnp.asarray(record.u[0])

    def value(given: Any, allowed: tuple[int, ...]) -> np.ndarray:
        what = "Q" if allowed == OF_MOTION else "R"
        if callable(given):
            return np.asarray(given(*arguments_of(given, what, allowed, x, jnp.asarray(dt), (u,))))
        numbers = np.asarray(given.entries if isinstance(given, Diagonal) else given)
        return numbers * dt if allowed == OF_MOTION else numbers

    Q = value(model.Q, OF_MOTION)
    R = {s: value(noise, OF_SENSOR) for s, noise in model.R.items()}
    return np.diag(Q) if Q.ndim == 1 else Q, {s: v if v.ndim == 1 else np.diag(v).copy() for s, v in R.items()}


def groups_of(Q: np.ndarray) -> list[tuple[int, ...]]:
    """The components of a noise that hang together, those without noise left out."""
    left, found = [i for i in range(len(Q)) if Q[i, i] > 0], []
    while left:
        group = {left[0]}
        while grown := {j for j in left for i in group if Q[i, j] != 0} - group:
            group |= grown
        found.append(tuple(sorted(group)))
        left = [i for i in left if i not in group]
    return found


def axes_of(model: Model, record: RecordData, dt: float, driven: int) -> list[tuple[int, int]]:
    """Neighbouring inputs that are components of one vector: equal effects on the state, at right angles."""
    if not model.motion_inputs:
        return []
    angular = np.asarray(model.angular)
    before = moved(model, record, dt)
    more = [moved(model, record, dt, np.eye(record.u.shape[1])[i]) for i in range(driven)]
    effect = np.array([model.space.difference(there, before) for there in more])

    def alike(a: np.ndarray, b: np.ndarray) -> bool:
        parts = [(np.linalg.norm(a[on]), np.linalg.norm(b[on])) for on in (angular, ~angular)]
        return all(abs(x - y) <= 0.01 * max(x, y) for x, y in parts) and bool(abs(a @ b) < 0.01 * (a @ a))

    return [(i, i + 1) for i in range(driven - 1) if alike(effect[i], effect[i + 1])]


def moved(model: Model, record: RecordData, dt: float, more: Any = 0.0) -> np.ndarray:
    """The mean of the prior dt later, by the motion alone, with so much more of the first inputs."""
    own = (jnp.asarray(record.u[0] + more),) if model.motion_inputs else ()
    return np.asarray(model.motion(jnp.asarray(record.mean), jnp.asarray(dt), *own))


def natural_steps(
    family: Envelope, record: RecordData, Q: np.ndarray, R: dict[str, np.ndarray], dt: float
) -> np.ndarray:
    """What is a small change of each parameter (p,)."""
    spread = np.sqrt(np.diag(record.cov))
    size = {
        "scale": 0.01, "R": 0.1, "Q": 0.1, "rotation": 0.01, "input rotation": 0.01, "prior": 0.1, "input gain": 0.01,
        "clock": 0.001, "delay": 0.1 * dt, "skew": 0.1 * dt / max(float(record.dt.sum()), dt), "input delay": 0.1 * dt,
    }  # fmt: skip

    def step(p: Parameter) -> float:
        if p.kind == "bias" and p.sensor is not None:
            return float(np.sqrt(R[p.sensor][p.at[0]])) or 1e-6
        if p.kind == "drift":
            (i,) = p.at
            return float(0.1 * max(np.sqrt(Q[i, i]), 0.01 * spread[i], 1e-9) / dt)
        if p.kind == "input offset":
            return float(0.1 * (np.std(record.u[:, p.at[0]]) or 0.1))
        return size[p.kind]

    return np.array([step(p) for p in family.parameters])
