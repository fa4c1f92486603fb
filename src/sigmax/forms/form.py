"""What a form is: four functions on arrays that know nothing of models."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax

from sigmax.algebra.factor import Matrix
from sigmax.rules.linearization import Linearization


class Predicted(NamedTuple):
    """The covariance after a prediction: its factor S (n, n, ...), what the form carries, is it sound (...)."""

    factor: jax.Array
    carried: Any
    sound: jax.Array


class Corrected(NamedTuple):
    """The effect of one measurement.

    Attributes:
        shift: what the correction adds to the mean (n, ...).
        factor: S of the corrected covariance (n, n, ...).
        carried: what the form carries beside it.
        whitened: S_y⁻¹ ν (m, ...), of unit covariance if the filter is honest.
        innovation_factor: S_y (m, m, ...), the factor of the innovation's covariance.
        sound: whether the innovation's and the corrected covariance are positive definite (...).
    """

    shift: jax.Array
    factor: jax.Array
    carried: Any
    whitened: jax.Array
    innovation_factor: jax.Array
    sound: jax.Array


@dataclass(frozen=True)
class Form:
    """A way to carry a covariance from step to step.

    Every half-step ends with the lower factor S of the covariance, from which rules draw their
    points: results of sigma points depend on the root, so all forms use this one.

    Attributes:
        name: as it stands in tables.
        start: S -> what the form carries beside S, `()` where that is nothing.
        predict: (linearisation, factor of Q) -> Predicted.
        correct: (S, carried, linearisation, factor of R, innovation ν) -> Corrected.
        omega: whether a correction counts Ω, what the straight line of the sensor misses.
        bias_first: whether S is the factor of [b; x], the bias of a model before its state, rather than of [x; b].
        biased: p -> the form for a model with p biases, None for a form that need not know.
    """

    name: str
    start: Callable[[jax.Array], Any] = field(repr=False)
    predict: Callable[[Linearization, Matrix], Predicted] = field(repr=False)
    correct: Callable[[jax.Array, Any, Linearization, Matrix, jax.Array], Corrected] = field(repr=False)
    omega: bool = True
    bias_first: bool = False
    biased: "Callable[[int], Form] | None" = field(default=None, repr=False)

    def on(self, biases: int) -> "Form":
        """The form on a model with so many biases."""
        return self if self.biased is None else self.biased(biases)
