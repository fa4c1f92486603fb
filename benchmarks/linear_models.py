"""Random linear models, their measurements, and the same models for the library, with their matrices as inputs."""

from functools import cache
from typing import NamedTuple

import numpy as np

import sigmax

STEPS = 12


class Shape(NamedTuple):
    """Components of the state, of each sensor and of the bias; models of one shape share their compiled steps."""

    n: int
    sensors: tuple[int, ...]
    p: int

    @property
    def names(self) -> list[str]:
        """Of the sensors."""
        return [f"s{i}" for i in range(len(self.sensors))]

    @property
    def m(self) -> int:
        """Components of all sensors."""
        return sum(self.sensors)


class Models(NamedTuple):
    """Models of one shape, the models first; matrices of state and bias together, the state first.

    Attributes:
        mean, cov: the priors (B, N), (B, N, N).
        dt: (B, T).
        F, Q: of each step (B, T, N, N), Q over the step.
        H, R: (B, T, m, N), (B, T, m, m).
        z: (B, T, m), NaN where missing.
    """

    mean: np.ndarray
    cov: np.ndarray
    dt: np.ndarray
    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    z: np.ndarray


def covariances(rng, count, n, decades):
    """Covariances (*count, n, n) of largest variance 1 and of a condition to 10^decades, (*count), with their roots."""
    turn = np.linalg.qr(rng.standard_normal((*count, n, n)))[0]
    exponents = rng.uniform(0, 1, (*count, n))
    low, high = exponents.min(-1, keepdims=True), exponents.max(-1, keepdims=True)
    deviations = 10 ** (-decades[..., None] / 2 * (exponents - low) / np.where(high > low, high - low, 1))
    root = turn * deviations[..., None, :]
    P = root @ root.swapaxes(-1, -2)
    return (P + P.swapaxes(-1, -2)) / 2, root


def motion_noise(rng, count, n):
    """Covariances (B, T, n, n) and roots; a tenth of the models have none, a tenth one of fewer columns."""
    Q, root = covariances(rng, count, n, rng.uniform(0, 10, count))
    scale = 10 ** rng.uniform(-3, 0, (count[0], 1, 1, 1))
    # Whole numbers, so that what is deficient is so to the last digit.
    few = np.zeros((*count, n, n))
    few[..., : n // 2] = rng.integers(-2, 3, (*count, n, n // 2))
    kind = rng.uniform(size=(count[0], 1, 1, 1))
    root = np.where(kind < 0.1, 0, np.where(kind < 0.2, few, root))
    Q = np.where(kind < 0.1, 0, np.where(kind < 0.2, few @ few.swapaxes(-1, -2), Q))
    return Q * scale**2, root * scale


def draw(shape: Shape, count: int, rng: np.random.Generator) -> Models:
    """Models and measurements that they could have made."""
    n, p, m, T = shape.n, shape.p, shape.m, STEPS
    N, steps = n + p, (count, T)
    dt = np.where(rng.uniform(size=steps) < 0.1, 0.0, rng.exponential(size=steps))
    F = np.zeros((*steps, N, N)) + np.eye(N)
    F[..., :n, :] += dt[..., None, None] * rng.standard_normal((*steps, n, N)) / np.sqrt(N) / 2
    Q, root = np.zeros((*steps, N, N)), np.zeros((*steps, N, N))
    for at in (slice(0, n), slice(n, N)):
        if at.stop > at.start:
            Q[..., at, at], root[..., at, at] = motion_noise(rng, steps, at.stop - at.start)
    Q, root = Q * dt[..., None, None], root * np.sqrt(dt)[..., None, None]
    tilt = covariances(rng, steps, max(m, N), rng.uniform(0, 5, (count, 1)) * np.ones(steps))[1]
    H = tilt[..., :m, :N] * 10 ** rng.uniform(-1, 1, (count, 1, 1, 1))
    R = np.zeros((*steps, m, m))
    noise, at = np.zeros((*steps, m)), 0
    for size in shape.sensors:
        part = slice(at, at + size)
        R[..., part, part], own = covariances(rng, steps, size, rng.uniform(0, 10, (count, 1)) * np.ones(steps))
        noise[..., part] = (own @ rng.standard_normal((*steps, size, 1)))[..., 0]
        at += size
    # Deviations to 1e8, that is variances to 1e16.
    cov, prior = np.zeros((count, N, N)), np.zeros((count, N, N))
    for at, most in ((slice(0, n), 8), (slice(n, N), 4)):
        if at.stop > at.start:
            size = at.stop - at.start
            own = 10 ** (rng.uniform(-2, most, (count, 1)) - rng.uniform(0, 1, (count, size)))
            P, S = covariances(rng, (count,), size, rng.uniform(0, 10, count))
            cov[:, at, at], prior[:, at, at] = P * own[:, :, None] * own[:, None], S * own[:, :, None]
    mean = rng.standard_normal((count, N)) * 10 ** rng.uniform(-2, 4, (count, 1))
    x = mean + (prior @ rng.standard_normal((count, N, 1)))[..., 0]
    z = np.zeros((*steps, m))
    for k in range(T):
        x = (F[:, k] @ x[..., None] + root[:, k] @ rng.standard_normal((count, N, 1)))[..., 0]
        z[:, k] = (H[:, k] @ x[..., None])[..., 0] + noise[:, k]
    z[rng.uniform(size=z.shape) < 0.1] = np.nan
    return Models(mean, cov, dt, F, Q, H, R, z)


@cache
def functions(shape: Shape) -> tuple[dict, dict]:
    """The parts of a model and of its bias, whose matrices are inputs: F, Q, H and R by sensor, then the bias's."""
    n, p, k = shape.n, shape.p, len(shape.sensors)
    shapes = [(n, n), (n, n), *[(m, n) for m in shape.sensors], *[(m, m) for m in shape.sensors]]
    shapes += [(n, p), (p, p), *[(m, p) for m in shape.sensors]]
    bounds = np.cumsum([0, *(rows * columns for rows, columns in shapes)])

    def part(u, i):
        return u[bounds[i] : bounds[i + 1]].reshape(shapes[i])

    named = list(enumerate(shape.names))
    model = {
        "motion": lambda x, dt, u: part(u, 0) @ x,
        "Q": lambda x, dt, u: part(u, 1),
        "sensor": {s: lambda x, u, i=i: part(u, 2 + i) @ x for i, s in named},
        "R": {s: lambda x, u, i=i: part(u, 2 + k + i) for i, s in named},
        "state": [f"x{i}" for i in range(n)],
        "measurement": {s: [f"{s}_{i}" for i in range(shape.sensors[j])] for j, s in named},
    }
    bias = {
        "motion": lambda x, dt, u: part(u, 2 + 2 * k),
        "Q": lambda x, dt, u: part(u, 3 + 2 * k),
        "sensor": {s: lambda x, u, i=i: part(u, 4 + 2 * k + i) for i, s in named},
    }
    return model, bias


def by_sensor(shape: Shape, a: np.ndarray, axis: int) -> list[np.ndarray]:
    return np.split(a, np.cumsum(shape.sensors)[:-1], axis)


def run_form(form: sigmax.forms.Form, shape: Shape, models: Models) -> dict[str, tuple[np.ndarray, ...]]:
    """Means and deviations (B, T, N) of a filter of this form and of its smoother, and the faults (B, T) of each."""
    n, own, offsets = shape.n, slice(0, shape.n), slice(shape.n, None)
    parts, of_bias = functions(shape)
    bias = None
    if shape.p:
        prior = sigmax.Gaussian(models.mean[:, offsets], models.cov[:, offsets, offsets])
        bias = sigmax.Bias(prior=prior, **of_bias)
    model = sigmax.Model(**parts, bias=bias)
    H, R = by_sensor(shape, models.H, 2), by_sensor(shape, models.R, 2)
    places = by_sensor(shape, np.arange(shape.m), 0)
    blocks = [models.F[..., :n, :n], models.Q[..., :n, :n], *(h[..., :n] for h in H)]
    blocks += [r[..., at] for r, at in zip(R, places, strict=True)]
    blocks += [models.F[..., :n, n:], models.Q[..., n:, n:], *(h[..., n:] for h in H)]
    inputs = np.concatenate([b.reshape(*b.shape[:2], -1) for b in blocks], axis=-1)
    z = dict(zip(shape.names, by_sensor(shape, models.z, 2), strict=True))
    filter = sigmax.Filter(sigmax.rules.Taylor1(), sigmax.rules.Taylor1(), form)
    prior = sigmax.Gaussian(models.mean[:, own], models.cov[:, own, own])
    given = {"dt": models.dt, "inputs": inputs}
    result = sigmax.run(filter, model, prior, z, keep=("mean", "factor", "fault"), **given)
    smoothed = sigmax.smooth(filter, model, result, **given)
    told = {}
    for what, e in (("filter", result), ("smoother", smoothed)):
        mean, std = e.mean, e.std
        if shape.p:
            mean, std = np.concatenate([mean, e.bias_mean], -1), np.concatenate([std, e.bias_std], -1)
        told[what] = mean, std, e.fault
    return told
