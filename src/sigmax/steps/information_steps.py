"""Half-steps from a prior that leaves directions open: a filter for one start, and what is known of the start.

Of a linear model every state is x = a + A δ + e with δ the state of the prior and e ~ N(0, S Sᵀ): the filter itself
carries a and S as if δ were 0 and known, A goes the way of a mean, and each innovation is a measurement of δ. What is
known of δ is a root of information, rᵀ r = Y and r δ = c, which may be singular (de Jong 1991; the rows are included by
Givens rotations, Gentleman 1974). No covariance is made larger than it is, and no motion is inverted.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import diagonal, inner, product, times
from sigmax.algebra.factor import add, cholesky, identity, pivoted, reciprocal, safe_sqrt, solve_lower, triangle
from sigmax.filters import Filter
from sigmax.modelling.evaluate import linearized_motion, linearized_sensor, noise_root
from sigmax.modelling.model import Model
from sigmax.rules import Taylor1
from sigmax.steps import step
from sigmax.steps.adaptive_noises import AdaptiveBelief
from sigmax.steps.soundness import kept
from sigmax.steps.step import LOG_2PI, Belief, Fault, Innovation

# Units of rounding of all that went into a number, below which it is what rounding left of an exact zero.
_DUST = 4096.0


class Start(NamedTuple):
    """What is known by way of the start δ, behind mean and factor in a row.

    Attributes:
        a: the mean if δ were 0 (n, ...).
        S: the factor if δ were known, lower (n, n, ...).
        A: how the state depends on δ (n, n, ...).
        r: the root of the information of δ, upper; rows with a pivot of 0 are 0 (n, n, ...).
        c: r δ as it was measured (n, ...).
    """

    a: Any
    S: Any
    A: Any
    r: Any
    c: Any


def numbers_of_start(n: int) -> int:
    """How many numbers a `Start` has."""
    return 2 * n + n * n + n * (n + 1)


def start_of(known: Any, n: int) -> Start:
    """The `Start` of its numbers (k, ...)."""
    half = n * (n + 1) // 2
    a, S, A, r, c = jnp.split(known, np.cumsum([n, half, n * n, half]))
    square = jnp.zeros((n, n, *known.shape[1:]), known.dtype)
    return Start(
        a, square.at[np.tril_indices(n)].set(S), A.reshape(square.shape), square.at[np.triu_indices(n)].set(r), c
    )


class InformationSteps:
    """The half-steps of an information filter from a pair (y, Y); pure functions that trace to plain operations.

    Args:
        filter: the filter.
        model: the model, a linear one.
    """

    def __init__(self, filter: Filter, model: Model) -> None:
        self.filter, self.model, self.root = filter, model, noise_root(model.Q)

    def begin(self, y: Any, Y: Any) -> tuple[AdaptiveBelief, Any]:
        """The belief of a pair y = Y δ (n, ...) and Y (n, n, ...), and whether it is one (...)."""
        L, sound = cholesky(Y)
        c = jnp.where(diagonal(L) > 0, solve_lower(pivoted(L), y), 0)
        zero = jnp.zeros_like(y)
        return _belief(Start(zero, jnp.zeros_like(Y), identity(Y), jnp.swapaxes(L, 0, 1), c)), sound

    def predict(self, belief: AdaptiveBelief, dt: Any, u: Any) -> tuple[AdaptiveBelief, Any]:
        """The belief dt later, and the fault (...)."""
        now = start_of(belief.known, len(belief.mean))
        moved, fault = step.predict(self.filter, self.model, self.root, Belief(now.a, now.S), dt, u)
        F = linearized_motion(Taylor1(), self.model, now.a, identity(now.A), dt, u).slope
        A = _without_dust(product(F, now.A), product(jnp.abs(F), jnp.abs(now.A)))
        return _belief(now._replace(a=moved.mean, S=moved.factor, A=kept(fault <= 0, A, now.A))), fault

    def correct(
        self, sensor: str, R: Any, belief: AdaptiveBelief, z: Any, u: Any
    ) -> tuple[AdaptiveBelief, Innovation, Any]:
        """The belief after a measurement z (m, ...), what it said of what was determined before, and the fault."""
        model, now, m = self.model, start_of(belief.known, len(belief.mean)), z.shape[0]
        R = model.R[sensor] if R is None else R
        new, told, fault = step.correct(self.filter, model, sensor, R, Belief(now.a, now.S), z, u)
        heard = ~jnp.isnan(told.residual) & (fault <= 0)

        def slope(columns: Any) -> Any:
            return jnp.where(heard[:, None], linearized_sensor(Taylor1(), model, sensor, now.a, columns, u, m).slope, 0)

        H, E, nu, Sy = slope(identity(now.A)), slope(now.S), jnp.where(heard, told.residual, 0), pivoted(told.factor)
        seen = _without_dust(product(H, now.A), product(jnp.abs(H), jnp.abs(now.A)))
        whitened = solve_lower(Sy, seen)
        # K H A with K = S Eᵀ (S_y S_yᵀ)⁻¹.
        gained = product(now.S, inner(solve_lower(Sy, E), whitened))
        A = _without_dust(now.A - gained, jnp.abs(now.A) + jnp.abs(gained))
        V, known = _in_rows(seen, now.r)
        included = _include(now, whitened, solve_lower(Sy, nu), heard)
        after = Start(new.mean, new.factor, kept(fault <= 0, A, now.A), included.r, included.c)
        made = _belief(after)
        open_ = heard & ~known
        residual = jnp.where(heard & known, told.residual - times(V, now.c), jnp.nan)
        factor = add(told.factor, jnp.where(open_[:, None], 0, V))
        volume = jnp.log(jnp.where(included.proper, diagonal(Sy), 1)) + included.growth
        density = -0.5 * (included.left**2 + LOG_2PI) - volume
        count = included.proper.sum(0)
        said = Innovation(
            residual=residual,
            factor=jnp.where(open_[:, None], jnp.nan, factor),
            nis=jnp.where(count > 0, jnp.where(included.proper, included.left**2, 0).sum(0), jnp.nan),
            log_likelihood=jnp.where(included.proper, density, 0).sum(0),
            dof=count,
        )
        undetermined = (fault == 0) & jnp.isnan(made.mean).any(0)
        return made, said, jnp.where(undetermined, jnp.int8(Fault.UNDETERMINED), fault)


def _belief(now: Start) -> AdaptiveBelief:
    """Mean and factor as they follow, NaN in components that what is known of δ leaves open."""
    n = len(now.a)
    W, known = _in_rows(now.A, now.r)
    factor = add(now.S, jnp.where(known[:, None], W, 0))
    shown = triangle([jnp.where(known[j:], factor[j:, j], jnp.nan) for j in range(n)])
    mean = jnp.where(known, now.a + times(W, now.c), jnp.nan)
    numbers = [now.a, now.S[np.tril_indices(n)], now.A.reshape(n * n, *now.a.shape[1:]), now.r[np.triu_indices(n)]]
    return AdaptiveBelief(mean, shown, jnp.concatenate([*numbers, now.c]))


def _without_dust(value: jax.Array, size: jax.Array, units: float = 64.0) -> jax.Array:
    """A value, and 0 where it is below what rounding leaves of terms of a size."""
    return jnp.where(jnp.abs(value) > units * float(np.finfo(value.dtype).eps) * size, value, 0)


def _in_rows(V: jax.Array, r: jax.Array) -> tuple[jax.Array, jax.Array]:
    """W with V = W r for V (q, n, ...), and in which rows there is one (q, ...)."""
    size, known, columns = jnp.abs(V), jnp.ones_like(V[:, 0], bool), []
    for j in range(r.shape[0]):
        pivot = r[j, j]
        there = pivot > 0
        known &= there[None] | (_without_dust(V[:, 0], size[:, 0], _DUST) == 0)
        w = V[:, 0] * reciprocal(pivot, there)[None]
        taken = w[:, None] * r[j, j + 1 :][None]
        V, size = V[:, 1:] - taken, size[:, 1:] + jnp.abs(taken)
        columns.append(w)
    return jnp.stack(columns, axis=1), known


class _Included(NamedTuple):
    """Rows that were taken up.

    Attributes:
        r: the root after them.
        c: its right side.
        left: of each row, what it says that was not free to choose, in deviations (m, ...).
        growth: the logarithm of what the row's variance is above 1 (m, ...).
        proper: whether it measured what was determined before (m, ...).
    """

    r: jax.Array
    c: jax.Array
    left: jax.Array
    growth: jax.Array
    proper: jax.Array


def _include(now: Start, V: jax.Array, e: jax.Array, heard: jax.Array) -> _Included:
    """Take up V δ = e + N(0, I), V (m, n, ...), row by row: a row that a pivot of 0 meets becomes the row of it."""
    n = V.shape[1]
    rows, c = [now.r[j, j:] for j in range(n)], [now.c[j] for j in range(n)]
    left, growths, proper = [], [], []
    for i in range(V.shape[0]):
        row, right, size = V[i], e[i], jnp.abs(V[i])
        growth, free = jnp.zeros_like(right), jnp.zeros_like(right, bool)
        for j in range(n):
            pivot, beside = rows[j][0], rows[j][1:]
            there = pivot > 0
            head = jnp.where(there, row[0], _without_dust(row[0], size[0], _DUST))
            norm, positive = safe_sqrt(pivot * pivot + head * head)
            scale = reciprocal(norm, positive)
            cosine, sine = jnp.where(positive, pivot * scale, 1), head * scale
            growth = growth + jnp.log(jnp.where(there, norm * reciprocal(pivot, there), 1))
            free |= ~there & (head != 0)
            taken = sine * beside
            rows[j] = jnp.concatenate([norm[None], cosine * beside + sine * row[1:]])
            c[j], right = cosine * c[j] + sine * right, cosine * right - sine * c[j]
            row, size = cosine * row[1:] - taken, cosine * size[1:] + jnp.abs(taken)
        left.append(right)
        growths.append(growth)
        proper.append(heard[i] & ~free)
    r = jnp.swapaxes(triangle(rows), 0, 1)
    return _Included(r, jnp.stack(c), *map(jnp.stack, (left, growths, proper)))
