"""Estimates over time, and how they are shown."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from sigmax.errors import InputError
from sigmax.modelling.checks import by_name, is_traced, numbers
from sigmax.preparation.layout import Layout
from sigmax.preparation.times import shown
from sigmax.results import presentation
from sigmax.results.covariances import covariances
from sigmax.results.information_pair import information_pair
from sigmax.results.noise_scales import NoiseScales
from sigmax.results.presentation import series
from sigmax.spaces import errors
from sigmax.steps.step import Fault
from sigmax.views import draw, table, words
from sigmax.views.panels import panels


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class Smoothed(NoiseScales):
    """Means and covariances over time; the batch, where there is one, comes first.

    Arrays are NumPy arrays, or JAX arrays while being traced. Printed it says in a few lines what came out, in a
    notebook with a picture.
    """

    layout: Layout = field(metadata={"static": True})
    stored_mean: Any = field(repr=False)
    stored_factor: Any = field(repr=False)
    stored_fault: Any = field(repr=False)
    stored_modes: Any = field(repr=False)
    stored_dt: Any = field(default=None, repr=False, kw_only=True)
    stored_time: Any = field(default=None, repr=False, kw_only=True)

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
    def information(self) -> tuple[Any, Any]:
        """The information pair y = Y x (…, T, n) and Y = P⁻¹ (…, T, n, n), from the factor; of the state alone.

        Not finite where a component is known exactly. n³ operations a step, when asked for. Y of an open start
        is singular, and NaN where the model has a bias.

        Raises:
            InputError: in a curved space, where an estimate is no vector.
        """
        numbers = None
        if self.layout.from_information and not self.bias:
            numbers = self._out(self.stored_modes, "modes, which holds the open start,")
        return information_pair(self._array(), self.mean, self.factor, numbers)

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

    def known_noises(self) -> Any:
        """What was stored of noises that the filter found (…, T, k), None where it found none."""
        return self._out(self.stored_modes, "modes, which holds noises,") if self.layout.noises.size else None

    @property
    def dt(self) -> Any:
        """Seconds of each step (…, T), as the run took them: kept where mean, factor and fault are, for `smooth`."""
        return self._out(self.stored_dt, "dt, which comes with mean, factor and fault,")

    @property
    def time(self) -> Any:
        """The time of each step (…, T): t as given, datetime64 in UTC of instants, else the seconds since the prior."""
        return self.dt.cumsum(-1) if self.stored_time is None else shown(self.stored_time, self.layout.dated)

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
        modes = self._out(self.stored_modes, "modes") if self.modes else self.known_noises()
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

    def __repr__(self) -> str:
        return words.text(presentation.heading(self), presentation.rows(self))

    def _repr_html_(self) -> str:
        """For notebooks: what is printed, and the picture of the first track."""
        title = presentation.heading(self)
        try:
            shown = series(self, 0)
            below = draw.image(panels(shown, None, presentation.judged(self), points=400), shown.title)
        except InputError as error:
            below = f"<p>{escape(str(error))}</p>"
        return words.html(title, presentation.rows(self), below)

    def plot(self, *, track: int = 0, path: Sequence[str] | None = None, library: str = "plotly") -> Any:
        """A picture: the path, each component with ±2σ, the NIS with its bounds, the probabilities of modes.

        Bands of numbers of curved parts, such as those of a quaternion, are to first order.

        Args:
            track: which of a batch.
            path: names of the two components of the position, the one drawn to the right first; without it such as are
                called x and y, or east and north.
            library: "plotly" or "matplotlib".

        Returns:
            Its figure.

        Raises:
            InputError: where the library is not installed, means were not kept, or track or path are not there.
        """
        shown = series(self, track)
        return draw.draw(panels(shown, path, presentation.judged(self)), shown.title, library)

    def to_frame(self) -> Any:
        """A pandas frame by time, with a row for each track and time where there is a batch.

        Columns: each number, `NAME_std` for each deviation, `probability_MODE`, and of a filter nis, dof,
        log_likelihood and fault; what was not kept is not there. Units are in `frame.attrs["units"]`.
        """
        return table.frame(series(self))

    def to_parquet(self, path: str | Path, *, first: int = 0) -> None:
        """The columns of `to_frame` in a file of Parquet, each with its unit in the metadata of its field.

        Tracks are counted from `first`, which `run_in_blocks` tells.
        """
        table.parquet(series(self), path, first)

    def to_xarray(self) -> Any:
        """An xarray dataset: the columns of `to_frame` as variables with their units, and the covariances as `cov`."""
        cov = None if self.stored_factor is None else np.asarray(covariances(self.joint()[1]))
        return table.dataset(series(self), cov)
