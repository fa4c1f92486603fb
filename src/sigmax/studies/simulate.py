"""Truth and measurements of a block of runs."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import times
from sigmax.algebra.factor import Diagonal, Matrix, cholesky
from sigmax.engine.vectorized import vectorized
from sigmax.modelling.evaluate import motion_noise, moving, noise_root, sensing, sensor_noise
from sigmax.models import Model, SwitchingModel
from sigmax.studies.study import Study
from sigmax.studies.turns import first_mode, moving_in_turn, sensing_in_turn
from sigmax.tracing import traceable


class Drawn(NamedTuple):
    """A block of runs.

    Attributes:
        start: the true state before the first step (B, n).
        truth: (B, T, n).
        mean: where the filters start (B, n).
        z: measurements by sensor (B, T, m), NaN where there was no plot.
        kept: which runs did not escape (B,); those that did have no measurements and a truth of no meaning.
    """

    start: np.ndarray
    truth: np.ndarray
    mean: np.ndarray
    z: dict[str, np.ndarray]
    kept: np.ndarray


class Parts(NamedTuple):
    """The functions of a study that draw it, for one run.

    Attributes:
        start: (w (d,), v (d,)) -> true start, where the filters start.
        move: (x, w (d,), dt, u) -> the true state dt later; of several modes (x, mode, w, e, r, dt, u) -> that and its
            mode, see `turns`.
        sense: by sensor, (x, v (m,), u) -> the measurement; of several modes (x, mode, v, u).
        turn: of several modes (x, e, r) -> the true start and its mode.
    """

    start: Callable[..., Any]
    move: Callable[..., Any]
    sense: dict[str, Callable[..., Any]]
    turn: Callable[..., Any] | None = None


def _spread(L: Matrix, w: Any) -> Any:
    return L.entries * w if isinstance(L, Diagonal) else times(L, w)


def root_of(P: Any) -> Any:
    """The lower factor of a covariance."""
    return cholesky(P)[0]


def mover(model: Model) -> Callable[..., Any]:
    """(x, w, dt, u) -> the state dt later, disturbed by the noise of the motion."""
    root = noise_root(model.Q)

    def move(x: Any, w: Any, dt: Any, u: Any) -> Any:
        L, _ = motion_noise(model, root, x, dt, u)
        return model.space.add(moving(model, x, dt, u)(x), _spread(L, w))

    return move


def sensor_of(model: Model, sensor: str) -> Callable[..., Any]:
    """(x, v, u) -> what one sensor measures, with its noise."""

    def sense(x: Any, v: Any, u: Any) -> Any:
        L, _ = sensor_noise(model, model.R[sensor], x, u, jnp.ones(v.shape, bool))
        said = sensing(model, sensor, x, u)(x)
        return model.measured_space(sensor, said.shape[0]).add(said, _spread(L, v))

    return sense


@lru_cache(maxsize=16)
def parts(study: Study) -> Parts:
    """The functions that draw a study, the same objects at every call so that they are compiled once."""
    nature, model = study.nature or study.model, study.model
    mean, cov = np.asarray(study.prior.mean, float), np.asarray(study.prior.cov, float)
    root = vectorized(root_of, cov[None])[0][0]  # operation by operation JAX would compile for seconds
    fixed = None if study.start is None else np.asarray(study.start, float)
    estimate = study.estimate

    def start(w: Any, v: Any) -> Any:
        drawn = model.space.add(jnp.asarray(mean), times(jnp.asarray(root), w))
        x0 = drawn if fixed is None else jnp.asarray(fixed)
        if estimate == "prior":
            return x0, jnp.asarray(mean)
        if estimate == "drawn":
            return x0, model.space.add(x0, times(jnp.asarray(root), v))
        return x0, model.space.add(jnp.asarray(traceable(estimate)(x0, v)), jnp.zeros(model.dim))

    if isinstance(nature, SwitchingModel):
        senses = {s: sensing_in_turn(nature, [sensor_of(m, s) for m in nature.models]) for s in nature.sensors}
        return Parts(start, moving_in_turn(nature, list(map(mover, nature.models))), senses, first_mode(nature))
    return Parts(start, mover(nature), {sensor: sensor_of(nature, sensor) for sensor in nature.sensors})


def sizes(study: Study) -> dict[str, int]:
    """The number of components of each sensor's measurement."""
    model = study.model.models[0] if isinstance(study.model, SwitchingModel) else study.model
    x = jnp.zeros(model.size)
    u = None if study.inputs is None else jnp.asarray(np.asarray(study.inputs, float)[0])
    return {s: jax.eval_shape(lambda x, s=s: sensing(model, s, x, u)(x), x).shape[0] for s in model.sensors}


def draw(study: Study, seed: int, number: int, backend: str | None = None) -> Drawn:
    """The runs of one block: all its numbers come from the seed and the number of the block."""
    rng = np.random.default_rng([seed, number, 0])
    B, T, n, d = study.block, study.steps, study.model.size, study.model.dim
    functions = parts(study)
    start, mean = vectorized(functions.start, *rng.standard_normal((2, B, d)), backend=backend)
    dt, x = study.elapsed, start
    mode: tuple[np.ndarray, ...] = ()
    # Modes have draws of their own, so that those of others are the same as without.
    chance = np.random.default_rng([seed, number, 1])
    if functions.turn is not None:
        x, mode = _turned(vectorized(functions.turn, x, *_chances(chance, B, n), backend=backend))
    u = np.zeros((T, 0)) if study.inputs is None else np.asarray(study.inputs, float)
    truth, modes = np.empty((B, T, n)), np.zeros((B, T))
    for t, w in enumerate(rng.standard_normal((T, B, d))):
        more = _chances(chance, B, n) if mode else ()
        rest = np.full(B, dt[t]), np.broadcast_to(u[t], (B, u.shape[1]))
        x, mode = _turned(vectorized(functions.move, x, *mode, w, *more, *rest, backend=backend))
        truth[:, t] = x
        modes[:, t] = mode[0] if mode else 0
    reach = np.inf if study.reach is None else np.asarray(study.reach, float)
    with np.errstate(invalid="ignore"):
        kept = np.asarray((np.isfinite(truth) & (np.abs(truth) <= reach)).all((1, 2)))
    truth[~kept] = study.prior.mean
    z = {}
    every = np.broadcast_to(u, (B, *u.shape)).reshape(B * T, -1)
    for sensor, m in sizes(study).items():
        noise = rng.standard_normal((B * T, study.model.measured_space(sensor, m).dim))
        own = (modes.ravel(),) if mode else ()
        (value,) = vectorized(functions.sense[sensor], truth.reshape(B * T, n), *own, noise, every, backend=backend)
        seen = (rng.random((B, T)) < study.detections[sensor]) & kept[:, None]
        there = np.broadcast_to(np.asarray(study.measured.get(sensor, True), bool), (T, m))
        z[sensor] = np.where(seen[..., None] & there, value.reshape(B, T, m), np.nan)
    return Drawn(start, truth, mean, z, kept)


def _chances(rng: np.random.Generator, B: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Of what modes draw beside their noise: normal numbers (B, n) and uniform ones (B,)."""
    return rng.standard_normal((B, n)), rng.random(B)


def _turned(made: tuple[np.ndarray, ...]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """A state, and its mode where there are several."""
    return made[0], made[1:]


def cut(drawn: Drawn, first: int, end: int) -> Drawn:
    """Some runs of a block."""
    part = slice(first, end)
    start, truth, mean, kept = (a[part] for a in (drawn.start, drawn.truth, drawn.mean, drawn.kept))
    return Drawn(start, truth, mean, {sensor: z[part] for sensor, z in drawn.z.items()}, kept)
