"""Components that are considered: what is not known of them counts, and no measurement changes them (Schmidt 1966)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sigmax.algebra.arrays import outer
from sigmax.algebra.factor import add, solve_lower
from sigmax.filters import Filter
from sigmax.forms import Corrected
from sigmax.forms.noise import noise_factor
from sigmax.modelling.model import Model
from sigmax.steps.updating import Observed


def considered(filter: Filter, model: Model, S: jax.Array, taken: Observed, done: Corrected) -> Corrected:
    """A correction with the rows of the gain of considered components 0.

    P⁺ = P − C Cᵀ of the full correction, C = S Eᵀ S_y⁻ᵀ, is right but for the block of these components, which stays
    what it was: C_c C_cᵀ is added to it again, by columns on the triangle. So no difference is taken in any form, and
    Joseph's formula with K_c = 0 comes out.
    """
    if not filter.consider:
        return done
    held = rows_considered(filter, model)
    line = taken.line
    if not filter.form.omega:
        line = line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0])
    noise, _ = noise_factor(line, taken.noise)
    gained = solve_lower(add(noise, line.slope), outer(line.slope, S)).swapaxes(0, 1)
    columns = jnp.where(_along(held, gained), gained, 0)
    return done._replace(shift=jnp.where(_along(held, done.shift), 0, done.shift), factor=add(done.factor, columns))


def grown(filter: Filter, model: Model, S: jax.Array, growth: Any) -> jax.Array:
    """S with the deviations that a filter may find wrong made larger; those of considered components stay."""
    if not filter.consider:
        return S * growth
    held = rows_considered(filter, model)
    return jnp.where(_along(held, S), S, S * growth)


def rows_considered(filter: Filter, model: Model) -> np.ndarray:
    """Which deviations (d,) of a model, its bias written into its state, the filter considers."""
    return np.array([str(name) in filter.consider for name in model.deviations])


def _along(rows: np.ndarray, a: jax.Array) -> np.ndarray:
    return rows.reshape(-1, *(1,) * (a.ndim - 1))
