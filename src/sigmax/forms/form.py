"""What a form is: two functions on arrays that know nothing of models."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import jax

from sigmax.algebra.factor import Matrix
from sigmax.rules.linearization import Linearization


class Predicted(NamedTuple):
    """The covariance after a prediction: its factor S (n, n, ...), and whether it is sound (...)."""

    factor: jax.Array
    sound: jax.Array


class Corrected(NamedTuple):
    """The effect of one measurement.

    Attributes:
        shift: what the correction adds to the mean (n, ...).
        factor: S of the corrected covariance (n, n, ...).
        whitened: S_y⁻¹ ν (m, ...), of unit covariance if the filter is honest.
        innovation_factor: S_y (m, m, ...), the factor of the innovation's covariance.
        sound: whether the noise, less negative weights, is positive definite (...).
    """

    shift: jax.Array
    factor: jax.Array
    whitened: jax.Array
    innovation_factor: jax.Array
    sound: jax.Array


@dataclass(frozen=True)
class Form:
    """A way to compute a covariance from step to step.

    Every half-step ends with the lower factor S of the covariance, from which rules draw their
    points: results of sigma points depend on the root, so all forms use this one, and P = S Sᵀ or
    Y = P⁻¹ is formed where it is read. No form squares, inverts or subtracts what has the scale of the prior.

    Attributes:
        name: as it stands in tables.
        predict: (linearisation, factor of Q) -> Predicted.
        correct: (S, linearisation, factor of R, innovation ν) -> Corrected.
        omega: whether a correction counts Ω, what the straight line of the sensor misses.
        bias_first: whether S is the factor of [b; x], the bias of a model before its state, rather than of [x; b].
        biased: p -> the form for a model with p biases, None for a form that need not know.
    """

    name: str
    predict: Callable[[Linearization, Matrix], Predicted] = field(repr=False)
    correct: Callable[[jax.Array, Linearization, Matrix, jax.Array], Corrected] = field(repr=False)
    omega: bool = True
    bias_first: bool = False
    biased: "Callable[[int], Form] | None" = field(default=None, repr=False)

    def on(self, biases: int) -> "Form":
        """The form on a model with so many biases."""
        return self if self.biased is None else self.biased(biases)
