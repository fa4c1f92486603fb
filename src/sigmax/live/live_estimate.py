"""What a live filter knows now."""

from typing import Any

import numpy as np

from sigmax.errors import InputError
from sigmax.filters import Filter
from sigmax.live.clocked_engine import ClockedEngine
from sigmax.live.live_native import NativeState
from sigmax.modelling.model import Model
from sigmax.modelling.switching import SwitchingModel
from sigmax.preparation.layout import Layout
from sigmax.preparation.times import since
from sigmax.results.covariances import Moments
from sigmax.results.noise_scales import NoiseScales
from sigmax.results.presentation import estimates, noises_found, probabilities
from sigmax.steps.adaptive_noises import scales
from sigmax.steps.step import Fault
from sigmax.views import words


class LiveEstimate(NoiseScales):
    """The estimate of a live filter, to be read between its calls."""

    filter: Filter
    model: Model
    layout: Layout
    _clocked: ClockedEngine
    _zero: int | None
    _batched: bool
    _biased: bool
    _numbers: tuple[slice, slice]
    _deviations: tuple[slice, slice]

    @property
    def engine(self) -> str:
        """What computes its steps: "native", or "xla" where the C compiler could not compile them."""
        return "native" if isinstance(self._clocked.engine, NativeState) else "xla"

    @property
    def time(self) -> Any:
        """What time it is, that of the latest step: seconds, or datetime64 in UTC where the prior has an instant."""
        return since(self._zero, self._clocked.time)

    @property
    def mean(self) -> np.ndarray:
        """The estimate (n,) or (B, n)."""
        mean = self._clocked.still.read_mean()
        return mean[..., self._numbers[0]] if self._biased else mean

    @property
    def bias_mean(self) -> np.ndarray:
        """The estimate of the bias (p,) or (B, p)."""
        return self._clocked.engine.read_mean()[..., self._numbers[1]]

    @property
    def bias_cov(self) -> np.ndarray:
        """Its covariance (p, p) or (B, p, p)."""
        return self._clocked.engine.read_cov()[..., self._deviations[1], self._deviations[1]]

    @property
    def bias_std(self) -> np.ndarray:
        """Its standard deviations (p,) or (B, p)."""
        return self._root_of_squares(self._deviations[1])

    @property
    def cov(self) -> np.ndarray:
        """Its covariance (n, n) or (B, n, n)."""
        cov = self._clocked.still.read_cov()
        return cov[..., self._deviations[0], self._deviations[0]] if self._biased else cov

    @property
    def moments(self) -> Moments:
        """The estimate and its covariance, read in one call: `mean, cov = live.moments`."""
        both: Moments = self._clocked.still.read_moments()
        if not self._biased:
            return both
        return Moments(both.mean[..., self._numbers[0]], both.cov[..., self._deviations[0], self._deviations[0]])

    @property
    def std(self) -> np.ndarray:
        """Its standard deviations (n,) or (B, n)."""
        return self._root_of_squares(self._deviations[0])

    @property
    def information(self) -> tuple[np.ndarray, np.ndarray]:
        """The information pair y = Y x (n,) and Y = P⁻¹ (n, n), or (B, n) and (B, n, n): see `Result.information`."""
        pair: tuple[np.ndarray, np.ndarray] = self._clocked.at(self._clocked.time, None).information
        return pair

    @property
    def probability(self) -> np.ndarray:
        """Probabilities of the modes (M,) or (B, M), in the order of the model's."""
        if not isinstance(self.model, SwitchingModel):
            raise InputError("this model has no modes: see sigmax.imm")
        return np.exp(np.asarray(self.belief.log_weight)).T

    def known_noises(self) -> Any:
        """What is known of noises that the filter finds (k,) or (B, k), None where it finds none."""
        return np.asarray(self.belief.known).T if self.layout.noises.size else None

    @property
    def belief(self) -> Any:
        """Mean and factor of state and bias together, batch last."""
        return self._clocked.still.belief

    @property
    def ok(self) -> Any:
        """Whether the last call was sound: a bool, or one for each track."""
        fault = self._clocked.engine.fault
        return np.asarray(fault) == 0 if self._batched else not fault.any()

    @property
    def fault(self) -> Any:
        """Why it was not: a `Fault`, or a list of one for each track."""
        found = [Fault(int(f)) for f in np.ravel(self._clocked.engine.fault)]
        return found if self._batched else found[0]

    def _root_of_squares(self, rows: slice) -> np.ndarray:
        S = self._clocked.engine.factor[..., rows, :]
        return np.sqrt((S * S).sum(-1))

    def __repr__(self) -> str:
        title = f"Live {self.filter.name}, {self.engine} engine"
        if self._clocked.busy:
            return f"{title}, in use by another thread"
        first = (0,) if self._batched else ()
        mean, S = self._clocked.engine.read_mean(), self._clocked.engine.factor[first]
        rows = [("time", str(self.time) if self._zero is not None else f"{self.time:g} s")]
        rows += [("tracks", f"{len(mean):,}, the first:")] if self._batched else []
        rows += [probabilities(self.layout.modes, self.probability[first])] if self.layout.modes else []
        noises = self.layout.noises
        rows += [noises_found(scales(noises, self.known_noises()[first]))] if noises.size else []
        rows += estimates(self.layout, mean[first], np.sqrt((S * S).sum(-1)))
        return words.text(title, rows)
