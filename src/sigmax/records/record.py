"""A record: what was measured, the model for it, and what shall be tried on it."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sigmax.descriptions.trial import Trial, with_updates
from sigmax.errors import InputError, unknown
from sigmax.files.frame import Placed
from sigmax.files.units import Dimension
from sigmax.filters import Filter, Update
from sigmax.models import Gaussian, Model
from sigmax.spaces import readable


class Backdrop(NamedTuple):
    """What a path is drawn upon, where the state's position is counted from a place that moves.

    Attributes:
        heights: (rows, columns), m, rows towards rising second coordinate.
        spacing: of columns and rows, m.
        origin: coordinates of the first column and row, m.
        offset: (B, T, 2), added to the position of the state.
        label: what the offset alone is.
    """

    heights: np.ndarray
    spacing: tuple[float, float]
    origin: tuple[float, float]
    offset: np.ndarray
    label: str


@dataclass(frozen=True)
class Record:
    """One or several tracks (B) laid out for one call, padded at the end to the longest (T).

    Attributes:
        name: short, for folders and tables.
        title: in words.
        model: the model, in SI and radians.
        prior: the state one dt before the first time of each track, or at it: see `update_first`.
        tracks: their names (B).
        time: seconds since `epoch`, or as the source counts them (B, T).
        steps: the length of each track (B,); what lies behind is padding.
        z: measurements (B, T, m), or by sensor; NaN is missing.
        dt: seconds since the row before, 0 in the first (B, T).
        inputs: (B, T, k), or None.
        truth: the state as far as it is known (B, T, n), NaN where it is not.
        position: where the position stands in the state.
        dimensions: of the components of the state, as many as it has deviations.
        trials: what to run if nothing else is said.
        epoch: the instant of time 0, where the source tells.
        landmarks: points to show on the map, by name.
        source: where the data come from.
        licence: the terms they are under.
        notes: what a reader of the results should know.
        doubts: what looks as if it were meant otherwise: a unit, a column of tracks, rows that stand there twice.
        backdrop: the map below the path, or None.
        bias_dimensions: of the components of the model's bias.
        update_first: whether the prior stands at the first time of each track, as in `sigmax.run`.
        updates: how sensors correct, by name, with filters that say nothing of it themselves.
        placed: where the state lies on the Earth, or None.
    """

    name: str
    title: str
    model: Model
    prior: Gaussian
    tracks: tuple[str, ...]
    time: np.ndarray
    steps: np.ndarray
    z: Any
    dt: np.ndarray
    inputs: np.ndarray | None
    truth: np.ndarray
    position: tuple[int, ...]
    dimensions: tuple[Dimension, ...]
    trials: tuple[Trial, ...]
    epoch: pd.Timestamp | None = None
    landmarks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    source: str = ""
    licence: str = ""
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    backdrop: Backdrop | None = None
    bias_dimensions: tuple[Dimension, ...] = ()
    update_first: bool = False
    updates: Mapping[str, Update] = field(default_factory=dict)
    placed: Placed | None = None

    @property
    def real(self) -> np.ndarray:
        """Which steps are not padding (B, T)."""
        return np.arange(self.time.shape[1]) < self.steps[:, None]

    def of_trial(self, trial: Trial) -> tuple[Filter, Model, Gaussian]:
        """Filter, model and prior of a trial: the variances of fixed components of state and bias are 0.

        Raises:
            InputError: for a component that the model does not have.
        """
        bias = self.model.bias
        names = self.components
        for name in trial.fixed:
            if name not in names:
                raise InputError(f"{trial.name}: {unknown('component', name, names)}")
        kept = np.array([name not in trial.fixed for name in names], float)
        n = self.model.dim
        prior = Gaussian(self.prior.mean, np.asarray(self.prior.cov) * np.outer(kept[:n], kept[:n]))
        chosen = with_updates(trial.filter, self.updates)
        if bias is None or kept[n:].all():
            return chosen, self.model, prior
        offsets = bias.prior
        known = Gaussian(offsets.mean, np.asarray(offsets.cov) * np.outer(kept[n:], kept[n:]))
        return chosen, self.model.with_bias_prior(known), prior

    def told(self, trial: Trial) -> tuple[Filter, Model, Gaussian]:
        """`of_trial`, by its name in version 0.1."""
        warnings.warn("Record.told is Record.of_trial now", DeprecationWarning, stacklevel=2)
        return self.of_trial(trial)

    @property
    def components(self) -> dict[str, Dimension]:
        """The components of the state, and behind them those of the bias, with their dimensions."""
        names = (*self.model.deviations, *(() if self.model.bias is None else self.model.bias.names))
        return dict(zip(names, (*self.dimensions, *self.bias_dimensions), strict=True))

    def label(self, trial: Trial) -> str:
        """The trial for tables: what is fixed, and at what value."""
        bias = self.model.bias
        state = readable(self.model.space, np.atleast_2d(self.prior.mean)[0])
        mean = [*state, *([] if bias is None else np.atleast_2d(bias.prior.mean)[0])]
        fixed = [f"{name} fixed at {mean[list(self.components).index(name)]:g}" for name in trial.fixed]
        return ", ".join([trial.filter.name, *fixed])
