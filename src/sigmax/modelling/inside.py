"""Noises that stand inside a function: motion(x, dt, w), sensor(x, v)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import Lifted, product
from sigmax.algebra.compiling import compiled
from sigmax.algebra.factor import cholesky, safe_sqrt
from sigmax.dependence import reading
from sigmax.errors import InputError
from sigmax.modelling.checks import numbers, symmetric_semidefinite
from sigmax.modelling.noise import motion_of, sensor_of, takes
from sigmax.rules.linearization import Linearization, Rule, slope_of
from sigmax.tracing import traceable

_Three = tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]
_factor = compiled(cholesky)


@dataclass(frozen=True)
class Inside:
    """A function whose last argument is its noise, N(0, C).

    Attributes:
        function: `motion(x, dt, w)` or `motion(x, dt, u, w)`; `sensor(x, v)` or `sensor(x, u, v)`.
        noise: the root of C, row by row, or a function of dt that gives C.
        size: q, the numbers of the noise.
    """

    function: Callable[..., Any]
    noise: Any
    size: int


def inside(function: Callable[..., Any], noise: Any, size: int | None = None) -> Inside:
    """A motion or a sensor with its noise inside, for `Model(motion=inside(f, Q))`, `Model(sensor=inside(h, R))`.

    The noise is drawn, in points or derivatives, together with the state; what enters as a plain sum costs no points.
    The Q or R of the model is left out.

    Args:
        function: of a motion `f(x, dt, w)` or `f(x, dt, u, w)`, of a sensor `h(x, v)` or `h(x, u, v)`; written like
            other functions of a model, its value without noise is that at w = 0.
        noise: the covariance (q, q) or variances (q,): of a motion per second and multiplied by dt, or a function of
            dt that gives that of the interval.
        size: q, where the noise is a function.

    Raises:
        InputError: for what is no covariance, or no size where it is needed.
    """
    if not callable(function):
        raise InputError(f"inside wants a function that takes its noise; it is {type(function).__name__}")
    if callable(noise):
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise InputError(f"a noise that is a function needs size=, how many numbers it has; it is {size!r}")
        return Inside(traceable(function), traceable(noise), size)
    value = np.atleast_1d(np.asarray(numbers("the noise", noise), float))
    C = np.diag(value) if value.ndim == 1 else value
    if C.ndim != 2 or C.shape[0] != C.shape[1] or size not in (None, len(C)):
        raise InputError(f"the noise inside is a covariance (q, q) or q variances; it has the shape {value.shape}")
    symmetric_semidefinite("the noise inside", C)
    root = np.asarray(_factor(C)[0])
    return Inside(traceable(function), tuple(map(tuple, root.tolist())), len(C))


def of_motion(given: Inside) -> _Three:
    """The motion without noise, the covariance that its noise has at a state by first derivatives, and of [ξ; x]."""
    return _of(given, 2, takes(given.function, "motion", (3, 4)) == 4)


def of_sensor(given: Inside, name: str) -> _Three:
    """The same of a sensor."""
    if callable(given.noise):
        raise InputError(f"the noise inside {name or 'the sensor'} is given in numbers; no dt belongs to a measurement")
    return _of(given, 1, takes(given.function, name or "sensor", (2, 3)) == 3)


@lru_cache(maxsize=256)
def _of(given: Inside, before: int, driven: bool) -> _Three:
    q = given.size

    def joint(X: jax.Array, *rest: jax.Array) -> jax.Array:
        xi, x = X[:q], X[q:]
        dt = rest[0] if before == 2 else None
        L = cholesky(jnp.asarray(given.noise(dt)))[0] if callable(given.noise) else jnp.asarray(given.noise)
        w = L.astype(X.dtype) @ xi
        if dt is not None and not callable(given.noise):
            w = w * safe_sqrt(jnp.asarray(dt, X.dtype))[0]
        return jnp.asarray(given.function(x, *rest, w))

    def plain(x: jax.Array, *rest: jax.Array) -> jax.Array:
        return jnp.asarray(given.function(x, *rest, jnp.zeros(q, jnp.asarray(x).dtype)))

    def spread(x: jax.Array, *rest: jax.Array) -> jax.Array:
        J = jax.jacfwd(lambda xi: joint(jnp.concatenate([xi, x]), *rest))(jnp.zeros(q, x.dtype))
        return product(J, J.T)

    of = motion_of if before == 2 else sensor_of
    return of(plain, driven), of(spread, driven), joint


def with_columns(
    rule: Rule, g: Lifted, q: int, x: jax.Array, S: jax.Array, angular: Any
) -> tuple[Linearization, jax.Array]:
    """The line of g([ξ; x]) in x, ξ ~ N(0, I) of q numbers, and the columns (m, q, ...) that ξ adds to its noise.

    Numbers of ξ that enter as a sum, with factors that nothing drawn changes, are not drawn: the line is that of a
    plain noise then, to rounding. The others are coordinates of the rule like those of the state.
    """
    read = reading(g.function, q + x.shape[0], g.single, x.dtype)
    bent = tuple(i for i in range(q) if read.nonlinear >> i & 1)
    nothing = jnp.zeros((q, *x.shape[1:]), x.dtype)
    b, some = len(bent), g.instead(_drawn(g.function, q, bent))
    if b:
        eye, empty = _eye(b, S), jnp.zeros((b, *S.shape[1:]), S.dtype)
        across = jnp.zeros((S.shape[0], b, *S.shape[2:]), S.dtype)
        root = jnp.concatenate([jnp.concatenate([eye, empty], 1), jnp.concatenate([across, S], 1)])
        line = rule(some, jnp.concatenate([nothing[:b], x]), root, angular)
    else:
        line = rule(some, x, S, angular)
    columns = [line.slope[:, :b]]
    straight = [i for i in range(q) if i not in bent]
    if straight:
        at = jnp.concatenate([nothing, x])
        along = np.zeros((len(at), len(straight)))
        along[straight, range(len(straight))] = 1
        spread = jnp.broadcast_to(
            jnp.asarray(along, x.dtype).reshape(*along.shape, *(1,) * (x.ndim - 1)), (*along.shape, *x.shape[1:])
        )
        columns.append(slope_of(g, at, spread)[1])
    return line._replace(slope=line.slope[:, b:]), jnp.concatenate(columns, 1)


def _eye(b: int, like: jax.Array) -> jax.Array:
    return jnp.broadcast_to(
        jnp.eye(b, dtype=like.dtype).reshape(b, b, *(1,) * (like.ndim - 2)), (b, b, *like.shape[2:])
    )


@lru_cache(maxsize=256)
def _drawn(function: Callable[..., Any], q: int, bent: tuple[int, ...]) -> Callable[..., Any]:
    """The function of the numbers of ξ that are drawn, and of x; the others are 0."""

    def of_some(X: jax.Array, *rest: jax.Array) -> Any:
        nothing = jnp.zeros((), X.dtype)
        xi = jnp.stack([X[bent.index(i)] if i in bent else nothing for i in range(q)])
        return function(jnp.concatenate([xi, X[len(bent) :]]), *rest)

    return of_some


def noises_apart(motion: Any, sensor: Any, Q: Any, R: Any) -> tuple[Any, Any, Any, Any, tuple[Any, ...]]:
    """Motion, sensors and their noises as if these were added, and those inside, by sensor, None for the motion.

    Raises:
        InputError: where a noise is given twice, or not at all.
    """
    within: list[tuple[str | None, Callable[..., Any], int]] = []
    if isinstance(motion, Inside):
        if Q is not None:
            raise InputError("the motion has its noise inside: leave Q out")
        size = motion.size
        motion, Q, joint = of_motion(motion)
        within.append((None, joint, size))
    several = isinstance(sensor, Mapping)
    parts = dict(sensor) if isinstance(sensor, Mapping) else {"": sensor}
    if several and not (R is None or isinstance(R, Mapping)):
        raise InputError(f"with several sensors R must be a dict by sensor name, it is {type(R).__name__}")
    noises: dict[str, Any] = dict({} if R is None else R) if several else {"": R}
    for s, part in parts.items():
        if isinstance(part, Inside):
            if noises.get(s) is not None:
                raise InputError(f"{s or 'the sensor'} has its noise inside: leave its R out")
            parts[s], noises[s], joint = of_sensor(part, s)
            within.append((s, joint, part.size))
    if Q is None or (not several and noises[""] is None):
        raise InputError("a model needs Q and R, the noises of its motion and of its sensors")
    return (motion, parts, Q, noises, tuple(within)) if several else (motion, parts[""], Q, noises[""], tuple(within))
