"""A model's functions and noises as the engine wants them: over columns of points and a batch."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import Lifted, spread
from sigmax.algebra.factor import Diagonal, Matrix, cholesky, safe_sqrt
from sigmax.errors import InputError
from sigmax.modelling.inside import with_columns
from sigmax.modelling.model import Model
from sigmax.modelling.noise import OF_MOTION, OF_SENSOR, Noise, takes
from sigmax.rules.charted import linearized
from sigmax.rules.linearization import Linearization, Rule

Noisy = tuple[Matrix, jax.Array]


def linearized_motion(
    rule: Rule, model: Model, x: jax.Array, S: jax.Array, dt: jax.Array, u: jax.Array | None
) -> Linearization:
    """The motion by a rule about x ⊞ N(0, S Sᵀ)."""
    return linearized(rule, moving(model, x, dt, u), x, S, model.space, model.space)


def disturbed_motion(
    rule: Rule,
    model: Model,
    root: Matrix | None,
    x: jax.Array,
    S: jax.Array,
    dt: jax.Array,
    u: jax.Array | None,
    stretch: jax.Array | None = None,
) -> tuple[Linearization, Matrix, jax.Array]:
    """The motion by a rule, the factor of the noise that is added to it, and whether this is one.

    A noise inside it is among the columns of what the line misses, and nothing is added. The rows of the factor are
    multiplied by `stretch` (n, ...) where there is one.
    """
    found = model.noise_inside(None)
    if found is None:
        line = linearized_motion(rule, model, x, S, dt, u)
        L, sound = motion_noise(model, root, x, dt, u)
        if stretch is not None:
            L = Diagonal(L.entries * stretch) if isinstance(L, Diagonal) else L * stretch[:, None]
        return line, L, sound
    joint, q = found
    whole = moving(model, x, dt, u).instead(joint)
    line, columns = with_columns(rule, whole, q, x, S, model.space.periodic)
    line = line._replace(residual=jnp.concatenate([line.residual, columns], 1))
    return line, Diagonal(jnp.zeros_like(x)), jnp.ones(x.shape[1:], bool)


def heard_sensor(
    rule: Rule, model: Model, sensor: str, x: jax.Array, S: jax.Array, u: jax.Array | None, size: int
) -> tuple[Linearization, jax.Array]:
    """A sensor by a rule, and the columns of a noise inside it; none of a noise that is added."""
    found = model.noise_inside(sensor)
    if found is None:
        line = linearized_sensor(rule, model, sensor, x, S, u, size)
        return line, line.slope[:, :0]
    joint, q = found
    whole = sensing(model, sensor, x, u).instead(joint)
    return with_columns(rule, whole, q, x, S, model.measured_space(sensor, size).periodic)


def moving(model: Model, x: jax.Array, dt: jax.Array, u: jax.Array | None) -> Lifted:
    """The motion over dt () or (B,), with inputs (k,) or (k, B), of states with a batch where x has one."""
    _check_augmented(model)
    arguments = [(dt, 0)] + ([(u, 1)] if model.motion_inputs and u is not None else [])
    return Lifted(model.motion, arguments, x.ndim > 1)


def linearized_sensor(
    rule: Rule, model: Model, sensor: str, x: jax.Array, S: jax.Array, u: jax.Array | None, size: int
) -> Linearization:
    """A sensor that gives `size` numbers by a rule about x ⊞ N(0, S Sᵀ)."""
    return linearized(rule, sensing(model, sensor, x, u), x, S, model.space, model.measured_space(sensor, size))


def sensing(model: Model, sensor: str, x: jax.Array, u: jax.Array | None) -> Lifted:
    """A sensor with inputs (k,) or (k, B), of states with a batch where x has one."""
    _check_augmented(model)
    arguments = [(u, 1)] if model.sensor_inputs[sensor] and u is not None else []
    return Lifted(model.sensors[sensor], arguments, x.ndim > 1)


def _check_augmented(model: Model) -> None:
    """Refuse a model that still has a bias, which its functions alone would leave out.

    Raises:
        InputError: where it has.
    """
    if model.bias is not None:
        raise InputError(f"write the bias {list(model.bias.names)} into the state first: sigmax.models.augment(model)")


def in_domain(model: Model, batched: bool) -> Lifted | None:
    """The model's domain, None without one."""
    return None if model.domain is None else Lifted(model.domain, [], batched)


def noise_root(Q: Noise) -> Matrix | None:
    """The factor of a noise that is given as numbers, None for a function."""
    if callable(Q):
        return None
    if isinstance(Q, Diagonal):
        return Diagonal(safe_sqrt(Q.entries)[0])
    return cholesky(jnp.asarray(Q))[0]


def motion_noise(model: Model, root: Matrix | None, x: jax.Array, dt: jax.Array, u: jax.Array | None) -> Noisy:
    """Factor of the covariance of the noise over dt, and whether it is one; `root` is `noise_root(model.Q)`."""
    batch = x.shape[1:]
    if root is None:
        return _factored(*_evaluated(model.Q, x, (dt, 0), u), batch)
    elapsed = safe_sqrt(dt)[0]
    if isinstance(root, Diagonal):
        entries = spread(root.entries, 1, batch) * elapsed
        return Diagonal(entries), jnp.isfinite(elapsed) & jnp.ones(batch, bool)
    return spread(root, 2, batch) * elapsed, jnp.isfinite(elapsed) & jnp.ones(batch, bool)


def sensor_noise(model: Model, R: Noise, x: jax.Array, u: jax.Array | None, seen: jax.Array) -> Noisy:
    """Factor of a sensor's noise; components that were not `seen` (m, ...) get a noise of their own, 1."""
    batch = x.shape[1:]
    if callable(R):
        value, batched = _evaluated(R, x, None, u)
    else:
        value, batched = (R.entries if isinstance(R, Diagonal) else jnp.asarray(R)), 0
    if value.ndim - batched == 1:
        value = jnp.where(seen, spread(value, 1, batch), 1)
    else:
        alone = spread(jnp.eye(seen.shape[0], dtype=value.dtype), 2, batch)
        value = jnp.where(seen[:, None] & seen[None], spread(value, 2, batch), alone)
    return _factored(value, len(batch), batch)


def _factored(value: jax.Array, batched: int, batch: tuple[int, ...]) -> Noisy:
    """Factor of an evaluated noise, variances (n, ...) or a covariance (n, n, ...)."""
    if value.ndim - batched == 1:
        entries = spread(value, 1, batch)
        return Diagonal(safe_sqrt(entries)[0]), (entries >= 0).all(0)
    factor, sound = cholesky(value)
    return spread(factor, 2, batch), jnp.broadcast_to(sound, batch)


def _evaluated(
    function: Callable[..., Any], x: jax.Array, dt: tuple[jax.Array, int] | None, u: jax.Array | None
) -> tuple[jax.Array, int]:
    """The value of a noise function with the arguments it takes, and the number of its batch axes.

    What depends on the step alone is computed once for the whole batch.
    """
    if dt is None:
        given = [(x, 1), (u, 1)]
        count = takes(function, "R", OF_SENSOR)
    else:
        count = takes(function, "Q", OF_MOTION)
        given = [dt] if count == 1 else [(x, 1), dt, (u, 1)]
    used = [(value, core) for value, core in given[:count] if value is not None]
    axes = [-1 if value.ndim > core else None for value, core in used]
    values = [value for value, _ in used]

    def single(*arguments: jax.Array) -> jax.Array:
        return jnp.asarray(function(*arguments)).astype(x.dtype)

    if all(axis is None for axis in axes):
        return single(*values), 0
    return jax.vmap(single, in_axes=axes, out_axes=-1)(*values), 1
