"""Ready-made motions: a function, the names of its state, and its noise from physical quantities."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.modelling.arguments import names_of, place_of, positive
from sigmax.modelling.checks import numbers
from sigmax.modelling.components import angle
from sigmax.modelling.noise import motion_of, of_each, on_diagonal, squares
from sigmax.modelling.parts import Motion, made_once
from sigmax.models.join import join
from sigmax.models.quadratic import quadratic_function
from sigmax.models.smooth import cosc, decay, decay2, sinc

__all__ = [
    "constant_acceleration",
    "constant_velocity",
    "coordinated_turn",
    "coordinated_turn_cartesian",
    "join",
    "mirrored_speed",
    "quadratic",
    "random_walk",
    "singer",
    "unicycle",
]

# Of a position and its derivatives.
_LEVELS = ("m", "m/s", "m/s²")


@made_once
def random_walk(names: Sequence[str] = ("x",)) -> Motion:
    """Components that stay as they are but for noise: constants, slow biases, scale factors."""
    state = names_of("names", names)

    def function(x: jax.Array, dt: jax.Array) -> jax.Array:
        return x

    def noise(*deviation: float) -> np.ndarray:
        """Variances per second from standard deviations per √s, one a component or one for all."""
        return of_each("a deviation", deviation, len(state)) ** 2

    return Motion(function, state, noise)


@made_once
def constant_velocity(axes: Sequence[str] = ("x", "y")) -> Motion:
    """Positions, then velocities, driven by white acceleration of a density in m²/s³ (Bar-Shalom, 6.2.2)."""
    return _integrators(axes, ("", "v"))


@made_once
def constant_acceleration(axes: Sequence[str] = ("x", "y")) -> Motion:
    """Positions, velocities, accelerations, driven by white jerk of a density in m²/s⁵ (Bar-Shalom, 6.2.3)."""
    return _integrators(axes, ("", "v", "a"))


def _integrators(axes: Sequence[str], prefixes: Sequence[str]) -> Motion:
    axes = names_of("axes", axes)
    k, order = len(axes), len(prefixes)

    def function(x: jax.Array, dt: jax.Array) -> jax.Array:
        levels = [x[i * k : (i + 1) * k] for i in range(order)]
        moved = []
        for i in range(order):
            higher = [levels[j] * (dt ** (j - i) / math.factorial(j - i)) for j in range(i + 1, order)]
            moved.append(sum(higher, start=levels[i]))
        return jnp.concatenate(moved)

    def noise(density: float | Sequence[float]) -> Callable[[jax.Array], jax.Array]:
        """Q(dt) from the density of the white noise that drives the highest derivative."""
        by_axis = on_diagonal(density, k)

        def Q(dt: jax.Array) -> jax.Array:
            powers = [[_power(dt, order, i, j) for j in range(order)] for i in range(order)]
            return jnp.block([[p * by_axis for p in row] for row in powers])

        return Q

    names = tuple(prefix + axis for prefix in prefixes for axis in axes)
    return Motion(function, names, noise, units=tuple(unit for unit in _LEVELS[:order] for _ in axes))


def _power(dt: jax.Array, order: int, i: int, j: int) -> jax.Array:
    exponent = 2 * order - 1 - i - j
    return dt**exponent / (math.factorial(order - 1 - i) * math.factorial(order - 1 - j) * exponent)


@made_once
def singer(axes: Sequence[str] = ("x", "y"), tau: float = 10.0) -> Motion:
    """Positions, velocities and accelerations that fade with the time constant tau (Singer 1970)."""
    axes, tau = names_of("axes", axes), positive("tau", tau)
    k = len(axes)

    def function(x: jax.Array, dt: jax.Array) -> jax.Array:
        p, v, a = x[:k], x[k : 2 * k], x[2 * k :]
        b = dt / tau
        return jnp.concatenate([p + v * dt + a * decay2(b) * dt**2, v + a * decay(b) * dt, a * jnp.exp(-b)])

    nodes, weights = np.polynomial.legendre.leggauss(16)

    def noise(acceleration: float | Sequence[float]) -> Callable[[jax.Array], jax.Array]:
        """Q(dt) from the standard deviation of the acceleration, m/s², one an axis or one for all.

        The integral over the interval by 16 Gauss points, exact to rounding for dt up to 10 tau;
        the printed closed form loses all digits for small dt / tau.
        """
        by_axis = on_diagonal(squares(acceleration), k) * (2 / tau)

        def Q(dt: jax.Array) -> jax.Array:
            s = dt * (nodes + 1) / 2
            response = jnp.stack([decay2(s / tau) * s**2, decay(s / tau) * s, jnp.exp(-s / tau)])
            return jnp.kron((response * (weights * dt / 2)) @ response.T, by_axis)

        return Q

    names = tuple(prefix + axis for prefix in ("", "v", "a") for axis in axes)
    return Motion(function, names, noise, units=tuple(unit for unit in _LEVELS for _ in axes))


@made_once
def coordinated_turn() -> Motion:
    """Coordinated turn by speed, course (clockwise from north) and turn rate (Sobolev, (88)).

    Written without a division, so that turn rate 0 is an ordinary point.
    """

    def function(x: jax.Array, dt: jax.Array) -> jax.Array:
        north, east, speed, course, turn_rate = x
        half = turn_rate * dt / 2
        way = speed * dt * sinc(half)
        north, east = north + way * jnp.cos(course + half), east + way * jnp.sin(course + half)
        return jnp.stack([north, east, speed, course + turn_rate * dt, turn_rate])

    def noise(position: float, speed: float, course: float, turn_rate: float) -> np.ndarray:
        """Variances per second from standard deviations per √s."""
        return squares([position, position, speed, course, turn_rate])

    names = ("north", "east", "speed", angle("course"), "turn_rate")
    return Motion(function, names, noise, units=("m", "m", "m/s", "rad", "rad/s"))


@made_once
def coordinated_turn_cartesian(axes: Sequence[str] = ("x", "y")) -> Motion:
    """Coordinated turn by Cartesian velocity; the turn rate is positive from the first axis to the second."""
    a, b = names_of("axes", axes, 2)

    def function(x: jax.Array, dt: jax.Array) -> jax.Array:
        p, q, v, w, turn_rate = x
        turn = turn_rate * dt
        along, across = dt * sinc(turn), dt * cosc(turn)
        c, s = jnp.cos(turn), jnp.sin(turn)
        return jnp.stack(
            [p + along * v - across * w, q + across * v + along * w, c * v - s * w, s * v + c * w, turn_rate]
        )

    def noise(acceleration: float, turn_rate: float) -> Callable[[jax.Array], jax.Array]:
        """Q(dt) from the density of the acceleration, m²/s³, and the deviation of the turn rate per √s."""
        straight, of_turn = constant_velocity((a, b)).noise(acceleration), squares(turn_rate)

        def Q(dt: jax.Array) -> jax.Array:
            corner = jnp.zeros((4, 1))
            return jnp.block([[straight(dt), corner], [corner.T, jnp.reshape(of_turn * dt, (1, 1))]])

        return Q

    return Motion(function, (a, b, f"v{a}", f"v{b}", "turn_rate"), noise, units=("m", "m", "m/s", "m/s", "rad/s"))


@made_once
def unicycle() -> Motion:
    """A vehicle driven by odometry: inputs speed and turn rate, heading from x towards y, exact arcs."""

    def function(x: jax.Array, dt: jax.Array, u: jax.Array) -> jax.Array:
        px, py, heading = x
        speed, turn_rate = u
        half = turn_rate * dt / 2
        way = speed * dt * sinc(half)
        return jnp.stack([px + way * jnp.cos(heading + half), py + way * jnp.sin(heading + half), heading + 2 * half])

    def noise(position: float, heading: float) -> np.ndarray:
        """Variances per second from standard deviations per √s."""
        return squares([position, position, heading])

    return Motion(function, ("x", "y", angle("heading")), noise, ("speed", "turn_rate"), ("m", "m", "rad"))


@made_once
def mirrored_speed(speed: int, course: int) -> Callable[[jax.Array], jax.Array]:
    """A domain for states by speed and course: a negative speed is the mirrored course."""
    speed, course = place_of("speed", speed), place_of("course", course)

    def domain(x: jax.Array) -> jax.Array:
        backwards = x[speed] < 0
        sign = jnp.where(backwards, -1.0, 1.0)
        return x.at[speed].multiply(sign).at[course].add(jnp.where(backwards, jnp.pi, 0.0))

    return domain


@made_once
def quadratic(Phi0: Any, Phi_x: Any, Phi_xx: Any, names: Sequence[str] | None = None, Phi_u: Any = None) -> Motion:
    """Φ⁰ + Φˣ x + xᵀ Φˣˣ x + Φᵘ u, component by component, whatever the time between steps (Stepanov et al., (2), (3)).

    Args:
        Phi0: (n,).
        Phi_x: (n, n).
        Phi_xx: (n, n, n), a block for each component.
        names: of the components.
        Phi_u: (n, k), what known inputs u (k,) add; without it the motion takes none.

    Raises:
        InputError: where the shapes do not fit.
    """
    function, n = quadratic_function("Phi", Phi0, Phi_x, Phi_xx, Phi_u)
    state = names_of("names", [f"x{i}" for i in range(n)] if names is None else names, n)

    def moved(x: jax.Array, dt: jax.Array, *u: jax.Array) -> jax.Array:
        return function(x, *u)

    def noise(covariance: Any) -> Callable[[jax.Array], jax.Array]:
        """Q of a step from its covariance (n, n) or variances (n,)."""
        whole = numbers("the covariance of the noise", covariance)

        def Q(dt: jax.Array) -> jax.Array:
            return jnp.asarray(whole)

        return Q

    return Motion(motion_of(moved, Phi_u is not None), state, noise)
