"""What a run leaves behind."""

from dataclasses import dataclass, field
from typing import Any

import jax

from sigmax.errors import InputError
from sigmax.results.covariances import covariances
from sigmax.results.smoothed import Smoothed
from sigmax.results.weighing import weights
from sigmax.steps.step import Innovation

# What a run can keep.
PARTS = ("mean", "factor", "fault", "nis", "dof", "step_log_likelihood", "innovation", "modes")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class Result(Smoothed):
    """Filtered estimates and what the measurements said; see `Smoothed` for the shapes."""

    stored_innovations: Any = field(repr=False)
    stored_nis: Any = field(repr=False)
    stored_log_likelihood: Any = field(repr=False)
    stored_count: Any = field(repr=False)
    stored_total: Any = field(repr=False)
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
