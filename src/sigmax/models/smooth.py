"""Functions that stay finite, in value and derivatives, where the textbook formula divides by zero."""

import jax
import jax.numpy as jnp

# Below this argument five terms of the series are exact to rounding, with two derivatives.
_SMALL = 0.1


def sinc(a: jax.Array) -> jax.Array:
    """sin(a) / a."""
    small = jnp.abs(a) < _SMALL
    safe = jnp.where(small, 1.0, a)
    b = jnp.where(small, a, 0.0) ** 2
    series = 1 - b / 6 * (1 - b / 20 * (1 - b / 42 * (1 - b / 72 * (1 - b / 110))))
    return jnp.where(small, series, jnp.sin(safe) / safe)


def cosc(a: jax.Array) -> jax.Array:
    """(1 − cos a) / a."""
    half = a / 2
    return half * sinc(half) ** 2


def decay(a: jax.Array) -> jax.Array:
    """(1 − exp(−a)) / a."""
    small = jnp.abs(a) < _SMALL
    safe = jnp.where(small, 1.0, a)
    b = jnp.where(small, a, 0.0)
    series = 1 - b / 2 * (1 - b / 3 * (1 - b / 4 * (1 - b / 5 * (1 - b / 6 * (1 - b / 7 * (1 - b / 8 * (1 - b / 9)))))))
    return jnp.where(small, series, -jnp.expm1(-safe) / safe)


def decay2(a: jax.Array) -> jax.Array:
    """(exp(−a) − 1 + a) / a²."""
    small = jnp.abs(a) < _SMALL
    safe = jnp.where(small, 1.0, a)
    b = jnp.where(small, a, 0.0)
    series = 0.5 * (
        1 - b / 3 * (1 - b / 4 * (1 - b / 5 * (1 - b / 6 * (1 - b / 7 * (1 - b / 8 * (1 - b / 9 * (1 - b / 10)))))))
    )
    return jnp.where(small, series, (jnp.expm1(-safe) + safe) / safe**2)


def length(*components: jax.Array) -> jax.Array:
    """√(Σ c²), with derivative 0 at the origin."""
    squared = sum((c * c for c in components[1:]), start=components[0] * components[0])
    away = squared > 0
    return jnp.where(away, jnp.sqrt(jnp.where(away, squared, 1.0)), 0.0)


def direction(along: jax.Array, across: jax.Array) -> jax.Array:
    """Angle from the first axis towards the second, in [-π, π]; 0 with derivative 0 at the origin."""
    away = (along != 0) | (across != 0)
    return jnp.where(away, jnp.arctan2(jnp.where(away, across, 0.0), jnp.where(away, along, 1.0)), 0.0)
