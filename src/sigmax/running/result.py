"""What a run leaves behind."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike

from sigmax.algebra.arrays import TWO_PI
from sigmax.errors import InputError
from sigmax.running.covariances import covariances
from sigmax.running.step import Fault, Innovation

# What a run can keep.
PARTS = ("mean", "factor", "fault", "nis", "dof", "step_log_likelihood", "innovation")


class Layout(NamedTuple):
    """What the arrays of a result mean."""

    state: tuple[str, ...]
    angular: tuple[bool, ...]
    batched: bool
    several: bool


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Smoothed:
    """Means and covariances over time; the batch, where there is one, comes first.

    Arrays are NumPy arrays, or JAX arrays while being traced.
    """

    layout: Layout = field(metadata={"static": True})
    stored_mean: Any = field(repr=False)
    stored_factor: Any = field(repr=False)
    stored_fault: Any = field(repr=False)

    def _out(self, a: Any, what: str) -> Any:
        if a is None:
            raise InputError(f"{what} was not kept; add it to keep= in run")
        return a

    @property
    def state(self) -> tuple[str, ...]:
        """Names of the components."""
        return self.layout.state

    @property
    def mean(self) -> Any:
        """Estimates (…, T, n)."""
        return self._out(self.stored_mean, "mean")

    @property
    def factor(self) -> Any:
        """Lower factors S of the covariances, P = S Sᵀ (…, T, n, n)."""
        return self._out(self.stored_factor, "factor")

    @property
    def cov(self) -> Any:
        """Covariances (…, T, n, n), computed when asked for."""
        return covariances(self.factor)

    @property
    def std(self) -> Any:
        """Standard deviations (…, T, n)."""
        S = self.factor
        return (S * S).sum(-1) ** 0.5

    @property
    def fault(self) -> Any:
        """Why a step was not sound, as numbers of `Fault` (…, T); 0 where it was."""
        return self._out(self.stored_fault, "fault")

    @property
    def ok(self) -> Any:
        """Whether each step was sound (…, T)."""
        return self.fault == 0

    def faults(self, limit: int = 10) -> list[str]:
        """The first steps that were not sound, in words."""
        places = np.argwhere(~self.ok)[:limit]
        where = [f"track {p[0]}, step {p[1]}" if self.layout.batched else f"step {p[0]}" for p in places]
        found = [Fault(int(self.fault[tuple(p)])) for p in places]
        return [f"{w}: {fault.message}" for w, fault in zip(where, found, strict=True)]

    def errors(self, truth: ArrayLike) -> Any:
        """Mean − truth (…, T, n), angles in [-π, π]; truth of shape (T, n) or (…, T, n)."""
        difference = self.mean - np.asarray(truth)
        period = np.where(self.layout.angular, TWO_PI, 0.0)
        return difference - period * np.round(difference / TWO_PI)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result(Smoothed):
    """Filtered estimates and what the measurements said; see `Smoothed` for the shapes."""

    stored_innovations: Any = field(repr=False)
    stored_nis: Any = field(repr=False)
    stored_log_likelihood: Any = field(repr=False)
    stored_count: Any = field(repr=False)
    stored_total: Any = field(repr=False)

    @property
    def nis(self) -> Any:
        """Normalised innovation squared (…, T), summed over the sensors of a step, NaN without measurement.

        Of an honest filter it is chi-square with `dof` degrees of freedom.
        """
        return self._out(self.stored_nis, "nis")

    @property
    def dof(self) -> Any:
        """Number of measured components used in each step (…, T)."""
        return self._out(self.stored_count, "dof")

    @property
    def log_likelihood(self) -> Any:
        """Log-likelihood of the whole record (…)."""
        return self._out(self.stored_total, "log_likelihood")

    @property
    def step_log_likelihood(self) -> Any:
        """Log-likelihood of each step (…, T)."""
        return self._out(self.stored_log_likelihood, "step_log_likelihood")

    @property
    def innovation(self) -> Any:
        """Z − ẑ (…, T, m), angles in [-π, π], NaN where missing; a dict by sensor where there are several."""
        return self._by_sensor(lambda i: self._out(i.residual, "innovation"))

    @property
    def innovation_cov(self) -> Any:
        """Covariances of the innovations (…, T, m, m); a dict by sensor where there are several."""

        def covariance(told: Innovation) -> Any:
            return covariances(self._out(told.factor, "innovation_cov"))

        return self._by_sensor(covariance)

    def _by_sensor(self, show: Any) -> Any:
        if self.stored_innovations is None:
            raise InputError("innovation was not kept; add it to keep= in run")
        shown = {sensor: show(told) for sensor, told in self.stored_innovations.items()}
        return shown if self.layout.several else next(iter(shown.values()))
