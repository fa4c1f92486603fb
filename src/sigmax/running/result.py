"""What a run leaves behind."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from sigmax.errors import InputError
from sigmax.models.checks import by_name, is_traced, numbers
from sigmax.running.covariances import covariances
from sigmax.running.layout import Layout
from sigmax.running.step import Fault, Innovation
from sigmax.running.weighing import weights
from sigmax.spaces import errors

# What a run can keep.
PARTS = ("mean", "factor", "fault", "nis", "dof", "step_log_likelihood", "innovation", "modes")


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
    stored_modes: Any = field(repr=False)

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
        return self._out(self.stored_mean, "mean")[..., self.layout.numbers[0]]

    @property
    def factor(self) -> Any:
        """Lower factors S of the covariances, P = S Sᵀ (…, T, n, n)."""
        at, _ = self.layout.deviations
        rows = self._rows(at)
        if not self.layout.bias_first:
            return rows[..., at]
        return self._triangle(rows)

    def _array(self) -> Any:
        return jnp if is_traced(self.stored_factor) else np

    def _triangle(self, rows: Any) -> Any:
        """The lower factor of A Aᵀ."""
        upper = self._array().linalg.qr(rows.swapaxes(-1, -2), mode="r")
        turn = self._array().where(self._array().einsum("...ii->...i", upper) < 0, -1.0, 1.0)
        return (upper * turn[..., None]).swapaxes(-1, -2)

    def _rows(self, rows: slice) -> Any:
        """Rows A of the joint factor of state and bias: A Aᵀ is the covariance of these components."""
        return self._out(self.stored_factor, "factor")[..., rows, :]

    @property
    def cov(self) -> Any:
        """Covariances (…, T, n, n), computed when asked for."""
        return self._covariance(self.layout.deviations[0])

    def _covariance(self, rows: slice) -> Any:
        # Of state and bias together, though one of them is asked for: the same sums in the same order as live.
        return covariances(self._out(self.stored_factor, "factor"))[..., rows, rows]

    @property
    def std(self) -> Any:
        """Standard deviations (…, T, n)."""
        S = self._rows(self.layout.deviations[0])
        return (S * S).sum(-1) ** 0.5

    @property
    def bias(self) -> tuple[str, ...]:
        """Names of the components of the bias, none where the model has no bias."""
        return self.layout.bias

    @property
    def bias_mean(self) -> Any:
        """Estimates of the bias (…, T, p)."""
        return self._out(self.stored_mean, "mean")[..., self.layout.numbers[1]]

    @property
    def bias_cov(self) -> Any:
        """Their covariances (…, T, p, p)."""
        return self._covariance(self.layout.deviations[1])

    @property
    def bias_std(self) -> Any:
        """Standard deviations of the bias (…, T, p)."""
        S = self._rows(self.layout.deviations[1])
        return (S * S).sum(-1) ** 0.5

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes, none where the model has but one."""
        return self.layout.modes

    @property
    def probability(self) -> Any:
        """Probabilities of the modes (…, T, M), in the order of `modes`."""
        if not self.modes:
            raise InputError("this model has no modes: see sigmax.imm")
        return self._array().exp(self._out(self.stored_modes, "modes")[..., -len(self.modes) :])

    def joint(self) -> tuple[Any, Any]:
        """Means (…, T, n + p) and lower factors of state and bias together, the state first."""
        mean, factor = self._out(self.stored_mean, "mean"), self._out(self.stored_factor, "factor")
        if not self.layout.bias_first:
            return mean, factor
        p = len(self.layout.bias)
        rows = self._array().concatenate([factor[..., p:, :], factor[..., :p, :]], -2)
        return self._array().concatenate([mean[..., p:], mean[..., :p]], -1), self._triangle(rows)

    def kept(self) -> tuple[Any, Any, Any, Any]:
        """Means, factors, faults and modes of state and bias together, as an engine laid them out."""
        modes = self._out(self.stored_modes, "modes") if self.modes else None
        return self._out(self.stored_mean, "mean"), self._out(self.stored_factor, "factor"), self.fault, modes

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
        """Mean − truth (…, T, d), angles in [-π, π]; truth of shape (T, n) or (…, T, n), NaN where unknown.

        Of curved parts it is −(truth ⊟ mean), in the axes of the covariance.
        A frame is taken by the names of its columns.

        Raises:
            InputError: for a truth of another shape or with other names.
        """
        value, mean = numbers("the truth", by_name("the truth", truth, self.state), missing=True), self.mean
        if value.shape not in (mean.shape, mean.shape[-2:]):
            shapes = " or ".join(map(str, dict.fromkeys((mean.shape[-2:], mean.shape))))
            raise InputError(f"the truth must have the shape {shapes}, for {list(self.state)}; it has {value.shape}")
        return errors(self.layout.space, mean, value)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result(Smoothed):
    """Filtered estimates and what the measurements said; see `Smoothed` for the shapes."""

    stored_innovations: Any = field(repr=False)
    stored_nis: Any = field(repr=False)
    stored_log_likelihood: Any = field(repr=False)
    stored_count: Any = field(repr=False)
    stored_total: Any = field(repr=False)
    stored_dt: Any = field(default=None, repr=False)
    stored_inputs: Any = field(default=None, repr=False)

    @property
    def nis(self) -> Any:
        """Normalised innovation squared (…, T), summed over the sensors of a step, NaN without measurement.

        Of an honest filter it is chi-square with `dof` degrees of freedom.
        """
        return self._out(self.stored_nis, "nis")

    @property
    def fusion(self) -> dict[str, str]:
        """How each sensor was fused, by its name; empty where they were corrected one after the other.

        "compressed": put together with others of the same function before the correction; "stacked": beside
        others with the whole of Ω; "summed": stacked, which for this filter is a sum of contributions.
        """
        return dict(self.layout.fusion)

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
    def dt(self) -> Any:
        """Seconds of each step (…, T), as the run took them: kept where mean, factor and fault are, for `smooth`."""
        return self._out(self.stored_dt, "dt, which comes with mean, factor and fault,")

    @property
    def inputs(self) -> Any:
        """Inputs of each step (…, T, k), kept as `dt` is; None where the model takes none."""
        return self.stored_inputs

    @property
    def innovation(self) -> Any:
        """Z − ẑ (…, T, m), angles in [-π, π], NaN where missing; a dict by sensor where there are several."""
        return self._by_sensor(lambda told, _: self._out(told.residual, "innovation"))

    @property
    def innovation_cov(self) -> Any:
        """Covariances of the innovations (…, T, m, m); a dict by sensor where there are several."""

        def covariance(told: Innovation, _: str) -> Any:
            return covariances(self._out(told.factor, "innovation_cov"))

        return self._by_sensor(covariance)

    @property
    def weight(self) -> Any:
        """Weights ω (…, T, m) of measured components in a robust update; a dict by sensor where there are several.

        The variances of a measurement are divided by them: 1 where it counted in full, 0 where it was refused, NaN
        where it was missing or a step failed. Computed from the innovations when asked for.

        Raises:
            InputError: of several modes, or members of a bank, which may weigh one measurement each in its own way.
        """
        if self.modes or not self.layout.weights:
            raise InputError("each mode or member weighs a measurement in its own way; run one alone to see how")
        by = dict(self.layout.weights)
        return self._by_sensor(lambda told, sensor: weights(by[sensor], told))

    def _by_sensor(self, show: Any) -> Any:
        if self.stored_innovations is None:
            raise InputError("innovation was not kept; add it to keep= in run")
        shown = {sensor: show(told, sensor) for sensor, told in self.stored_innovations.items()}
        return shown if self.layout.several else next(iter(shown.values()))
