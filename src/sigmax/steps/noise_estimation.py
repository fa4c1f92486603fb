"""R and Q that measurements make likely: variational Bayes for R, recursive maximum likelihood for Q."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from sigmax.algebra.arrays import times
from sigmax.algebra.factor import Diagonal, add, dense, solve_lower
from sigmax.forms.noise import noise_factor
from sigmax.steps.updating import Observed, columns_scaled

# How often λ and the state are estimated from each other; a sweep leaves about 1 / memory of what was missing.
_SWEEPS = 2
# What is known of the logarithm of a number of Q before anything is measured: that it is 1 within a factor of ten.
_PRIOR = 1 / math.log(10) ** 2
# One measurement changes Q by a factor of two at most, all of them by 10¹².
_STEP, _FARTHEST = math.log(2), 12 * math.log(10)


def estimate_R(
    memory: float, taken: Observed, before: jax.Array, seen: jax.Array, omega: bool
) -> tuple[Observed, jax.Array]:
    """The measurement with the noise that it makes likely, and λ (m, ...) after it.

    The noise of a sensor is v = L_r Λ^½ ε, Λ diagonal and L_r the factor of the model's R: so all there is to know are
    numbers λ, 1 where the model is right, whatever R is. λ is inverse gamma with memory / 2 for its shape, which is
    what forgetting a share of 1 / memory leaves of any shape in the end. With G = S_y⁻¹ L_r Λ^½ and e = S_y⁻¹ ν,
    E[ε_j² | z] = (Gᵀ e)_j² + 1 − |G_j|²: β of Särkkä and Nummenmaa 2009, without forming P or R.

    Args:
        memory: how many measurements are remembered.
        taken: with the noise as λ was before it.
        before: that λ.
        seen: which components were measured (m, ...).
        omega: whether the form takes what the line misses for noise.
    """
    line = taken.line
    if not omega:
        line = line._replace(residual=line.residual[:, :0], deficit=line.deficit[:, :0])
    now, noise = before, taken.noise
    for _ in range(_SWEEPS):
        Sy = add(noise_factor(line, noise)[0], line.slope)
        G = solve_lower(Sy, dense(noise))
        known = times(G.swapaxes(0, 1), solve_lower(Sy, taken.innovation))
        squared = now * (known * known + 1 - (G * G).sum(0))
        now = jnp.where(seen, before + (squared - before) / memory, before)
        noise = columns_scaled(taken.noise, jnp.sqrt(now / before))
    return taken._replace(noise=noise), now


class QScale(NamedTuple):
    """What is known of a number s by which a group of rows of Q is multiplied.

    Attributes:
        logarithm: θ = log s (...).
        information: that of the measurements which are remembered, of θ (...).
        mean: dx/dθ (points, ...), of the numbers of the mean.
        factor: dS/dθ (n, n, ...), lower.
    """

    logarithm: Any
    information: Any
    mean: Any
    factor: Any


class Slope(NamedTuple):
    """Derivatives of what a measurement said by θ: residual (m, ...), factor of its covariance, log-likelihood."""

    residual: Any
    factor: Any
    log_likelihood: Any


def estimate_Q(found: QScale, memory: float, said: Any, slope: Slope, heard: jax.Array) -> tuple[jax.Array, jax.Array]:
    """θ and its information after a measurement: a step of Newton's method on the likelihood that is remembered.

    The score of the innovation is the derivative of its log-likelihood through all steps before (recursive prediction
    error: Ljung and Söderström 1983, section 3.8), its information |S_y⁻¹ ν̇|² + |A + Aᵀ|² / 2 with A = S_y⁻¹ Ṡ_y. What
    measurements do not tell goes back to the model's Q.

    Args:
        found: before the measurement.
        memory: how many measurements are remembered.
        said: the innovation.
        slope: its derivatives by θ.
        heard: whether it was used (...).
    """
    whole = jnp.where(heard, said.factor, dense(Diagonal(jnp.ones_like(said.residual))))
    along = solve_lower(whole, jnp.where(jnp.isnan(said.residual), 0, slope.residual))
    A = solve_lower(whole, slope.factor)
    told = (along**2).sum(0) + ((A + A.swapaxes(0, 1)) ** 2).sum((0, 1)) / 2
    forgotten = 1 / memory
    information = found.information * (1 - forgotten) + told
    step = (slope.log_likelihood - forgotten * _PRIOR * found.logarithm) / (information + _PRIOR)
    good = heard & jnp.isfinite(step + information)
    step = jnp.clip(jnp.where(good, step, 0), -_STEP, _STEP)
    logarithm = jnp.clip(found.logarithm + step, -_FARTHEST, _FARTHEST)
    return logarithm, jnp.where(good, information, found.information)
