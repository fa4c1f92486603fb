"""From a sensor to the one correction of a form: linearised, weighed, linearised again about the posterior.

All of it happens in units of the prior: the state is x ⊞ S t with t ~ N(0, I), so that nothing here knows how a form
carries its covariance.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import product, times
from sigmax.algebra.factor import Diagonal, Matrix, add, dense, downdate, identity, raised, solve_lower
from sigmax.algebra.rotations import rotate
from sigmax.filters import BySensor, Filter, Update, Weighed, iterated, once
from sigmax.forms.noise import noise_factor
from sigmax.modelling.evaluate import heard_sensor
from sigmax.modelling.model import Model
from sigmax.rules.linearization import Linearization
from sigmax.spaces import Space, reset

# Units of rounding of its row to which an entry of a factor or a slope is not trusted. What rounding leaves of an
# exact zero enters a gain as its square against the square of this: an error of 1 / ROUNDING² is left of it.
ROUNDING = 64.0


class Observed(NamedTuple):
    """A measurement by the line of its sensor about x ⊞ S t.

    Attributes:
        line: its slope in columns of the prior's S.
        residual: z ⊟ ŷ (m, ...), 0 where a component is missing.
        innovation: ν = z ⊟ ŷ + E t, as from the prior.
        noise: L_r (m, m, ...), nowhere below what rounding leaves.
        widened: whether negative weights had to be left out (...).
    """

    line: Linearization
    residual: jax.Array
    innovation: jax.Array
    noise: Matrix
    widened: jax.Array


class Updated(NamedTuple):
    """What the form corrects with, and what the measurement said of the prediction.

    Attributes:
        observed: for the form.
        whitened: S_y⁻¹ ν of the first line (m, ...), None where it is that of the form.
        factor: S_y of the first line (m, m, ...), None where it is that of the form.
        weighed: the weights, None for none.
    """

    observed: Observed
    whitened: jax.Array | None = None
    factor: jax.Array | None = None
    weighed: Weighed | None = None


Observe = Callable[..., Observed]


def observing(
    filter: Filter, model: Model, sensor: str, Lr: Matrix, x: jax.Array, S: jax.Array, z: jax.Array, u: Any
) -> Observe:
    """The measurement by the sensor's line, as a function of t (n, ...) and of D, the root of t's covariance."""
    space, onto = model.space, model.measured_space(sensor, z.shape[0])
    known, seen = there(onto, z)
    eps = float(np.finfo(x.dtype).eps)

    def observe(t: jax.Array | None = None, D: jax.Array | None = None) -> Observed:
        shift = None if t is None else times(S, t)
        at = x if shift is None else space.add(x, shift)
        # The columns of the prior seen from there: those of D first, as a rule wants a triangle.
        moved = None if shift is None or D is None else reset(space, x, shift, product(S, D))
        spread = moved.factor if moved is not None else S if shift is None else space.turned(x, shift, S)
        line, inside = heard_sensor(filter.correct, model, sensor, at, spread, u, z.shape[0])
        measured = jnp.where(known, z, 0 if onto.flat else line.mean)
        residual = jnp.where(seen, onto.difference(onto.nearest(measured), line.mean), 0)
        slope = jnp.where(seen[:, None], line.slope, 0)
        line = line._replace(
            slope=slope if moved is None or D is None else right_solve(moved.unturned(slope), D),
            residual=jnp.where(seen[:, None], line.residual, 0),
            deficit=jnp.where(seen[:, None], line.deficit, 0),
        )
        least = ROUNDING * eps * jnp.abs(line.slope).sum(1) + jnp.where(seen, 4 * eps * onto.magnitude(line.mean), 0)
        noise = raised(add(Lr, jnp.where(seen[:, None], inside, 0)) if inside.shape[1] else Lr, least)
        line, widened = without_deficit(line, noise)
        innovation = residual if t is None else residual + times(line.slope, t)
        return Observed(line, residual, innovation, noise, widened)

    return observe


def update_on(filter: Filter, model: Model, sensor: str) -> Update:
    """The update of a filter for a sensor of a model: its own, or that of the space where it has none.

    On a curved space the corrected covariance is seen from the new mean, and so the line has to be about it.
    """
    own = filter.update.of(sensor) if isinstance(filter.update, BySensor) else filter.update
    return own or (iterated(1) if model.curved else once)


def there(space: Space, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Which numbers of a measurement (m, ...) count as measured, and which of its deviations (d, ...).

    Of a curved part all numbers, or none.
    """
    known = ~jnp.isnan(z)
    if space.flat:
        return known, known
    parts = [known[at] if p.flat else jnp.broadcast_to(known[at].all(0), known[at].shape) for p, at, _ in space.parts()]
    return jnp.concatenate(parts), space.whole(known)


def updated(filter: Filter, update: Update, observe: Observe, first: Observed, seen: jax.Array) -> Updated:
    """The measurement as an update takes it, `seen` (...) of its components being there.

    Innovation and NIS are those of the first line: a gate and a test of consistency judge the prediction.
    """
    if update.weight is None and not update.iterations and update.memory is None:
        return Updated(first)
    noise, _ = noise_factor(first.line, first.noise)
    factor = add(noise, first.line.slope)
    whitened = solve_lower(factor, first.innovation)
    weighed = None if update.weight is None else update.weight(whitened, seen)
    last = _iterated(filter, update, observe, first, weighed) if update.iterations else first
    return Updated(last if weighed is None else _weighted(last, weighed, filter.form.omega), whitened, factor, weighed)


def without_deficit(line: Linearization, L: Matrix) -> tuple[Linearization, jax.Array]:
    """The linearisation with no negative weights where N Nᵀ − D Dᵀ + L Lᵀ is indefinite; and whether it was (...).

    Where that is positive definite, so is everything that a correction computes.
    """
    if not line.deficit.shape[1]:
        return line, jnp.zeros(line.mean.shape[1:], bool)
    _, exists = downdate(add(L, line.residual), line.deficit)
    return line._replace(deficit=jnp.where(exists, line.deficit, 0)), ~exists


def _iterated(filter: Filter, update: Update, observe: Observe, first: Observed, weighed: Weighed | None) -> Observed:
    """The line about the posterior of the line before, so many times; where it is guarded, the best one by its cost.

    A Gauss–Newton step that raises |t|² + |L_r⁻¹ (z ⊟ ŷ)|² by more than rounding is halved from the best t so far.
    """
    omega = filter.form.omega
    local = getattr(filter.correct, "local", False)
    best, t, cost = first, jnp.zeros_like(first.line.slope[0]), _misfit(first, weighed)
    step, better = t, jnp.ones(t.shape[1:], bool)
    # The cost tells steps of less than the root of this no longer apart; where they end must not hang on its last bit.
    rounding = 64 * float(np.finfo(t.dtype).eps)
    for _ in range(update.iterations):
        full, D = _posterior(best if weighed is None else _weighted(best, weighed, omega), local)
        step = jnp.where(better, full, (t + step) / 2)
        new = observe(step, D)
        new_cost = (step * step).sum(0) + _misfit(new, weighed)
        better = new_cost <= (1 + rounding) * cost if update.guarded else jnp.ones_like(better)
        best, t, cost = jax.tree.map(
            lambda a, b, better=better: jnp.where(better, a, b), (new, step, new_cost), (best, t, cost)
        )
    return best


def _misfit(observed: Observed, weighed: Weighed | None) -> jax.Array:
    """|L_r⁻¹ (z ⊟ ŷ)|² (...), of weighted components."""
    L = observed.noise
    whitened = observed.residual / L.entries if isinstance(L, Diagonal) else solve_lower(L, observed.residual)
    squared = whitened * whitened
    return (squared if weighed is None else squared * weighed.weights).sum(0)


def _posterior(observed: Observed, local: bool) -> tuple[jax.Array, jax.Array | None]:
    """Mean t (n, ...) and root D (n, n, ...) of N(0, I) after a measurement; no D for a rule that needs no spread."""
    noise, _ = noise_factor(observed.line, observed.noise)
    E = observed.line.slope
    if local:
        Sy = add(noise, E)
        return times(solve_lower(Sy, E).swapaxes(0, 1), solve_lower(Sy, observed.innovation)), None
    Sy, gain, D = rotate(noise, E, identity(E))
    # Points that are closer than this differ by rounding more than by their distance.
    narrowest = float(np.finfo(E.dtype).eps) ** (1 / 3)
    D = dense(raised(D, jnp.full(D.shape[1:], narrowest, D.dtype)))
    return times(gain, solve_lower(Sy, observed.innovation)), D


def _weighted(observed: Observed, weighed: Weighed, omega: bool) -> Observed:
    """The measurement with its noise R̃ divided by the roots of the weights; what the line misses is in R̃ then."""
    line = observed.line
    bare = line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0])
    noise, _ = noise_factor(line if omega else bare, observed.noise)
    weights = weighed.weights
    noise = columns_scaled(noise, jnp.sqrt(1 / jnp.where(weights > 0, weights, 1)))
    return observed._replace(line=bare, noise=noise)


def columns_scaled(L: Matrix, by: jax.Array) -> Matrix:
    """A factor with its columns multiplied by numbers (m, ...)."""
    return Diagonal(L.entries * by) if isinstance(L, Diagonal) else L * by[None]


def right_solve(E: jax.Array, D: jax.Array) -> jax.Array:
    """E D⁻¹ (m, n, ...) for a lower triangle D."""
    turned = D[::-1, ::-1].swapaxes(0, 1)
    return solve_lower(turned, E.swapaxes(0, 1)[::-1])[::-1].swapaxes(0, 1)
