"""Motions in continuous time: stochastic differential equations, integrated over any interval."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import diagonal
from sigmax.errors import InputError
from sigmax.modelling.arguments import names_of, not_negative, number_of
from sigmax.modelling.checks import finite, is_traced, members, numbers
from sigmax.modelling.noise import motion_of, takes
from sigmax.modelling.parts import Motion, made_once
from sigmax.tracing import traceable

Field = Callable[[jax.Array], jax.Array]


@made_once
def sde(
    drift: Callable[..., Any],
    diffusion: Any,
    *,
    state: Sequence[str] = (),
    steps: int = 1,
    tolerance: float = 1e-6,
) -> Motion:
    """The motion dx = f(x, u) dt + L(x) dw over any interval, for any rule.

    A rule sees the flow of the drift; Q is what white noise adds along it, ∫ Φ L diag(q) Lᵀ Φᵀ dt with the derivative Φ
    of the flow (Särkkä and Solin 2019, 9.1). Both are integrated together by the method of Dormand and Prince of order
    8, DOP853, with its estimate of the error. A linear equation comes out as by van Loan's exponential; of another one
    what noise bends within an interval is left out, so that long ones are to be cut where noise is large.

    Args:
        drift: `f(x)` or `f(x, u)`, dx/dt (n,), with inputs u (k,) that hold over the interval.
        diffusion: L (n, j), by numbers or as a function of x.
        state: names of the components, angles marked; else the model's.
        steps: of the method in each interval; each costs thirteen evaluations of the drift.
        tolerance: the largest estimated error of a component, as a share of the way that it goes, and of an entry of Q,
            as a share of its deviations. Beyond it the step is no number, and says so by its fault.

    Returns:
        The motion. `noise(density)` gives Q(x, dt) from the spectral densities q (j,) of the noises, 1 where left out.

    Raises:
        InputError: for steps, a tolerance or a diffusion that are none.
    """
    from scipy.integrate import DOP853  # takes as long to import as the rest of the package

    if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= 1000:
        raise InputError(f"steps must be a whole number from 1 to 1000; it is {steps!r}")
    if not 0 < number_of("tolerance", tolerance) < 1:
        raise InputError(f"tolerance is a share between 0 and 1; it is {tolerance!r}")
    drift, spread = traceable(drift), traceable(diffusion) if callable(diffusion) else _matrix(diffusion)
    driven = takes(drift, "drift", (1, 2)) == 2
    tableau = DOP853.A, DOP853.B, DOP853.E3[:12], DOP853.E5[:12]

    def along(field: Field, y: Any, dt: Any, scale: Callable[[Any, Any], Any]) -> tuple[jax.Array, jax.Array]:
        """Where y is dt later, and whether it is so within the tolerance."""

        def further(carried: Any, _: None) -> tuple[Any, None]:
            at, total, way = carried
            at, error, moved = _step(tableau, field, at, dt / steps)
            return (at, total + error, way + moved), None

        (y, error, way), _ = jax.lax.scan(further, (y, jnp.zeros_like(y), jnp.zeros_like(y)), length=steps)
        return y, (error <= tolerance * scale(y, way)).all()

    def checked(y: jax.Array, sound: jax.Array, dt: Any) -> jax.Array:
        if not is_traced(sound) and not sound:
            raise InputError(
                f"{steps} steps of the motion's equation are too few for an interval of {float(dt):g} s: its error is "
                f"beyond the tolerance of {tolerance:g}; give sde more steps="
            )
        return jnp.where(sound, y, jnp.nan)

    # Compiled for where they are called with numbers, as checks before a run do.
    @jax.jit
    def flowed(x: jax.Array, dt: jax.Array, *u: jax.Array) -> tuple[jax.Array, jax.Array]:
        return along(lambda y: jnp.asarray(drift(y, *u)), x, dt, lambda y, way: way)

    @jax.jit
    def spread_along(density: Any, x: jax.Array, dt: jax.Array, *u: jax.Array) -> tuple[jax.Array, jax.Array]:
        n = x.shape[0]

        def field(y: jax.Array) -> jax.Array:
            at, P = y[:n], y[n:].reshape(n, n)
            turned = jax.jacfwd(lambda z: jnp.asarray(drift(z, *u)))(at) @ P
            L = jnp.asarray(spread(at) if callable(spread) else spread, x.dtype)
            grown = turned + turned.T + (L * density) @ L.T
            return jnp.concatenate([jnp.asarray(drift(at, *u)), grown.ravel()])

        def scale(y: jax.Array, way: jax.Array) -> jax.Array:
            deviation = jnp.sqrt(jnp.maximum(diagonal(y[n:].reshape(n, n)), 0.0))
            return jnp.concatenate([way[:n], jnp.outer(deviation, deviation).ravel()])

        y, sound = along(field, jnp.concatenate([x, jnp.zeros(n * n, x.dtype)]), dt, scale)
        return y[n:].reshape(n, n), sound

    def flow(x: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        y, sound = flowed(x, dt, *u)
        return checked(y, sound, dt)

    def noise(density: Any = 1.0) -> Callable[..., jax.Array]:
        """Q(x, dt) from the spectral densities (j,) of the noises, or one for all."""
        density = not_negative("a density", density)

        def Q(x: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
            y, sound = spread_along(density.astype(x.dtype), x, dt, *u)
            return checked(y, sound, dt)

        return motion_of(Q, driven)

    return Motion(motion_of(flow, driven), names_of("state", state) if members(state) != [] else (), noise)


def _matrix(diffusion: Any) -> np.ndarray:
    L = np.asarray(numbers("the diffusion", diffusion), float)
    if L.ndim != 2 or 0 in L.shape:
        raise InputError(f"the diffusion is a matrix (n, j) of n components and j noises; it has the shape {L.shape}")
    finite("the diffusion", L)
    return L


def _step(tableau: tuple[Any, ...], field: Field, y: jax.Array, h: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """One step of DOP853: where it ends, the estimate of its error, and the way that each number went."""
    A, B, E3, E5 = tableau
    stages: list[jax.Array] = []
    for row in A:
        moved = _sum(row[: len(stages)], stages)
        stages.append(field(y if moved is None else y + h * moved))
    # Nothing is differentiated in the estimate, whose root has no slope at 0.
    third, fifth = (jax.lax.stop_gradient(_sum(E, stages)) for E in (E3, E5))
    # Its authors' estimate, |e5|² / √(|e5|² + |e3|² / 100); 0 where both are.
    length = jnp.sqrt(fifth**2 + 0.01 * third**2)
    error = jnp.where(length > 0, fifth**2 / jnp.where(length > 0, length, 1.0), 0.0)
    return y + h * _sum(B, stages), h * error, h * _sum(np.abs(B), [jnp.abs(k) for k in stages])


def _sum(weights: np.ndarray, stages: Sequence[jax.Array]) -> Any:
    terms = [float(w) * k for w, k in zip(weights, stages, strict=False) if w]
    return sum(terms[1:], start=terms[0]) if terms else None
