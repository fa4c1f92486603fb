"""A prior from the first measurements, where there is none: least squares over the states that made them."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.factor import dense, pivoted, solve_lower
from sigmax.errors import InputError, unknown
from sigmax.functions.current import current_model
from sigmax.functions.functions import check_functions
from sigmax.modelling.checks import numbers
from sigmax.modelling.evaluate import motion_noise, moving, noise_root, sensing, sensor_noise
from sigmax.modelling.gaussian import Gaussian
from sigmax.modelling.model import Model
from sigmax.modelling.switching import check_one_mode
from sigmax.preparation.measurements import measurements_of, steps_of
from sigmax.preparation.prepare import cast, laid_out_steps
from sigmax.steps.updating import there

# Below this part of the largest singular value a direction is not determined: a variance 10¹² times that of another.
_RANK = 1e-6
# Measurements that fit worse come in one of a million, or from the wrong valley of the sum of squares.
_FIT = 1e-6


class PoorFit(UserWarning):
    """The first measurements lie farther from any state that was found than one time in a million."""


class Undetermined(InputError):
    """The first measurements leave components of the state open.

    Attributes:
        names: of these components.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(map(str, names))
        super().__init__(
            f"these measurements do not determine {', '.join(self.names)}: give more of them, or say in within= "
            f"how far they may be from at=, such as within={{{self.names[0]!r}: 1.0}}"
        )


def start(
    model: Model,
    z: Any,
    *,
    dt: Any = 1.0,
    at: Any = None,
    within: Mapping[str, float] | None = None,
    inputs: Any = None,
) -> Gaussian:
    """The state at the last of some first measurements, from them alone: an ordinary prior for any filter.

    Least squares over the state at the first measurement and the noise of the motion between them, by a guarded
    Gauss–Newton method; the covariance is that of its solution, with the noise of the motion in it. A filter goes on
    with the measurement after these, dt later. Compiles for some seconds, then takes milliseconds a track.

    Args:
        model: the model; one with a bias goes through `sigmax.models.augment` first.
        z: the first measurements (k, m), or (B, k, m) for B tracks; by sensor where there are several; NaN is missing.
        dt: as in `run`, of these measurements; the first is not read.
        at: a state (n,) or (B, n) near that of the first measurement, where the search begins; zeros without it, which
            will do where all is linear.
        within: standard deviations about `at` of components that the measurements need not determine, by name.
        inputs: as in `run`, of these measurements.

    Raises:
        InputError: where the measurements do not determine the state, naming what they leave open; and where the search
            ends nowhere, or a function of the model is not finite where it begins.
    """
    model = cast(current_model(model), np.float64)
    check_one_mode(model, "start")
    if model.constraints:
        raise InputError("start does not know constraints: find the start of the model without them")
    if model.bias is not None:
        raise InputError("start finds a state; write the bias into it: model = sigmax.models.augment(model)")
    measured = {s: np.asarray(v, float) for s, v in measurements_of(model, z).items()}
    T = steps_of(measured)
    elapsed, u = laid_out_steps(model, dt, inputs, T, np.float64)
    known = _known(model, within)
    if at is None and not model.space.flat:
        raise InputError(f"give at=, a state near that of the first measurement: {model} has parts that turn or point")
    guess = np.zeros(model.size) if at is None else np.asarray(numbers("at", at), float)
    if guess.shape[-1:] != (model.size,) or guess.ndim > 2:
        raise InputError(f"at must be a state {list(map(str, model.state))}; its shape is {guess.shape}")
    batches = [*((v, 3) for v in measured.values()), (elapsed, 2), (u, 3), (guess, 2)]
    tracks = {len(a) for a, core in batches if a is not None and a.ndim == core}
    if len(tracks) > 1:
        raise InputError(f"the batches of z, dt, inputs and at differ in size: {sorted(tracks)}")
    nearest = np.moveaxis(np.asarray(model.space.nearest(np.moveaxis(guess, -1, 0))), 0, -1)
    sizes = {s: v.shape[-1] for s, v in measured.items()}
    check_functions(model, Gaussian(nearest, np.eye(model.dim)), elapsed, u, sizes, np.float64)
    batch = next(iter(tracks), None)
    found = [
        _one(model, {s: _track(v, 3, b) for s, v in measured.items()}, _track(elapsed, 2, b), _track(u, 3, b), x, known)
        for b, x in enumerate(np.broadcast_to(nearest, (1 if batch is None else batch, model.size)))
    ]
    means, covs = (np.stack(parts) for parts in zip(*found, strict=True))
    return Gaussian(means[0], covs[0]) if batch is None else Gaussian(means, covs)


def _track(a: Any, core: int, track: int) -> Any:
    return a if a is None or a.ndim < core else a[track]


def _known(model: Model, within: Mapping[str, float] | None) -> np.ndarray:
    """1 / σ of each deviation, 0 where nothing is known."""
    weights = np.zeros(model.dim)
    names = list(map(str, model.deviations))
    for name, deviation in (within or {}).items():
        if name not in names:
            raise InputError(str(unknown("component", name, names)))
        if not (isinstance(deviation, int | float | np.number) and 0 < float(deviation) < np.inf):
            raise InputError(f"within: the standard deviation of {name} must be a number above 0; it is {deviation!r}")
        weights[names.index(name)] = 1 / float(deviation)
    return weights


def _one(model: Model, z: dict[str, Any], dt: Any, u: Any, at: np.ndarray, known: np.ndarray) -> tuple[Any, Any]:
    """Mean and covariance of one track."""
    from scipy.optimize import least_squares  # as long to import as all of this package
    from scipy.special import chdtrc

    d, T = model.dim, len(dt)
    leaves, structure = jax.tree.flatten(model)
    residuals, slopes, last = _functions(structure, tuple(z), T)
    given = leaves, z, dt, u, at, known
    y = np.zeros(T * d)
    if not np.isfinite(residuals(y, *given)).all():
        raise InputError(
            f"the model is not finite at the state {at.tolist()}; give at=, a state where the search begins"
        )

    def away(y: np.ndarray) -> np.ndarray:
        return np.asarray(residuals(y, *given))

    def along(y: np.ndarray) -> np.ndarray:
        return np.asarray(slopes(y, *given))

    fit = least_squares(away, y, along, method="trf", xtol=1e-12)
    if not (fit.success and np.isfinite(fit.x).all()):
        raise InputError(
            f"least squares did not converge ({fit.message}); give at=, a state nearer to that of the first measurement"
        )
    J = along(fit.x)
    _check_rank(model, J, d)
    count = int(sum(np.isfinite(v).sum() for v in z.values()) + (known > 0).sum())
    if count > d and chdtrc(count - d, 2 * fit.cost) < _FIT:
        warnings.warn(
            f"the first {T} measurements fit badly: a sum of squares of {2 * fit.cost:.3g} where {count - d} is "
            "expected; another at= may lie nearer, or one of them is an outlier",
            PoorFit,
            stacklevel=4,
        )
    mean, factor = last(fit.x, *given, np.linalg.qr(J, mode="r"))
    factor = np.asarray(factor)
    return np.asarray(mean), factor @ factor.T


def _check_rank(model: Model, J: np.ndarray, d: int) -> None:
    """Refuse measurements that leave a direction of the first state open."""
    noise, _ = np.linalg.qr(J[:, d:])
    # What the noise of the motion could have made as well tells nothing.
    left = J[:, :d] - noise @ (noise.T @ J[:, :d])
    scale = np.linalg.norm(left, axis=0)
    size = np.linalg.norm(J[:, :d], axis=0)
    unseen = ~(scale > _RANK * np.maximum(size, np.finfo(float).tiny))
    _, singular, rows = np.linalg.svd(np.where(unseen, 0, left / np.where(unseen, 1, scale)))
    singular = np.concatenate([singular, np.zeros(d - len(singular))])
    open_ = rows[singular <= _RANK * singular.max(initial=0)]
    if len(open_):
        raise Undetermined([n for n, share in zip(model.deviations, (open_**2).sum(0), strict=True) if share > 0.05])


@lru_cache(maxsize=32)
def _functions(structure: Any, sensors: tuple[str, ...], T: int) -> tuple[Callable[..., Any], ...]:
    """Residuals in standard deviations and their slopes, and the last state with its factor; compiled once."""

    def states(y: Any, leaves: Any, dt: Any, u: Any, at: Any) -> tuple[Model, Any]:
        model = jax.tree.unflatten(structure, leaves)
        parts = y.reshape(T, model.dim)
        root, first = noise_root(model.Q), model.space.add(at, parts[0])

        def step(x: Any, given: Any) -> tuple[Any, Any]:
            part, elapsed, driven = given
            L, _ = motion_noise(model, root, x, elapsed, driven)
            x = model.space.add(moving(model, x, elapsed, driven)(x), dense(L) @ part)
            return x, x

        _, later = jax.lax.scan(step, first, jax.tree.map(lambda a: a[1:], (parts, dt, u)))
        return model, jnp.concatenate([first[None], later])

    def residuals(y: Any, leaves: Any, z: Any, dt: Any, u: Any, at: Any, known: Any) -> Any:
        model, found = states(y, leaves, dt, u, at)

        def off(x: Any, measured: Any, driven: Any, s: str) -> Any:
            space = model.measured_space(s, measured.shape[0])
            numbers_seen, seen = there(space, measured)
            expected = sensing(model, s, x, driven)(x)
            away = space.difference(jnp.where(numbers_seen, measured, expected), expected)
            L, _ = sensor_noise(model, model.R[s], x, driven, seen)
            return solve_lower(pivoted(dense(L)), jnp.where(seen, away, 0.0))

        misses = [jax.vmap(partial(off, s=s))(found, z[s], u).ravel() for s in sensors]
        return jnp.concatenate([y[model.dim :], known * y[: model.dim], *misses])

    def last(y: Any, leaves: Any, z: Any, dt: Any, u: Any, at: Any, known: Any, R: Any) -> tuple[Any, Any]:
        """The last state, and the factor of its deviations: their slope in y times the root of the covariance of y."""

        def end(y: Any) -> Any:
            return states(y, leaves, dt, u, at)[1][-1]

        model, found = states(y, leaves, dt, u, at)
        x = found[-1]
        slope = jax.jacfwd(lambda y: model.space.difference(end(y), jax.lax.stop_gradient(x)))(y)
        return x, jax.scipy.linalg.solve_triangular(R, slope.T, trans=1).T

    return jax.jit(residuals), jax.jit(jax.jacfwd(residuals)), jax.jit(last)
